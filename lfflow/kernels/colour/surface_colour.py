"""Colours of the surfaces that the central view sees, on a fine grid, read back in every other view.

A surface point has one colour in all views that see it. So the samples of all views are gathered once, on a square grid
of `STEP` lens pitches in the central view, and a view p reads the point that it shows at X with disparity d at
``X + d·p``. Each grid point knows the slopes of its colours too; what lies between is blended from its four neighbours.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

STEP = 0.6
"""Distance of two points of the grid, lens pitches."""

_F = np.float32
_LEAST = _F(0.5)
"""Share of the four neighbours that must lie on the same surface."""
_REACH = _F(0.6)
"""Lens pitches at which a view's own sample says nothing about a place any more."""
_DARK = _F(0.02)
_KEEP = _F(16.0)
"""Inverse of the product of doubt² and baseline² (in lens pitches) at which a view's own sample counts half."""
_LITTLE = _F(0.03)
"""Share of its own sample below which a view's place does without."""


def surface_shape(width: float, height: float) -> tuple[int, int]:
    """Rows and columns of the grid that covers 0…width × 0…height, with a step to spare."""
    return int(height / STEP) + 3, int(width / STEP) + 3


def surface_places(shape: tuple[int, int]) -> tuple[Array, Array]:
    """X and Y of the grid, float32 of `shape`, lens pitches."""
    y, x = np.indices(shape, dtype=np.float32) * _F(STEP)
    return x, y


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
    planes: Array, disparity: Array, samples: Any, view: int, targets: Any, rule: Any, limit: float, rgb: Array
) -> None:
    """Write the colours at `targets`, all of one view, into `rgb` (N, 3); NaN where the surface cannot tell them.

    The view's own sample is kept the more the less certain the surface is there: its ratio to the surface's colour at
    the place where it was taken goes to all three colours.

    Parameters
    ----------
    planes, disparity
        float32 (rows, columns, colour, 3) and (rows, columns): value and slopes, and disparity, on the grid.
    samples, targets, rule
        `lfflow.kernels.colour.gather.Samples`, `Targets`, `Rule`.
    view
        Index of the targets' view among the samples, −1 for a viewpoint that has none.
    limit
        Doubt × distance from the central view (lens pitches) above which nothing is read.
    """
    rows, columns = samples.colour.shape[1], samples.colour.shape[2]
    pitch, half, odd = samples.geometry[0], samples.geometry[1], int(samples.geometry[2])
    per_step, tolerance = _F(1 / STEP), _F(rule.tolerance)
    there = np.empty(3, dtype=np.float32)
    for n in range(targets.x.shape[0]):
        x, y, u, v, d = targets.x[n], targets.y[n], targets.u[n], targets.v[n], targets.disparity[n]
        sure = targets.doubt[n] ** 2 * (u * u + v * v) <= limit**2
        if not (
            sure and _blend(planes, disparity, (x + d * u) * per_step, (y + d * v) * per_step, d, tolerance, rgb[n])
        ):
            rgb[n] = np.nan
            continue
        row = int(np.floor(y / pitch + _F(0.5)))
        shift = half * _F((row + odd) & 1)
        column = int(np.floor(x - shift + _F(0.5)))
        if view < 0 or row < 0 or row >= rows or column < 0 or column >= columns:
            continue
        colour = samples.colour[view, row, column]
        to_x, to_y = _F(column) + shift - x, _F(row) * pitch - y
        near = _F(1) - (to_x * to_x + to_y * to_y) / (_REACH * _REACH)
        if colour > 2 or near <= 0:
            continue
        u, v = u + samples.residual[0, row, column], v + samples.residual[1, row, column]
        keep = _KEEP * targets.doubt[n] ** 2 * (u * u + v * v) * samples.weight[view, row, column] * near
        keep /= _F(1) + keep
        gx, gy = (x + to_x + d * u) * per_step, (y + to_y + d * v) * per_step
        if keep < _LITTLE or not _blend(planes, disparity, gx, gy, d, tolerance, there):
            continue
        ratio = max(samples.value[view, row, column], _F(0)) / max(there[colour], _DARK)
        gain = _F(1) + (ratio - _F(1)) * keep
        if not np.isnan(gain):
            for k in range(3):
                rgb[n, k] *= gain
