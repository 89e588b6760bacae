"""Cost of all mosaicked samples against a full-colour central view: the second pass (METHOD 8.4, last rule).

Every sample keeps its own colour and its true aperture point q + rho; for hypothesis d it lies at k + d·(q + rho) of
the central view, where the completed picture is read. So no sample is interpolated, no colour mixed, and vertical and
diagonal baselines count as much as horizontal ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.kernels.mosaicked.block import block_sum, block_weights
from lfflow.kernels.mosaicked.mosaic_field import MosaicField
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]
MARGIN = 4
"""Rows and columns around the picture: a place is at most ½ + |d|/2 away from the lens."""


def sectors(u: npt.NDArray[np.int64], v: npt.NDArray[np.int64], count: int = 4) -> npt.NDArray[np.int64]:
    """Sector 0 … count−1 of the aperture of each view (v, u) by direction."""
    across, down = np.meshgrid(u, v)
    angle = np.arctan2(down, across) / (2 * np.pi)
    return np.floor((angle * count + 0.5) % count).astype(np.int64)


def model_costs(
    field: MosaicField,
    picture: FloatArray,
    hypotheses: npt.NDArray[np.floating],
    *,
    views: Sequence[tuple[int, int]] | None = None,
    sigma: float = 0.6,
    count: int = 4,
    limit: float = 0.03,
    band: tuple[FloatArray, FloatArray] | None = None,
    threads: int = 1,
) -> FloatArray:
    """Mean truncated absolute difference (sector, hypothesis, t, s) of the samples from `picture` (3, t, s).

    Parameters
    ----------
    views
        Places (v, u) in the arrays of the views that are compared; all by default. Those that made the picture had
        better not be among them: a sample agrees with itself where the picture was put together, and there alone.
    sigma
        Gaussian block, lens pitches.
    count
        Sectors of the aperture: an edge hides a point from one side only.
    limit
        A squared difference saturates about the square of this.
    band
        Smallest and largest disparity (t, s) that is looked at in each place; outside the cost is NaN.
    threads
        Hypotheses that are worked on at a time.
    """
    group = sectors(field.u, field.v, count)
    rows, columns = picture.shape[1:]
    blocks = block_weights(sigma, field.row_pitch, brick=bool(field.offset.max() > 0))
    out = np.empty((count, len(hypotheses), rows, columns), dtype=np.float32)
    padded = np.pad(np.moveaxis(picture, 0, -1), ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)), mode="edge")
    compared = field.views() if views is None else views
    low, high = band if band is not None else (np.full((rows, columns), x, np.float32) for x in (-np.inf, np.inf))

    def one_hypothesis(h: int) -> None:
        d = hypotheses[h]
        wanted = (low <= d) & (d <= high)
        error = np.zeros((count, rows, columns), dtype=np.float32)
        weight = np.zeros((count, rows, columns), dtype=np.float32)
        for j, i in compared:
            view = field.mosaic[j, i], field.cfa[j, i], field.weight[j, i]
            step = np.float32(d), np.float32(d * field.u[i]), np.float32(d * field.v[j] / field.row_pitch)
            _errors(view, field.rho, step, field.offset, np.float32(field.row_pitch), padded, np.float32(limit**2),
                    wanted, error[group[j, i]], weight[group[j, i]])  # fmt: skip
        for k in range(count):
            support = block_sum(weight[k], field.offset, *blocks)
            total = block_sum(error[k], field.offset, *blocks)
            out[k, h] = np.where(wanted & (support > 0.5), total / np.maximum(support, 0.5), np.float32(np.nan))

    each(one_hypothesis, range(len(hypotheses)), threads)
    return out


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _errors(view, rho, step, offset, pitch, padded, limit, wanted, error, weight):  # type: ignore[no-untyped-def]
    """Add the truncated squared differences of one view at one hypothesis, and their weights."""
    mosaic, cfa, confidence = view
    d, across, down = step
    rows, columns = error.shape
    one, half = np.float32(1), np.float32(0.5)
    for t in range(rows):
        row = int(np.floor(np.float32(t) - down + half))
        if row < 0 or row >= rows:
            continue
        shift = offset[t] - across - offset[row]
        jump = int(np.floor(shift + half))
        base_x = np.float32(jump) - shift + np.float32(MARGIN)
        base_y = np.float32(row - t) + down + np.float32(MARGIN)
        for s in range(max(0, -jump), min(columns, columns - jump)):
            c = cfa[row, s + jump]
            if c == CFA_NONE or not wanted[t, s]:
                continue
            y = base_y + d * rho[1, row, s + jump] / pitch
            upper = int(y)
            fy = y - np.float32(upper)
            x = base_x + d * rho[0, row, s + jump] + offset[t]
            upper += t
            x_0, x_1 = x - offset_of(offset, upper - MARGIN), x - offset_of(offset, upper - MARGIN + 1)
            left_0, left_1 = int(x_0), int(x_1)
            f_0, f_1 = x_0 - np.float32(left_0), x_1 - np.float32(left_1)
            left_0 += s
            left_1 += s
            first = (one - f_0) * padded[upper, left_0, c] + f_0 * padded[upper, left_0 + 1, c]
            second = (one - f_1) * padded[upper + 1, left_1, c] + f_1 * padded[upper + 1, left_1 + 1, c]
            difference = mosaic[row, s + jump] - ((one - fy) * first + fy * second)
            square = difference * difference
            k = confidence[row, s + jump]
            error[t, s] += k * square / (square + limit)
            weight[t, s] += k


@numba.njit(nogil=True, cache=True, inline="always")
def offset_of(offset, row):  # type: ignore[no-untyped-def]
    """Offset of a row, also of one just outside of the field."""
    return offset[min(max(row, 0), offset.shape[0] - 1)]
