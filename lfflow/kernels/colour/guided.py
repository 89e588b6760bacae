"""Missing colours of a reconstructed view, filled from its neighbours by differences of colours."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_REACH = 3


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _weight(x: Array, y: Array, disparity: Array, i: int, j: int, r: int, c: int, tolerance: float) -> float:
    dx, dy = x[r, c] - x[i, j], y[r, c] - y[i, j]
    weight = np.float32(1.0) / (np.float32(0.05) + dx * dx + dy * dy) ** 2
    apart = (disparity[r, c] - disparity[i, j]) / np.float32(tolerance)
    if not np.isnan(apart):
        weight /= (np.float32(1.0) + apart * apart) ** 2
    return float(weight)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add(sums: Array, near: Array, known: Array, weight: float) -> None:
    """Add a neighbour's colours, and their differences from the `known` ones, to sums (wanted, other, 2)."""
    for wanted in range(3):
        for other in range(3):
            if known[wanted] or not (other == wanted or known[other]):
                continue
            value = near[wanted] - (near[other] if other != wanted else np.float32(0.0))
            if not np.isnan(value):
                sums[wanted, other, 0] += weight * value
                sums[wanted, other, 1] += weight


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _guess(rgb: Array, x: Array, y: Array, disparity: Array, i: int, j: int, tolerance: float, out: Array) -> None:
    """Write the missing colours of place (i, j) into `out` (3,)."""
    known = ~np.isnan(rgb[i, j])
    sums = np.zeros((3, 3, 2))
    for r in range(max(i - _REACH, 0), min(i + _REACH + 1, rgb.shape[0])):
        for c in range(max(j - _REACH, 0), min(j + _REACH + 1, rgb.shape[1])):
            if not (np.isnan(rgb[r, c, 0]) and np.isnan(rgb[r, c, 1]) and np.isnan(rgb[r, c, 2])):
                _add(sums, rgb[r, c], known, _weight(x, y, disparity, i, j, r, c, tolerance))
    for wanted in range(3):
        if known[wanted]:
            continue
        out[wanted] = sums[wanted, wanted, 0] / sums[wanted, wanted, 1]
        for other in (2, 0, 1):
            if known[other] and sums[wanted, other, 1] > 0:
                out[wanted] = max(rgb[i, j, other] + sums[wanted, other, 0] / sums[wanted, other, 1], 0.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def fill_colours(rgb: Array, x: Array, y: Array, disparity: Array, tolerance: float) -> tuple[Array, Array]:
    """Picture with its NaN colours interpolated from places of the same surface nearby, and which ones were.

    Where another colour is known (green first), the difference of the two is interpolated (it is smoother than either),
    else the colour itself.

    Parameters
    ----------
    rgb
        float32 (I, J, 3), NaN where unknown.
    x, y, disparity
        float32 (I, J): places in lens pitches and their disparity; a neighbour counts less the more its own differs.
    tolerance
        Disparity difference at which a neighbour counts a quarter.

    Returns
    -------
    filled, bits
        float32 (I, J, 3); uint8 (I, J): 1 red, 2 green, 4 blue interpolated, 8 for what is still unknown.
    """
    out = rgb.copy()
    bits = np.zeros(rgb.shape[:2], dtype=np.uint8)
    for i in range(rgb.shape[0]):
        for j in range(rgb.shape[1]):
            if not np.isnan(rgb[i, j, 0] + rgb[i, j, 1] + rgb[i, j, 2]):
                continue
            _guess(rgb, x, y, disparity, i, j, tolerance, out[i, j])
            for channel in range(3):
                if np.isnan(rgb[i, j, channel]):
                    bits[i, j] |= 8 if np.isnan(out[i, j, channel]) else 1 << channel
    return out, bits
