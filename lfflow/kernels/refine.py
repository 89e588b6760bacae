"""A disparity moved to where all samples agree best with the completed central view, and how sure that place is.

One Gauss–Newton step on the same-colour differences of all views (their closed-form minimum, METHOD 8.3): with residual
r and its slope g along d, the step is Σ φ g r / Σ φ g² over a block φ of the same surface, and its variance
σ² Σ φ² g² / (Σ φ g²)² with σ² the mean squared residual of the block.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.kernels.mosaic_field import MosaicField

FloatArray = npt.NDArray[np.float32]
SECTORS = 4
NOISE_SLOPE = 0.3
"""Mean square of the slope along d that noise alone makes: this times its variance and the aperture's radius squared.

Measured where simulated captures have no texture, with some reserve."""


class Refined(NamedTuple):
    """What the samples around each lens (t, s) tell.

    Parameters
    ----------
    disparity
        The refined disparity.
    predicted
        Its standard deviation by the closed formula.
    own
        The same from those places of the block alone that have the lens's colour: large where an edge nearby, which may
        be another surface's, is all that the block has to tell.
    spread
        Disagreement of the sides of the aperture.
    residual
        Mean squared residual.
    """

    disparity: FloatArray
    predicted: FloatArray
    own: FloatArray
    spread: FloatArray
    residual: FloatArray


def refine(
    field: MosaicField,
    picture: FloatArray,
    disparity: FloatArray,
    *,
    sigma: float = 1.2,
    limit: float = 0.05,
    same: float = 0.06,
    largest: float = 0.06,
    alike: float = 0.04,
    radius: float = 0.0,
) -> Refined:
    """Refine `disparity` (t, s) against `picture` (3, t, s).

    Parameters
    ----------
    sigma
        Gaussian block, lens pitches.
    limit
        Residual, in units of the mosaic, beyond which a sample counts as hidden.
    same
        Neighbours whose disparity differs by more belong to another surface.
    largest
        Largest step, lens pitches per view step.
    alike
        Mean difference of the colours, in units of the mosaic, beyond which a place hardly has the lens's colour.
    radius
        That of the aperture, sensor pixels: the share of the noise in the slopes is taken off what `own` counts as
        texture; 0 leaves it in.
    """
    rows, columns = disparity.shape
    sums = np.zeros((4, SECTORS, rows, columns), dtype=np.float32)
    start = np.ascontiguousarray(np.where(np.isfinite(disparity), disparity, 0), dtype=np.float32)
    padded = np.pad(np.moveaxis(picture, 0, -1), ((1, 1), (1, 1), (0, 0)), mode="edge").astype(np.float32)
    for j, i in np.argwhere((field.cfa != CFA_NONE).any(axis=(2, 3))):
        u, v = int(field.u[i]), int(field.v[j])
        if u == 0 and v == 0:
            continue
        side = (0 if u > 0 else 1) if abs(u) > abs(v) else (2 if v > 0 else 3)
        view = field.mosaic[j, i], field.cfa[j, i], field.weight[j, i]
        place = np.float32(u), np.float32(v)
        _slopes(view, place, field.rho, field.offset, np.float32(field.row_pitch), padded, start, np.float32(limit),
                sums[:, side])  # fmt: skip
    out = np.empty((5, rows, columns), dtype=np.float32)
    limits = np.array([sigma, same, largest, alike, NOISE_SLOPE * radius**2], dtype=np.float32)
    _steps(sums, start, np.moveaxis(picture, 0, -1).copy(), field.offset, np.float32(field.row_pitch), limits, out)
    refined = np.where(np.isfinite(disparity), start + out[0], np.nan).astype(np.float32)
    return Refined(refined, *out[1:])


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _slopes(view, place, rho, offset, pitch, padded, disparity, limit, sums):  # type: ignore[no-untyped-def]
    """Add the samples of one view to the sums (4, t, s) of w·g², w·g·r, w·r² and w."""
    mosaic, cfa, confidence = view
    u, v = place
    rows, columns = disparity.shape
    one, half = np.float32(1), np.float32(0.5)
    narrow = one / (limit * limit)
    for t in range(rows):
        for s in range(columns):
            d = disparity[t, s]
            row = int(np.floor(np.float32(t) - d * v / pitch + half))
            if row < 1 or row >= rows - 1:
                continue
            column = int(np.floor(np.float32(s) + offset[t] - d * u - offset[row] + half))
            if column < 1 or column >= columns - 2 or cfa[row, column] == CFA_NONE:
                continue
            a_x, a_y = u + rho[0, row, column], (v + rho[1, row, column]) / pitch
            x, y = np.float32(column) + offset[row] + d * a_x, np.float32(row) + d * a_y
            value, g_x, g_y = read_picture(padded, offset, x, y, cfa[row, column])
            r = mosaic[row, column] - value
            g = g_x * a_x + g_y * a_y
            robust = one / (one + r * r * narrow)
            w = confidence[row, column] * robust * robust
            sums[0, t, s] += w * g * g
            sums[1, t, s] += w * g * r
            sums[2, t, s] += w * r * r
            sums[3, t, s] += w


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def read_picture(padded, offset, x, y, c):  # type: ignore[no-untyped-def]
    """Picture at X = x, row y and its slopes to the right (per lens) and down (per row)."""
    rows, columns = padded.shape[0] - 2, padded.shape[1] - 2
    upper = min(max(int(np.floor(y)), 0), rows - 2)
    p_0, q_0 = _row(padded, upper, x - offset[max(upper - 1, 0)], columns, c)
    p_1, q_1 = _row(padded, upper + 1, x - offset[upper], columns, c)
    p_2, q_2 = _row(padded, upper + 2, x - offset[upper + 1], columns, c)
    p_3, q_3 = _row(padded, upper + 3, x - offset[min(upper + 2, rows - 1)], columns, c)
    f = min(max(y - np.float32(upper), np.float32(0)), np.float32(1))
    value, down = _cubic(p_0, p_1, p_2, p_3, f)
    right, _ = _cubic(q_0, q_1, q_2, q_3, f)
    return value, right, down


@numba.njit(nogil=True, cache=True, inline="always")
def _row(padded, row, place, columns, c):  # type: ignore[no-untyped-def]
    place = min(max(place, np.float32(0)), np.float32(columns - 1))
    left = min(int(place), columns - 2)
    p_0, p_1 = padded[row, left, c], padded[row, left + 1, c]
    return _cubic(p_0, p_1, padded[row, left + 2, c], padded[row, left + 3, c], place - np.float32(left))


@numba.njit(nogil=True, cache=True, inline="always")
def _cubic(p_0, p_1, p_2, p_3, f):  # type: ignore[no-untyped-def]
    """Value and slope at `f` between the middle two of four samples (Keys): a line moves fine texture to the lenses."""
    half, two, three = np.float32(0.5), np.float32(2), np.float32(3)
    linear = half * (p_2 - p_0)
    square = p_0 - np.float32(2.5) * p_1 + two * p_2 - half * p_3
    cube = half * (p_3 - p_0) + (p_1 - p_2) * np.float32(1.5)
    return p_1 + f * (linear + f * (square + f * cube)), linear + f * (two * square + three * f * cube)


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _steps(sums, disparity, picture, offset, pitch, limits, out):  # type: ignore[no-untyped-def]
    rows, columns = disparity.shape
    sigma, same, largest, alike, slope_noise = limits
    reach = int(np.ceil(2 * sigma))
    total = np.empty((4, SECTORS), dtype=np.float32)
    for t in range(rows):
        for s in range(columns):
            total[:] = 0
            square, own, own_square, own_weight = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for row in range(max(0, t - reach), min(rows, t + reach + 1)):
                for column in range(max(0, s - reach), min(columns, s + reach + 1)):
                    gap = (disparity[row, column] - disparity[t, s]) / same
                    if abs(gap) > 1:
                        continue
                    x = column + offset[row] - s - offset[t]
                    y = (row - t) * pitch
                    phi = np.exp(-(x * x + y * y) / (2 * sigma * sigma)) * (1 - gap * gap)
                    bend, weight = np.float32(0), np.float32(0)
                    for k in range(SECTORS):
                        for n in range(4):
                            total[n, k] += phi * sums[n, k, row, column]
                        bend += sums[0, k, row, column]
                        weight += sums[3, k, row, column]
                    square += phi * phi * bend
                    change = np.float32(0)
                    for c in range(3):
                        change += abs(picture[row, column, c] - picture[t, s, c])
                    near = phi * np.exp(-((change / (3 * alike)) ** 2))
                    own += near * bend
                    own_square += near * near * bend
                    own_weight += near * weight
            out[0, t, s], out[1, t, s], out[3, t, s], out[4, t, s] = _solve(total, square, largest)
            own -= slope_noise * own_weight * out[4, t, s]
            out[2, t, s] = min(np.sqrt(out[4, t, s] * own_square) / own, np.float32(1)) if own > 0 else np.float32(1)


@numba.njit(nogil=True, cache=True)
def _solve(total, square, largest):  # type: ignore[no-untyped-def]
    """Step, predicted std, spread of the sectors' own steps, mean squared residual."""
    bend, slope = total[0].sum(), total[1].sum()
    weight = total[3].sum()
    if bend <= 0 or weight <= 0:
        return np.float32(0), np.float32(1), np.float32(0), np.float32(0)
    step = min(max(slope / bend, -largest), largest)
    residual = total[2].sum() / weight
    spread = np.float32(0)
    for k in range(SECTORS):
        own = min(max(total[1, k] / max(total[0, k], 1e-12), -4 * largest), 4 * largest)
        spread += total[0, k] / bend * (own - step) ** 2
    return step, np.sqrt(residual * square) / bend, np.sqrt(spread), residual
