"""A view in the brick layout resampled onto a square grid, with the true geometry of the lattice."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]

DENSE_REACH = 1.0
"""Reach of the tent in lens pitches: linear interpolation, where every lens has the colour."""

SPARSE_REACH = 3.0
"""Reach in lens pitches where only some lenses have the colour: on an F01, red comes back every fourth row."""


def square_shape(rows: int, columns: int, row_pitch: float, scale: int) -> tuple[int, int]:
    """Rows and columns of the square grid that spans a brick grid; ``row_pitch`` in lens pitches."""
    return math.floor((rows - 1) * row_pitch * scale + 0.5) + 1, (columns - 1) * scale + 1


def resample_square(
    values: npt.NDArray[Any],
    weights: npt.NDArray[Any],
    row_pitch: float,
    *,
    hexagonal: bool,
    scale: int,
    reach: float = DENSE_REACH,
) -> Float32Array:
    """Square grid (rows, columns) of a plane (t, s): weighted mean of the lenses within `reach`, NaN without any.

    Point (i, j) lies at X = j/scale, Y = i/scale in lens pitches. ``weights`` (t, s) are 0 where there is no value.
    The kernel is a tent up to one lens pitch and a Gaussian (σ = reach/4) beyond.
    """
    square: Float32Array = _resample(
        np.ascontiguousarray(values, dtype=np.float32),
        np.ascontiguousarray(weights, dtype=np.float32),
        row_pitch,
        0.5 if hexagonal else 0.0,
        scale,
        reach,
        square_shape(values.shape[0], values.shape[1], row_pitch, scale),
    )
    return square


@numba.njit(nogil=True, cache=True)
def _resample(values, weights, row_pitch, offset, scale, reach, shape):  # type: ignore[no-untyped-def]
    # pragma: no cover - compiled
    rows, columns = values.shape
    out = np.full(shape, np.nan, np.float32)
    reach_y = max(reach, row_pitch)
    spread = 2.0 * (reach / 4.0) ** 2
    for i in range(shape[0]):
        y = i / scale
        first = max(0, math.ceil((y - reach_y) / row_pitch))
        last = min(rows - 1, math.floor((y + reach_y) / row_pitch))
        for j in range(shape[1]):
            x = j / scale
            total = np.float32(0)
            norm = np.float32(0)
            for t in range(first, last + 1):
                shift = offset * (t & 1)
                dy = y - t * row_pitch
                for s in range(
                    max(0, math.ceil(x - shift - reach)), min(columns - 1, math.floor(x - shift + reach)) + 1
                ):
                    w = weights[t, s]
                    if w > 0:
                        dx = x - s - shift
                        if reach > 1.0:
                            w *= math.exp(-(dx * dx + dy * dy) / spread)
                        else:
                            w *= max(0.0, 1 - abs(dx)) * max(0.0, 1 - abs(dy) / row_pitch)
                        total += np.float32(w) * values[t, s]
                        norm += np.float32(w)
            if norm > 0:
                out[i, j] = total / norm
    return out
