"""Missing colours of a reconstructed view, filled from its neighbours by differences of colours."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_REACH = 3


@numba.njit(nogil=True, cache=True)
def _place_weight(x: Array, y: Array, disparity: Array, i: int, j: int, r: int, c: int, tolerance: float) -> float:
    dx, dy = x[r, c] - x[i, j], y[r, c] - y[i, j]
    weight = 1.0 / (0.05 + dx * dx + dy * dy) ** 2
    apart = disparity[r, c] - disparity[i, j]
    if not np.isnan(apart):
        weight /= (1.0 + (apart / tolerance) ** 2) ** 2
    return float(weight)


@numba.njit(nogil=True, cache=True)
def _mean_near(
    rgb: Array, x: Array, y: Array, disparity: Array, i: int, j: int, channel: int, other: int, tolerance: float
) -> float:
    """Weighted mean of ``channel − other`` (or of ``channel`` when they are equal) around (i, j)."""
    total, weight = 0.0, 0.0
    for r in range(max(i - _REACH, 0), min(i + _REACH + 1, rgb.shape[0])):
        for c in range(max(j - _REACH, 0), min(j + _REACH + 1, rgb.shape[1])):
            value = rgb[r, c, channel] - (rgb[r, c, other] if other != channel else np.float32(0.0))
            if not np.isnan(value):
                w = _place_weight(x, y, disparity, i, j, r, c, tolerance)
                total += w * value
                weight += w
    return float(total / weight) if weight > 0 else np.nan


@numba.njit(nogil=True, cache=True)
def _guess(rgb: Array, x: Array, y: Array, disparity: Array, i: int, j: int, channel: int, tolerance: float) -> float:
    for other in (1, 0, 2):
        if other != channel and not np.isnan(rgb[i, j, other]):
            difference = _mean_near(rgb, x, y, disparity, i, j, channel, other, tolerance)
            if not np.isnan(difference):
                return float(max(rgb[i, j, other] + difference, 0.0))
    return _mean_near(rgb, x, y, disparity, i, j, channel, channel, tolerance)


@numba.njit(nogil=True, cache=True)
def fill_colours(rgb: Array, x: Array, y: Array, disparity: Array, tolerance: float) -> tuple[Array, Array]:
    """Picture with its NaN colours interpolated from places of the same surface nearby, and which ones were.

    Where another colour is known, the difference of the two is interpolated (it is smoother than either), else the
    colour itself.

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
            for channel in range(3):
                if np.isnan(rgb[i, j, channel]):
                    out[i, j, channel] = _guess(rgb, x, y, disparity, i, j, channel, tolerance)
                    bits[i, j] |= 8 if np.isnan(out[i, j, channel]) else 1 << channel
    return out, bits
