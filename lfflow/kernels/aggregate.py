"""Semi-global aggregation of a cost volume on square and brick lattices.

A path sweeps the lattice from each neighbour direction (8 on the square grid, 6 on the brick layout) and adds to every
hypothesis the cheapest way to have reached it (Hirschmüller 2008); the jump penalty falls where the guide has an edge.
The true neighbours of a lens are used, so the brick layout needs no resampling.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]

_FLAGS = {"nnan", "nsz", "contract"}
_SQUARE = np.array([[-1, 0, 1], [-1, 0, 1]], dtype=np.int64)
_BRICK = np.array([[-1, 0], [0, 1]], dtype=np.int64)


def regularise(
    cost: FloatArray,
    hypotheses: npt.NDArray[np.floating],
    guide: FloatArray | None = None,
    *,
    small: float = 0.1,
    large: float = 1.0,
    edge: float = 0.08,
    brick: bool = False,
    scale: float | None = None,
    threads: int = 1,
) -> FloatArray:
    """Disparity (t, s) of the smoothest cheap surface through a cost volume, refined below the step by a parabola.

    Parameters
    ----------
    cost
        (hypothesis, t, s), any unit; NaN or inf where undefined. A place without any cost follows its neighbours.
    hypotheses
        (hypothesis,) equally spaced disparities, ascending.
    guide
        (t, s, channel) picture of the same view; its edges (mean absolute difference of neighbours over the
        channels, in units of `edge`) make jumps cheap.
    small, large
        Penalty of a change by one step and of a jump, in units of `scale`.
    scale
        Unit of the penalties; the median over all places of (mean − smallest cost) when not given.
    brick
        Rows are those of the brick layout: odd rows lie half a lens to the right, six neighbours instead of eight.
    threads
        Cores to use, of which two find work; the result does not depend on it.

    Returns
    -------
    Disparity (t, s) float32; NaN where no hypothesis has a cost anywhere on its paths.
    """
    total, _ = accumulate(cost, guide, small=small, large=large, edge=edge, brick=brick, scale=scale,
                          threads=threads)  # fmt: skip
    return winner(total, np.asarray(hypotheses, dtype=np.float32))


def accumulate(
    cost: FloatArray,
    guide: FloatArray | None = None,
    *,
    small: float = 0.1,
    large: float = 1.0,
    edge: float = 0.08,
    brick: bool = False,
    scale: float | None = None,
    threads: int = 1,
) -> tuple[FloatArray, float]:
    """Sum of all path costs (t, s, hypothesis), and the unit of the penalties; arguments as in `regularise`."""
    ready = defined(np.moveaxis(cost, 0, -1))
    unit = typical_depth(ready) if scale is None else scale
    rows, columns = ready.shape[:2]
    picture = (
        np.zeros((rows, columns, 1), dtype=np.float32) if guide is None else np.ascontiguousarray(guide, "float32")
    )
    offsets = _BRICK if brick else _SQUARE

    def sweep(step: int) -> FloatArray:
        part = np.zeros_like(ready)
        _sweep(
            ready, picture, offsets, step, np.float32(small * unit), np.float32(large * unit), np.float32(edge), part
        )
        return part

    total, other = each(sweep, (1, -1), threads)
    total += other
    return total, unit


def defined(cost: FloatArray) -> FloatArray:
    """Contiguous copy (t, s, hypothesis) whose undefined entries hold the place's largest cost, 0 where it has none."""
    out = np.ascontiguousarray(cost, dtype=np.float32)
    if out is cost or np.shares_memory(out, cost):
        out = out.copy()
    _define(out)
    return out


def typical_depth(cost: FloatArray) -> float:
    """Median over the places of (mean − smallest cost), at least a tiny number."""
    depth = cost.mean(axis=-1) - cost.min(axis=-1)
    depth = depth[depth > 0]
    return float(np.median(depth)) if depth.size else 1e-6


