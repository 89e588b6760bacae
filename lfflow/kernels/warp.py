"""The disparity of one view, read between lenses and in views between those that have a map."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_JUMP = 0.1
"""Disparity difference (lens pitches per view step) across which maps are not interpolated."""


@numba.njit(nogil=True, cache=True)
def _corner(low: int, fraction: float, count: int, step: int) -> tuple[int, float]:
    place = min(max(low + step, 0), count - 1)
    return place, (fraction if step == 1 else 1.0 - fraction)


@numba.njit(nogil=True, cache=True)
def _nearest_wins(found: Array, share: Array) -> float:
    """Weighted mean of the values near that of the largest share; NaN when there is none."""
    best = -1
    for k in range(4):
        if not np.isnan(found[k]) and (best < 0 or share[k] > share[best]):
            best = k
    if best < 0:
        return np.nan
    total, weight = 0.0, 0.0
    for k in range(4):
        if abs(found[k] - found[best]) < _JUMP:
            total += share[k] * found[k]
            weight += share[k]
    return total / weight if weight > 0 else found[best]


@numba.njit(nogil=True, cache=True)
def _read(values: Array, x: float, y: float, geometry: Array) -> float:
    """Bilinear between the four lenses around (x, y), but never across a jump."""
    rows, columns = values.shape
    pitch, half, odd = geometry[0], geometry[1], int(geometry[2])
    found, share = np.empty(4), np.empty(4)
    upper = int(np.floor(y / pitch))
    for r in range(2):
        row, across = _corner(upper, y / pitch - upper, rows, r)
        place = x - half * ((row + odd) & 1)
        left = int(np.floor(place))
        for c in range(2):
            column, along = _corner(left, place - left, columns, c)
            found[2 * r + c] = values[row, column]
            share[2 * r + c] = across * along
    return _nearest_wins(found, share)


@numba.njit(nogil=True, cache=True)
def read_disparity(
    disparity: Array, x: Array, y: Array, du: float, dv: float, geometry: Array, iterations: int = 6
) -> Array:
    """Disparity at (x, y) of the view that lies (du, dv) beside the one that `disparity` belongs to.

    The point seen at X in the wanted view is at ``X + d·(du, dv)`` in the given one; d is found by iterating from both
    ends, nearer surfaces first.

    Parameters
    ----------
    disparity
        float32 (T, S) on the lenses that `geometry` describes (`lfflow.kernels.gather.Samples`).
    x, y
        float (I, J), lens pitches.

    Returns
    -------
    float32 (I, J), NaN where the map has none.
    """
    out = np.empty(x.shape, dtype=np.float32)
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            d = _read(disparity, x[i, j], y[i, j], geometry)
            if du != 0 or dv != 0:
                for _ in range(iterations):
                    d = _read(disparity, x[i, j] + d * du, y[i, j] + d * dv, geometry) if not np.isnan(d) else d
            out[i, j] = d
    return out
