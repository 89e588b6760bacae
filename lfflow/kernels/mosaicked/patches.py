"""A picture between its lenses: bicubic patches through the values and slopes at the lenses.

Their slopes are those of cubic splines: a central difference tells a fifth less than there is of the finest texture, so
that what is matched would lie a fifth too far near disparity 0. Along a row the lenses lie evenly; the rows above and
below are read beside them, at the same X, so that the brick layout needs no resampling.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

FloatArray = npt.NDArray[np.float32]

DETAIL = 3.0
"""Gaussian, lens pitches, beyond which a picture's change is no detail."""
_VALUE, _RIGHT, _DOWN, _BOTH, _FINE_RIGHT, _FINE_DOWN = range(6)
_PARTS = 6


def patches(picture: FloatArray, offset: FloatArray, row_pitch: float) -> FloatArray:
    """Patches (colour, t, s, 6): value, slopes to the right (per lens) and down (per row), both; those of the detail.

    Parameters
    ----------
    picture
        (colour, t, s) values at the lenses.
    offset
        (t,) X of lens s=0 of each row, lens pitches.
    row_pitch
        Distance of the rows, lens pitches.
    """
    columns = np.arange(picture.shape[-1])
    right, down = _slopes(picture, offset)
    both = CubicSpline(columns, down, axis=-1)(columns, 1)
    fine = [np.stack([one - _blurred(one, row_pitch) for one in slope]) for slope in (right, down)]
    return np.stack([picture, right, down, both, *fine], axis=-1).astype(np.float32)


def _blurred(slope: FloatArray, row_pitch: float) -> FloatArray:
    """Slope (t, s) of what is no detail."""
    return np.asarray(cv2.GaussianBlur(slope, (0, 0), DETAIL, sigmaY=DETAIL / row_pitch), dtype=np.float32)


def _slopes(values: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes (colour, t, s) to the right and down of the splines along the row and at one X through all rows."""
    columns = np.arange(values.shape[-1])
    along = CubicSpline(columns, values, axis=-1)
    down = np.empty_like(values)
    for place in np.unique(offset):
        here, beside = offset == place, values.copy()
        for other in np.unique(offset[~here]):
            there = offset == other
            beside[:, there] = along(np.clip(columns + place - other, 0, columns[-1]))[:, there]
        down[:, here] = CubicSpline(np.arange(len(offset)), beside, axis=-2)(np.flatnonzero(here), 1)
    return along(columns, 1).astype(np.float32), down


@numba.njit(nogil=True, cache=True, inline="always")
def _left(place, count):  # type: ignore[no-untyped-def]
    """First of the two samples around a place within the row, and how far behind it the place lies."""
    place = min(max(place, np.float32(0)), np.float32(count - 1))
    left = min(np.uint32(place), np.uint32(count - 2))
    return left, place - np.float32(left)


@numba.njit(nogil=True, cache=True, inline="always")
def _hermite(value, slope, next_value, next_slope, f):  # type: ignore[no-untyped-def]
    """Cubic through two values with their slopes."""
    rise = next_value - value
    square = np.float32(3) * rise - np.float32(2) * slope - next_slope
    cube = slope + next_slope - np.float32(2) * rise
    return value + f * (slope + f * (square + f * cube))


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def read_patch(patch, offset, x, y, c):  # type: ignore[no-untyped-def]
    """Picture of colour c at X = x, row y, and the slopes to the right (per lens) and down (per row) of its detail."""
    rows, columns = patch.shape[1:3]
    upper, f = _left(y, rows)
    lower = upper + np.uint32(1)
    value, down, g_x, g_y = _read_row(patch, c, upper, x - offset[upper], columns)
    next_value, next_down, next_g_x, next_g_y = _read_row(patch, c, lower, x - offset[lower], columns)
    return _hermite(value, down, next_value, next_down, f), g_x + f * (next_g_x - g_x), g_y + f * (next_g_y - g_y)


@numba.njit(nogil=True, cache=True, inline="always")
def _read_row(patch, c, row, place, columns):  # type: ignore[no-untyped-def]
    """Value, slope down and slopes of the detail at a place of a row."""
    at, f = _left(place, columns)
    to = at + np.uint32(1)
    value = _hermite(patch[c, row, at, _VALUE], patch[c, row, at, _RIGHT], patch[c, row, to, _VALUE],
                     patch[c, row, to, _RIGHT], f)  # fmt: skip
    down = _hermite(patch[c, row, at, _DOWN], patch[c, row, at, _BOTH], patch[c, row, to, _DOWN],
                    patch[c, row, to, _BOTH], f)  # fmt: skip
    g_x, g_y = patch[c, row, at, _FINE_RIGHT], patch[c, row, at, _FINE_DOWN]
    return (
        value,
        down,
        g_x + f * (patch[c, row, to, _FINE_RIGHT] - g_x),
        g_y + f * (patch[c, row, to, _FINE_DOWN] - g_y),
    )
