"""What the samples around each lens tell of its disparity, below the step of the hypotheses, and how well they tell it.

One Gauss–Newton step on the same-colour differences of all views to the completed central view (their closed-form
minimum, METHOD 8.3): with residual r and slope g along d, the step is Σ φ g r / Σ φ g² over a small block φ, and its
variance σ² / Σ φ g² with σ² the mean squared residual of the block. The slope is that of the fine detail alone: light
that changes with the viewpoint is smooth, so that it has no part in Σ φ g r and pulls at nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.mosaicked.block import block_sum, block_weights
from lfflow.kernels.mosaicked.mosaic_field import MosaicField, shown_by
from lfflow.kernels.mosaicked.patches import patches, read_patch
from lfflow.kernels.threads import bands, each

FloatArray = npt.NDArray[np.float32]

BLOCK, COMPANY, AROUND = 0.7, 1.2, 2.0
"""Gaussian blocks, lens pitches: of the step, of what has a lens's own colour, and of what holds the surface."""
LEAST_SHARE = 0.01
"""Smallest share of the samples that is told."""
LARGEST = 0.1
"""Longest step, lens pitches per view step; beyond it the picture is not linear."""
LIMIT, LEAST_LIMIT = 4.5, 0.015
"""Residual beyond which a sample counts as hidden: in units of the noise, and at least."""
NOISE_SLOPE = 0.3
"""Mean square of the slope along d that noise alone makes: this times its variance and the aperture's radius squared.

Measured where simulated captures have no texture, with some reserve."""


class Evidence(NamedTuple):
    """What the samples around each lens (t, s) tell.

    Parameters
    ----------
    disparity, information
        Disparity that the lens's block tells by itself, and 1/variance of it.
    own
        Its standard deviation from those places alone that have the lens's colour: large where an edge nearby, which
        may be another surface's, is all that there is to tell.
    carriers
        Share of the samples around that carry the information about a surface: few do at a sharp edge or where one
        colour alone has texture.
    """

    disparity: FloatArray
    information: FloatArray
    own: FloatArray
    carriers: FloatArray


def evidence(
    field: MosaicField,
    picture: FloatArray,
    disparity: FloatArray,
    *,
    views: Sequence[tuple[int, int]],
    noise: float,
    alike: float = 4.0,
    threads: int = 1,
) -> Evidence:
    """What the samples tell at the present `disparity` (t, s) of the view that `picture` (3, t, s) shows.

    Parameters
    ----------
    views
        Places (v, u) in the arrays of the views that are asked.
    noise
        Standard deviation of a sample, in units of the mosaic.
    alike
        Mean difference of the colours, in units of the noise, beyond which a place hardly has the lens's colour.
    """
    rows, columns = disparity.shape
    start = np.ascontiguousarray(np.where(np.isfinite(disparity), disparity, 0), dtype=np.float32)
    patch = patches(picture, field.offset, field.row_pitch)
    asked = np.array(views, dtype=np.int64).reshape(-1, 2)
    samples = field.mosaic, field.cfa, field.weight
    axes = field.u.astype(np.float32), field.v.astype(np.float32)
    pitch, tolerance = np.float32(field.row_pitch), np.float32(max(LIMIT * noise, LEAST_LIMIT))
    sums = np.zeros((6, rows, columns), dtype=np.float32)

    def band(span: tuple[int, int]) -> None:
        _sums(samples, asked, axes, field.rho, field.offset, pitch, patch, start, tolerance, span, sums)

    each(band, bands(rows), threads)
    brick = field.brick
    weights = block_weights(BLOCK, field.row_pitch, brick=brick)
    bend, slope, square, weight = (block_sum(one, field.offset, *weights) for one in sums[:4])
    residual = np.maximum(square / np.maximum(weight, 1e-6), np.float32(noise**2))
    step = np.clip(slope / np.maximum(bend, 1e-12), -LARGEST, LARGEST)
    near = _own(sums, np.moveaxis(picture, 0, -1).copy(), field.offset, pitch, np.float32(COMPANY),
                np.float32(3 * alike * noise))  # fmt: skip
    slack = NOISE_SLOPE * field.aperture() ** 2 * near[1] * residual
    own = np.sqrt(residual / np.maximum(near[0] - slack, 1e-12))
    found = np.where(np.isfinite(disparity), start + step, np.nan).astype(np.float32)
    carriers = _carriers(sums[0], sums[4], sums[5], field)
    return Evidence(found, (bend / residual).astype(np.float32), np.minimum(own, 1).astype(np.float32), carriers)