def winner(total: FloatArray, hypotheses: FloatArray) -> FloatArray:
    """Disparity (t, s) of the smallest total (t, s, hypothesis), with the parabola through its neighbours."""
    best = np.argmin(total, axis=-1)
    inner = np.clip(best, 1, max(total.shape[-1] - 2, 1))
    if total.shape[-1] < 3:
        return np.asarray(hypotheses[best], dtype=np.float32)
    low, mid, high = (np.take_along_axis(total, (inner + k)[..., None], -1)[..., 0] for k in (-1, 0, 1))
    bend = low - 2 * mid + high
    shift = np.where(bend > 0, 0.5 * (low - high) / np.where(bend > 0, bend, 1), 0)
    shift = np.where(best == inner, np.clip(shift, -0.5, 0.5), 0)
    step = (hypotheses[-1] - hypotheses[0]) / (len(hypotheses) - 1)
    flat = total.max(axis=-1) <= 0
    return np.asarray(np.where(flat, np.nan, hypotheses[best] + step * shift), dtype=np.float32)


@numba.njit(nogil=True, cache=True)
def _define(cost: FloatArray) -> None:
    rows, columns, labels = cost.shape
    for t in range(rows):
        for s in range(columns):
            largest = -np.inf
            for h in range(labels):
                if np.isfinite(cost[t, s, h]) and cost[t, s, h] > largest:
                    largest = cost[t, s, h]
            if largest == -np.inf:
                largest = 0.0
            for h in range(labels):
                if not np.isfinite(cost[t, s, h]):
                    cost[t, s, h] = largest


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _step(cost, before, after, smallest, small, large, total):  # type: ignore[no-untyped-def]
    """Path cost of a place from its predecessor's (both padded by one entry each side); returns the smallest entry."""
    labels = cost.shape[0]
    jump = smallest + large
    low = np.float32(np.inf)
    for h in range(labels):
        way = min(min(before[h + 1], jump), min(before[h], before[h + 2]) + small)
        value = cost[h] + way - smallest
        after[h + 1] = value
        total[h] += value
    for h in range(labels):
        low = min(low, after[h + 1])
    return low


@numba.njit(nogil=True, cache=True)
def _jump(guide, t, s, t_before, s_before, small, large, edge):  # type: ignore[no-untyped-def]
    change = np.float32(0)
    channels = guide.shape[2]
    for c in range(channels):
        change += abs(guide[t, s, c] - guide[t_before, s_before, c])
    change /= channels * edge
    return max(small * np.float32(1.5), large * np.float32(math.exp(-change)))


@numba.njit(nogil=True, cache=True)
def _sweep(cost, guide, offsets, step, small, large, edge, total):  # type: ignore[no-untyped-def]
    """Add the paths that come from the previous row (in the order of `step`) and from the previous column."""
    rows, columns, labels = cost.shape
    ways = offsets.shape[1]
    path = np.full((2, ways + 1, columns, labels + 2), np.float32(1e30), dtype=np.float32)
    least = np.zeros((2, ways + 1, columns), dtype=np.float32)
    blank = np.full(labels + 2, np.float32(1e30), dtype=np.float32)
    blank[1:-1] = 0
    for i in range(rows):
        t = i if step == 1 else rows - 1 - i
        now, old = i % 2, (i + 1) % 2
        for j in range(columns):
            s = j if step == 1 else columns - 1 - j
            for way in range(ways + 1):
                if way == ways:
                    t_before, s_before, row = t, s - step, now
                else:
                    t_before, s_before, row = t - step, s + offsets[t % 2, way], old
                if s_before < 0 or s_before >= columns or t_before < 0 or t_before >= rows:
                    least[now, way, s] = _step(
                        cost[t, s], blank, path[now, way, s], np.float32(0), small, large, total[t, s]
                    )
                    continue
                jump = _jump(guide, t, s, t_before, s_before, small, large, edge)
                least[now, way, s] = _step(
                    cost[t, s], path[row, way, s_before], path[now, way, s], least[row, way, s_before], small, jump,
                    total[t, s],
                )  # fmt: skip
