"""Which places of the central view each other view sees, by the disparities in front of them."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

_REACH = np.float32(0.75)
_NOTHING = np.float32(-1e30)


@numba.njit(nogil=True, cache=True)
def _project(disparity, u, v, nearest):  # type: ignore[no-untyped-def]
    """Largest disparity that lands on each place of the view; a surface that is stretched leaves no gaps."""
    rows, columns = disparity.shape
    nearest[:] = _NOTHING
    for t in range(rows):
        for s in range(columns):
            d = disparity[t, s]
            y, x = np.float32(t) - d * v, np.float32(s) - d * u
            top, left = int(np.ceil(y - _REACH)), int(np.ceil(x - _REACH))
            bottom, right = int(np.floor(y + _REACH)), int(np.floor(x + _REACH))
            for row in range(max(top, 0), min(bottom + 1, rows)):
                for column in range(max(left, 0), min(right + 1, columns)):
                    if nearest[row, column] < d:
                        nearest[row, column] = d


@numba.njit(nogil=True, cache=True)
def nearest_surface(disparity: FloatArray, u: np.float32, v: np.float32) -> FloatArray:
    """Largest disparity (t, s) of the central view that lands on each place of the view at (u, v)."""
    nearest = np.empty_like(disparity)
    _project(disparity, u, v, nearest)
    return nearest


@numba.njit(nogil=True, cache=True)
def seen_by(disparity: FloatArray, u: np.float32, v: np.float32, tolerance: np.float32) -> npt.NDArray[np.bool_]:
    """Whether the view at (u, v) sees each place (t, s) of the central one.

    Parameters
    ----------
    disparity
        (t, s) of the central view.
    tolerance
        How much nearer a surface may come without hiding the place.
    """
    rows, columns = disparity.shape
    nearest = nearest_surface(disparity, u, v)
    out = np.zeros((rows, columns), dtype=np.bool_)
    for t in range(rows):
        for s in range(columns):
            d = disparity[t, s]
            row, column = int(np.floor(t - d * v + 0.5)), int(np.floor(s - d * u + 0.5))
            if 0 <= row < rows and 0 <= column < columns:
                out[t, s] = nearest[row, column] <= d + tolerance
    return out
