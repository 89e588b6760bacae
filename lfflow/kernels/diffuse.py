"""Disparity of places without texture: the smoothest surface through the trusted places on their side of an edge.

It minimises Σ w (d − d₀)² + Σ g (d − d')² over the places that are not trusted, the second sum over the true neighbours
of the lattice: g falls where the picture has an edge, w is the little that such a place itself has to tell.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

ROUNDS = 80
OVERSHOOT = 1.8
"""Successive over-relaxation: between 1 (Gauss–Seidel) and 2 (no convergence)."""


def diffuse(
    start: FloatArray,
    trusted: BoolArray,
    weight: FloatArray,
    guide: FloatArray,
    offset: FloatArray,
    *,
    edge: float,
    rounds: int = ROUNDS,
) -> FloatArray:
    """Disparity (t, s) that equals `start` where `trusted` and is smooth elsewhere.

    Parameters
    ----------
    start
        (t, s) disparity to begin with; NaN places stay NaN and tell their neighbours nothing.
    weight
        (t, s) how much a place that is not trusted keeps of `start`, against 1 for each neighbour of its own colour.
    guide
        (t, s, channel) picture of the same view.
    offset
        (t,) X of lens s=0 of each row, lens pitches.
    edge
        Mean change of the picture that makes a neighbour count 2.7 times less.
    """
    links = _links(np.ascontiguousarray(guide, dtype=np.float32), offset.astype(np.float32), np.float32(1 / edge))
    out = np.ascontiguousarray(start, dtype=np.float32).copy()
    free = np.argwhere(~trusted & np.isfinite(start))
    _relax(out, out.copy(), free, weight.astype(np.float32), links, offset.astype(np.float32), rounds)
    return out


@numba.njit(nogil=True, cache=True, inline="always")
def _neighbour(t, s, way, offset):  # type: ignore[no-untyped-def]
    """Next lens to the right, down-left, down-right (ways 0, 1, 2); straight down twice on a square lattice."""
    if way == 0:
        return t, s + 1
    if t + 1 >= offset.shape[0] or offset[t + 1] == offset[t]:
        return t + 1, s
    return t + 1, s + way - (2 if offset[t] == 0 else 1)


@numba.njit(nogil=True, cache=True)
def _links(guide, offset, narrow):  # type: ignore[no-untyped-def]
    """Strength (3, t, s) of the link of each lens to the neighbours of `_neighbour`; 0 beyond the field."""
    rows, columns, channels = guide.shape
    out = np.zeros((3, rows, columns), dtype=np.float32)
    for t in range(rows):
        for s in range(columns):
            for way in range(3):
                row, column = _neighbour(t, s, way, offset)
                if row >= rows or column < 0 or column >= columns:
                    continue
                change = np.float32(0)
                for c in range(channels):
                    change += abs(guide[t, s, c] - guide[row, column, c])
                out[way, t, s] = np.exp(-change * narrow / channels) + np.float32(1e-4)
    return out


@numba.njit(nogil=True, cache=True)
def _relax(d, start, free, weight, links, offset, rounds):  # type: ignore[no-untyped-def]
    rows, columns = d.shape
    for _ in range(rounds):
        for n in range(free.shape[0]):
            t, s = free[n, 0], free[n, 1]
            total = weight[t, s]
            value = total * start[t, s]
            for way in range(3):
                row, column = _neighbour(t, s, way, offset)
                if row < rows and 0 <= column < columns and not np.isnan(d[row, column]):
                    total += links[way, t, s]
                    value += links[way, t, s] * d[row, column]
            for way in range(3):
                row, column = _before(t, s, way, offset)
                if row >= 0 and 0 <= column < columns and not np.isnan(d[row, column]):
                    total += links[way, row, column]
                    value += links[way, row, column] * d[row, column]
            if total > 0:
                d[t, s] += np.float32(OVERSHOOT) * (value / total - d[t, s])


@numba.njit(nogil=True, cache=True, inline="always")
def _before(t, s, way, offset):  # type: ignore[no-untyped-def]
    """The lens whose neighbour `way` is lens (t, s)."""
    if way == 0:
        return t, s - 1
    if t == 0 or offset[t - 1] == offset[t]:
        return t - 1, s
    return t - 1, s - way + (2 if offset[t - 1] == 0 else 1)