def _carriers(bend: FloatArray, squares: FloatArray, count: FloatArray, field: MosaicField) -> FloatArray:
    """Share (t, s) of the samples that carry the sums `bend`: their number is (Σ x)² / Σ x² of what each adds to them.

    Parameters
    ----------
    squares, count
        Sums of the squares of what each sample adds, and numbers of the samples.
    """
    weights = block_weights(AROUND, field.row_pitch, brick=field.brick)
    mean, square, number = (block_sum(one, field.offset, *weights) for one in (bend, squares, count))
    share = mean**2 / np.maximum(square * number, 1e-20)
    return np.asarray(np.clip(share, LEAST_SHARE, 1), dtype=np.float32)


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _sums(samples, views, axes, rho, offset, pitch, patch, disparity, limit, span, sums):  # type: ignore[no-untyped-def]
    """Fill rows `span` of the sums (6, t, s) over the samples of w·g², w·g·r, w·r², w, (w·g²)² and 1."""
    mosaics, colours, confidences = samples
    rows, columns = disparity.shape
    one = np.float32(1)
    narrow, rows_per_lens = one / (limit * limit), one / pitch
    for n in range(views.shape[0]):
        j, i = views[n]
        mosaic, cfa, confidence = mosaics[j, i], colours[j, i], confidences[j, i]
        u, v = axes[0][i], axes[1][j]
        for t in range(span[0], span[1]):
            for s in range(columns):
                d = disparity[t, s]
                row, column = shown_by(t, s, d, u, v, offset, pitch)
                if row < 1 or row >= rows - 1 or column < 1 or column >= columns - 2 or cfa[row, column] > 2:
                    continue
                a_x, a_y = u + rho[0, row, column], (v + rho[1, row, column]) * rows_per_lens
                x, y = np.float32(column) + offset[row] + d * a_x, np.float32(row) + d * a_y
                value, g_x, g_y = read_patch(patch, offset, x, y, cfa[row, column])
                r = mosaic[row, column] - value
                g = g_x * a_x + g_y * a_y
                robust = one / (one + r * r * narrow)
                w = confidence[row, column] * robust * robust
                sums[0, t, s] += w * g * g
                sums[1, t, s] += w * g * r
                sums[2, t, s] += w * r * r
                sums[3, t, s] += w
                sums[4, t, s] += (w * g * g) ** 2
                sums[5, t, s] += one


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _own(sums, picture, offset, pitch, sigma, alike):  # type: ignore[no-untyped-def]
    """Sums (2, t, s) of w·g² and w over a block of places that have the lens's colour, Gaussian of `sigma`."""
    rows, columns, channels = picture.shape
    reach = int(np.ceil(2 * sigma))
    narrow, one = np.float32(-0.5) / (sigma * sigma), np.float32(1)
    out = np.zeros((2, rows, columns), dtype=np.float32)
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            for t in range(max(0, -down), min(rows, rows - down)):
                x, y = np.float32(right) + offset[t + down] - offset[t], np.float32(down) * pitch
                phi = np.exp(narrow * (x * x + y * y))
                for s in range(max(0, -right), min(columns, columns - right)):
                    change = np.float32(0)
                    for c in range(channels):
                        change += abs(picture[t + down, s + right, c] - picture[t, s, c])
                    share = one / (one + (change / alike) ** 2)
                    near = phi * share * share
                    out[0, t, s] += near * sums[0, t + down, s + right]
                    out[1, t, s] += near * sums[3, t + down, s + right]
    return out
