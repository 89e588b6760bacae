"""Which surface a lens beside a step of the disparity belongs to, told by its colour.

Matching gives a lens that sees only a little of the near surface to that surface, for the mixed colour moves with it:
near surfaces come out up to a lens too wide on every side. The lenses around that lie clear of the step tell the colour
of both surfaces; a lens belongs to the far one unless more than half of its own colour is that of the near one.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

UNCLEAR = 0.02
"""Weight, against 1, of a lens that lies at a step itself: it counts only where a surface has no other."""


def place_edges(
    disparity: FloatArray,
    picture: FloatArray,
    offset: FloatArray,
    row_pitch: float,
    *,
    step: float = 0.08,
    reach: float = 3.0,
    contrast: float = 0.04,
    scatter: float = 2.0,
    half: float = 0.5,
) -> FloatArray:
    """Disparity (t, s) whose steps lie where the colours of `picture` (3, t, s) change.

    Parameters
    ----------
    offset, row_pitch
        Geometry of the lattice, lens pitches.
    step
        Smallest difference of neighbours that separates two surfaces.
    reach
        Distance of the lenses that tell the colours of both sides, lens pitches.
    contrast
        Smallest distance of the two colours; below it nothing is changed.
    scatter
        Smallest square of that distance in units of the sum of the variances of the colours of both sides.
    half
        Share of the near colour from which a lens is near.
    """
    place = np.ascontiguousarray(offset, dtype=np.float32)
    found = np.ascontiguousarray(disparity, dtype=np.float32)
    beside = _beside_step(found, place, np.float32(step))
    out: FloatArray = found.copy()
    limits = np.array([step, reach, contrast, half, row_pitch, scatter], dtype=np.float32)
    _decide(found, np.ascontiguousarray(np.moveaxis(picture, 0, -1), dtype=np.float32), beside, place, limits, out)
    return out


@numba.njit(nogil=True, cache=True)
def _beside_step(disparity, offset, step):  # type: ignore[no-untyped-def]
    """2 at lenses (t, s) with a neighbour beyond a step, 1 at their other neighbours, 0 elsewhere."""
    rows, columns = disparity.shape
    out = np.zeros((rows, columns), dtype=np.uint8)
    for level in (2, 1):
        for t in range(rows):
            for s in range(columns):
                if out[t, s] > 0:
                    continue
                for row in range(max(t - 1, 0), min(t + 2, rows)):
                    for column in range(max(s - 1, 0), min(s + 2, columns)):
                        if abs(column + offset[row] - s - offset[t]) > 1.01:
                            continue
                        if level == 2 and abs(disparity[row, column] - disparity[t, s]) > step:
                            out[t, s] = 2
                        if level == 1 and out[row, column] == 2:
                            out[t, s] = 1
    return out


@numba.njit(nogil=True, cache=True)
def _decide(disparity, picture, beside, offset, limits, out):  # type: ignore[no-untyped-def]
    step, contrast, half = limits[0], limits[2], limits[3]
    sides = np.empty((2, 6))
    for t, s in zip(*np.nonzero(beside)):  # noqa: B905 - numba knows no strict zip
        low, high = _range(disparity, t, s)
        if not high - low > step:
            continue
        middle = (low + high) / 2
        _colours(disparity, picture, beside, offset, limits, t, s, middle, sides)
        if sides[0, 5] == 0 or sides[1, 5] == 0:
            continue
        apart, along = 0.0, 0.0
        for c in range(3):
            change = sides[1, c] - sides[0, c]
            apart += change * change
            along += (picture[t, s, c] - sides[0, c]) * change
        if apart < contrast * contrast + limits[5] * (sides[0, 4] + sides[1, 4]):
            continue
        near = along > half * apart
        if near != (disparity[t, s] > middle):
            out[t, s] = sides[1 if near else 0, 3]


@numba.njit(nogil=True, cache=True)
def _range(disparity, t, s):  # type: ignore[no-untyped-def]
    """Smallest and largest disparity within two rows and columns."""
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for row in range(max(t - 2, 0), min(t + 3, disparity.shape[0])):
        for column in range(max(s - 2, 0), min(s + 3, disparity.shape[1])):
            low, high = min(low, disparity[row, column]), max(high, disparity[row, column])
    return low, high


@numba.njit(nogil=True, cache=True)
def _colours(disparity, picture, beside, offset, limits, t, s, middle, sides):  # type: ignore[no-untyped-def]
    """Colour, disparity, variance of the colour and weight (6 numbers) of the far and the near lenses around (t, s)."""
    reach, pitch = limits[1], limits[4]
    deep, wide = int(np.ceil(reach / pitch)), int(np.ceil(reach)) + 1
    narrow = -0.5 / (0.4 * reach) ** 2
    sides[:] = 0
    for row in range(max(t - deep, 0), min(t + deep + 1, disparity.shape[0])):
        for column in range(max(s - wide, 0), min(s + wide + 1, disparity.shape[1])):
            x, y = column + offset[row] - s - offset[t], (row - t) * pitch
            square = x * x + y * y
            if square == 0 or square > reach * reach or np.isnan(disparity[row, column]):
                continue
            w = np.exp(narrow * square) * (UNCLEAR if beside[row, column] == 2 else 1.0)
            side = 1 if disparity[row, column] > middle else 0
            for c in range(3):
                sides[side, c] += w * picture[row, column, c]
                sides[side, 4] += w * picture[row, column, c] ** 2
            sides[side, 3] += w * disparity[row, column]
            sides[side, 5] += w
    for side in range(2):
        if sides[side, 5] > 0:
            sides[side, :5] /= sides[side, 5]
            sides[side, 4] -= (sides[side, :3] ** 2).sum()
