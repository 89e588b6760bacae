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

from lfflow.kernels.mosaicked.block import block_sum, block_weights
from lfflow.kernels.mosaicked.mosaic_field import MosaicField
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]
GAP = 8
"""Places that are not wanted and cost less to compare than to step over."""


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
    blocks = block_weights(sigma, field.row_pitch, brick=field.brick)
    out = np.empty((count, len(hypotheses), rows, columns), dtype=np.float32)
    margin = 3 + int(np.ceil(np.abs(hypotheses).max()))
    padded = np.pad(picture, ((0, 0), (margin, margin), (margin, margin)), mode="edge")
    compared = field.views() if views is None else views
    low, high = band if band is not None else (np.full((rows, columns), x, np.float32) for x in (-np.inf, np.inf))

    def one_hypothesis(h: int) -> None:
        d = hypotheses[h]
        wanted = (low <= d) & (d <= high)
        stretches = _stretches(wanted)
        error = np.zeros((count, rows, columns), dtype=np.float32)
        weight = np.zeros((count, rows, columns), dtype=np.float32)
        for j, i in compared:
            view = field.mosaic[j, i], field.cfa[j, i], field.weight[j, i]
            step = np.float32(d), np.float32(d * field.u[i]), np.float32(d * field.v[j] / field.row_pitch)
            _errors(view, field.rho, step, field.offset, np.float32(field.row_pitch), padded, margin,
                    np.float32(limit**2), stretches, error[group[j, i]], weight[group[j, i]])  # fmt: skip
        error *= wanted
        weight *= wanted
        for k in range(count):
            support = block_sum(weight[k], field.offset, *blocks)
            total = block_sum(error[k], field.offset, *blocks)
            out[k, h] = np.where(wanted & (support > 0.5), total / np.maximum(support, 0.5), np.float32(np.nan))

    each(one_hypothesis, range(len(hypotheses)), threads)
    return out


@numba.njit(nogil=True, cache=True)
def _stretches(wanted):  # type: ignore[no-untyped-def]
    """Row, first column and the one after the last of the stretches of wanted places; short gaps are part of them."""
    rows, columns = wanted.shape
    out = np.empty((wanted.size // GAP + rows + 1, 3), dtype=np.int64)
    count = 0
    for t in range(rows):
        last = -GAP - 1
        for s in range(columns):
            if not wanted[t, s]:
                continue
            if s - last > GAP:
                out[count] = t, s, s
                count += 1
            last = s
            out[count - 1, 2] = s + 1
    return out[:count]


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _errors(view, rho, step, offset, pitch, padded, margin, limit, stretches, error, weight):  # type: ignore[no-untyped-def]
    """Add the truncated squared differences of one view at one hypothesis, and their weights, along `stretches`.

    The places of a row that the samples of a view show differ by no more than |d| lenses. So each is read as the sum of
    a fixed few rows and columns, most with the weight 0: all samples of a row run through the same instructions.
    """
    mosaic, cfa, confidence = view
    d, across, down = step
    rows, columns = error.shape
    one, half = np.float32(1), np.float32(0.5)
    spread = half * abs(d) + np.float32(1e-4)
    taps = int(np.floor(one + 2 * spread)) + 2
    value = np.empty(columns, dtype=np.float32)
    for n in range(stretches.shape[0]):
        t, begin, end = stretches[n]
        row = int(np.floor(np.float32(t) - down + half))
        if row < 0 or row >= rows:
            continue
        shift = offset[t] - across - offset[row]
        jump = int(np.floor(shift + half))
        begin, end = max(begin, -jump), min(end, columns - jump)
        if begin >= end:
            continue
        first, count = np.uint64(begin + jump), np.uint64(end - begin)
        base_y = np.float32(row - t) + down
        top = int(np.floor(base_y - spread / pitch))
        value[:] = 0
        for c in range(3):
            found = 0
            for s in range(count):
                found += cfa[row, first + s] == c
            if found == 0:
                continue
            for k in range(taps):
                y = base_y - np.float32(top + k)
                x = np.float32(jump) - shift + offset[t] - offset_of(offset, t + top + k)
                left = int(np.floor(x - spread))
                for m in range(left, left + taps, 3):
                    _read(padded, c, np.uint64(t + top + k + margin), np.uint64(begin + m + margin), cfa, rho,
                          np.uint64(row), first, count, d, d / pitch, x - np.float32(m), y, value)  # fmt: skip
        for s in range(count):
            difference = mosaic[row, first + s] - value[s]
            square = difference * difference
            w = confidence[row, first + s]
            error[t, np.uint64(begin) + s] += w * (square / (square + limit))
            weight[t, np.uint64(begin) + s] += w


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"}, inline="always")
def _read(padded, c, upper, start, cfa, rho, row, first, count, d, d_y, x, y, value):  # type: ignore[no-untyped-def]
    """Add what three columns of a row of the picture have part in the samples of colour c."""
    one, none, next_to, second = np.float32(1), np.float32(0), np.uint64(1), np.uint64(2)
    for s in range(count):
        far = x + d * rho[0, row, first + s]
        line = (max(none, one - abs(far)) * padded[c, upper, start + s]
                + max(none, one - abs(far - one)) * padded[c, upper, start + s + next_to]
                + max(none, one - abs(far - one - one)) * padded[c, upper, start + s + second])  # fmt: skip
        part = max(none, one - abs(y + d_y * rho[1, row, first + s])) * line
        value[s] += part if cfa[row, first + s] == c else none


@numba.njit(nogil=True, cache=True, inline="always")
def offset_of(offset, row):  # type: ignore[no-untyped-def]
    """Offset of a row, also of one just outside of the field."""
    return offset[min(max(row, 0), offset.shape[0] - 1)]
