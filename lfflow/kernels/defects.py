"""Sensor pixels that lie: hot, dead, saturated."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

HOT, DEAD, SATURATED = 1, 2, 4
DEAD_FACTOR = 0.3


@numba.njit(nogil=True, cache=True)
def _around(image: npt.NDArray[np.float32], y: int, x: int) -> tuple[float, float]:
    """Darkest and brightest of the eight neighbours and of the four nearest pixels of the same colour."""
    low, high = np.inf, -np.inf
    for j in range(-1, 2):
        for i in range(-1, 2):
            if i != 0 or j != 0:
                value = float(image[y + j, x + i])
                low, high = min(low, value), max(high, value)
    for value in (image[y - 2, x], image[y + 2, x], image[y, x - 2], image[y, x + 2]):
        low, high = min(low, float(value)), max(high, float(value))
    return low, high


@numba.njit(nogil=True, cache=True)
def flag_pixels(
    raw: npt.NDArray[np.uint16],
    image: npt.NDArray[np.float32],
    white: npt.NDArray[np.float64],
    floor: float,
    hot_factor: float,
) -> npt.NDArray[np.uint8]:
    """Flags of the pixels of one frame, shape (y, x): bit 1 hot, bit 2 dead, bit 4 saturated.

    A hot pixel exceeds the brightest of its neighbours by `hot_factor`, a dead one has less than 0.3 times the
    darkest; the optics cannot draw that sharp a point.

    Parameters
    ----------
    raw, image
        Counts, and the gray image with equal gains (`lfflow.kernels.equalise`), shape (y, x).
    white
        White level of the 2×2 tile, counts, shape (2, 2).
    floor
        Brightness (of `image`) that is added to the neighbours of a hot pixel, and that those of a dead one exceed.
    hot_factor
        Above 1: low where the light is even, higher where a scene draws edges.
    """
    height, width = raw.shape
    flags = np.zeros(raw.shape, np.uint8)
    for y in range(height):
        inside = 2 <= y < height - 2
        for x in range(width):
            if raw[y, x] >= white[y % 2, x % 2]:
                flags[y, x] = SATURATED
            if not inside or x < 2 or x >= width - 2:
                continue
            value, beside = image[y, x], image[y, x + 1]
            if value > hot_factor * (beside + floor):
                if value > hot_factor * (_around(image, y, x)[1] + floor):
                    flags[y, x] |= HOT
            elif beside > floor and value < DEAD_FACTOR * beside:
                low = _around(image, y, x)[0]
                if low > floor and value < DEAD_FACTOR * low:
                    flags[y, x] |= DEAD
    return flags
