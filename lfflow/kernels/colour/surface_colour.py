"""Colours of the surfaces that the central view sees, on a fine grid, read back in every other view.

A surface point has one colour in all views that see it. So the samples of all views are gathered once, on a square grid
of `STEP` lens pitches in the central view, and a view p reads the point that it shows at X with disparity d at
``X + d·p``. Each grid point knows the slopes of its colours too; what lies between is blended from its four neighbours.
"""

from __future__ import annotations

from typing import Any

import cv2
import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

STEP = 0.5
"""Distance of two points of the grid, lens pitches."""

_F = np.float32
_LEAST = _F(0.5)
"""Share of the four neighbours that must lie on the same surface."""
_DARK = _F(0.02)
_AHEAD = round(0.5 / STEP)
"""Steps to either side over which the picture's steepness is measured."""
_QUIETEST = 1e-4
"""Least variance / value of a sample: even without noise its place is not exact."""


def surface_shape(width: float, height: float) -> tuple[int, int]:
    """Rows and columns of the grid that covers 0…width × 0…height, with a step to spare."""
    return int(height / STEP) + 3, int(width / STEP) + 3


def surface_places(shape: tuple[int, int]) -> tuple[Array, Array]:
    """X and Y of the grid, float32 of `shape`, lens pitches."""
    y, x = np.indices(shape, dtype=np.float32) * _F(STEP)
    return x, y


def steepness(green: Array, variance: Array, noise: float) -> Array:
    """Variance that a shift by one lens pitch makes of a colour, in units of that of one sample; on the grid.

    Parameters
    ----------
    green, variance
        float32 (rows, columns): a colour and the variance of its error.
    noise
        Variance / value of a sample.
    """
    value, ahead = np.nan_to_num(green), _AHEAD
    edged = cv2.copyMakeBorder(value, ahead, ahead, ahead, ahead, cv2.BORDER_REPLICATE)
    across = edged[ahead:-ahead, 2 * ahead :] - edged[ahead:-ahead, : -2 * ahead]
    down = edged[2 * ahead :, ahead:-ahead] - edged[: -2 * ahead, ahead:-ahead]
    moved = (across**2 + down**2 - 4 * np.nan_to_num(variance)) / np.float32(2 * ahead * STEP) ** 2
    side = (4 * ahead + 1, 4 * ahead + 1)
    level = np.maximum(cv2.blur(value, side), _DARK)
    return np.asarray(np.maximum(cv2.blur(moved, side), 0) / (np.float32(max(noise, _QUIETEST)) * level))


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _blend(planes: Array, disparity: Array, gx: float, gy: float, d: float, tolerance: Any, colours: Array) -> bool:
    """Write the three colours at (gx, gy), in steps of the grid; False where another surface is seen there."""
    rows, columns = disparity.shape
    if not (gx >= 0 and gy >= 0 and gx < columns - 1 and gy < rows - 1):
        return False
    left, top = int(gx), int(gy)
    fx, fy = gx - _F(left), gy - _F(top)
    red, green, blue, total = _F(0), _F(0), _F(0), _F(0)
    for corner in range(4):
        i, j = corner >> 1, corner & 1
        if not abs(disparity[top + i, left + j] - d) <= tolerance:
            continue
        share = (fy if i else _F(1) - fy) * (fx if j else _F(1) - fx)
        dx, dy = (fx - _F(j)) * _F(STEP), (fy - _F(i)) * _F(STEP)
        plane = planes[top + i, left + j]
        red += share * (plane[0, 0] + plane[0, 1] * dx + plane[0, 2] * dy)
        green += share * (plane[1, 0] + plane[1, 1] * dx + plane[1, 2] * dy)
        blue += share * (plane[2, 0] + plane[2, 1] * dx + plane[2, 2] * dy)
        total += share
    colours[0], colours[1], colours[2] = red / total, green / total, blue / total
    return bool(total >= _LEAST) and not np.isnan(red + green + blue)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def read_surface(
    planes: Array,
    disparity: Array,
    steep: Array,
    guessed: Array,
    targets: Any,
    tolerance: float,
    limit: float,
    rgb: Array,
    bits: Array,
) -> None:
    """Write the colours at `targets`, all of one view, into `rgb` (N, 3) and which were guessed into `bits` (N,).

    Where the surface cannot tell the colours they are NaN.

    Parameters
    ----------
    planes, disparity, steep
        float32 (rows, columns, colour, 3) and (rows, columns): value and slopes, disparity, `steepness`, on the grid.
    guessed
        uint8 (rows, columns): bits of the colours that no sample gave there.
    targets
        `lfflow.kernels.colour.gather.Targets`.
    tolerance
        Disparity difference at which the grid shows another surface.
    limit
        Largest variance of the error that the doubt makes there, in units of a sample's, with which it is read.
    """
    per_step = _F(1 / STEP)
    for n in range(targets.x.shape[0]):
        x, y, u, v, d = targets.x[n], targets.y[n], targets.u[n], targets.v[n], targets.disparity[n]
        gx, gy = (x + d * u) * per_step, (y + d * v) * per_step
        known = _blend(planes, disparity, gx, gy, d, _F(tolerance), rgb[n])
        error = targets.doubt[n] ** 2 * (u * u + v * v)
        row, column = int(gy + _F(0.5)), int(gx + _F(0.5))
        if known and error * steep[row, column] <= limit:
            bits[n] = guessed[row, column]
        else:
            rgb[n] = np.nan
