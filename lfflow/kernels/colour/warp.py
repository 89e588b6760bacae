"""The disparity of one view, read between lenses and in views between those that have a map."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_JUMP = 0.1
"""Disparity difference (lens pitches per view step) across which maps are not interpolated."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _read(values: Array, x: float, y: float, geometry: Array) -> float:
    """Bilinear between the four lenses around (x, y), but never across a jump: the nearest lens tells the surface."""
    rows, columns = values.shape
    pitch, half, odd = geometry[0], geometry[1], int(geometry[2])
    upper = int(np.floor(y / pitch))
    down = y / pitch - upper
    best, most = np.float32(np.nan), np.float32(-1.0)
    total, weight = np.float32(0.0), np.float32(0.0)
    for again in range(2):
        for corner in range(4):
            row = upper + (corner >> 1)
            place = x - half * ((row + odd) & 1)
            left = int(np.floor(place))
            along = place - left
            share = (down if corner >> 1 else 1.0 - down) * (along if corner & 1 else 1.0 - along)
            value = values[min(max(row, 0), rows - 1), min(max(left + (corner & 1), 0), columns - 1)]
            if np.isnan(value):
                continue
            if again == 0 and share > most:
                best, most = value, share
            elif again == 1 and abs(value - best) < _JUMP:
                total += share * value
                weight += share
    return float(total / weight) if weight > 0 else float(best)


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
        float32 (T, S) on the lenses that `geometry` describes (`lfflow.kernels.colour.gather.Samples`).
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
