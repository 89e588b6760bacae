"""The global method (seed 6.2.1): shape functions, the mask made of them, and its quality Υ over the image.

The mask is m = f ∗ Σδ(p − c_i), so that Υ = Σ_p I(p)·m(p) = Σ_i (I ⋆ f)(c_i): the image correlated with the shape once,
and summed over the lens centres (`lfflow.kernels.lattice.ascent` climbs on that form).
"""

from __future__ import annotations

import math
from typing import Literal

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.lattice.subimage import Geometry, geometry
from lfflow.lattice import Lattice

Shape = Literal["gaussian", "cosine4", "rectangular"]
SHAPES: tuple[Shape, ...] = ("gaussian", "cosine4", "rectangular")

FloatImage = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]

GAUSSIAN_SCALE = 2**0.25
COSINE_REACH = 2.75
"""Radius, in σ, where the cosine's power 4 ends."""


def reach(shape: Shape, sigma: float) -> float:
    """Radius beyond which a shape function is 0, pixels."""
    return sigma * {"gaussian": 3.5, "cosine4": COSINE_REACH, "rectangular": 1.0}[shape]


def shape_function(shape: Shape, radius: npt.ArrayLike, sigma: float) -> FloatArray:
    """Value f of a shape function at distances `radius` (pixels) from the centre, 1 there.

    exp(−ρ²/√2σ²), cos⁴(πρ/5.5σ) up to 2.75σ, and 1 up to σ. The seed's Table 1 has lost its digits; these widths are
    those with which the fifteen values of its Table 2 are met (`pipelines/seed_sensibility.py`).
    """
    radius = np.asarray(radius, dtype=np.float64)
    if shape == "gaussian":
        value = np.exp(-((radius / (GAUSSIAN_SCALE * sigma)) ** 2))
    elif shape == "cosine4":
        value = np.cos(np.minimum(radius / (COSINE_REACH * sigma), 1.0) * np.pi / 2) ** 4
    else:
        value = np.ones_like(radius)
    return np.asarray(np.where(radius <= reach(shape, sigma), value, 0.0), dtype=np.float64)


@numba.njit(nogil=True, cache=True)
def _quality(image: FloatImage, lens: Geometry, table: FloatArray, step: float, limit: float) -> float:
    """Υ; `table`: the shape at the squared radii 0, step, 2·step … up to limit²."""
    cos, sin, dh, dv, cx, cy, hexagonal = lens
    height, width = image.shape
    row_step, tilt = (0.8660254037844386 if hexagonal else 1.0), (0.5 if hexagonal else 0.0)
    far = math.hypot(max(abs(cx), abs(width - cx)), max(abs(cy), abs(height - cy))) + limit
    rows, columns = int(far / (row_step * dv)) + 1, int(far / dh) + 1
    total = 0.0
    for t in range(-rows, rows + 1):
        first = -int(math.floor(tilt * t))  # noqa: RUF046 - numba's floor gives a float
        for k in range(first - columns, first + columns + 1):
            gx, gy = dh * (k + tilt * t), dv * row_step * t
            x, y = cx + cos * gx - sin * gy, cy + sin * gx + cos * gy
            if not (-limit < x < width - 1 + limit and -limit < y < height - 1 + limit):
                continue
            for j in range(max(0, math.ceil(y - limit)), min(height, math.floor(y + limit) + 1)):
                for i in range(max(0, math.ceil(x - limit)), min(width, math.floor(x + limit) + 1)):
                    square = (i - x) ** 2 + (j - y) ** 2
                    if square <= limit * limit:
                        place = square / step
                        index = int(place)
                        part = place - index
                        total += image[j, i] * (table[index] * (1.0 - part) + table[index + 1] * part)
    return total


def quality(image: FloatImage, lattice: Lattice, shape: Shape, sigma: float) -> float:
    """Υ: sum over the image times the mask f ∗ Σδ(p − c_i) (seed equations 6.5 and 6.6).

    Parameters
    ----------
    image
        Gray image with equal gains, shape (y, x); take its mean off, so that a mask of larger area gains nothing.
    lattice
        The parameters whose quality is asked, sensor pixels and radians.
    shape, sigma
        Shape function (`shape_function`) and its width, pixels.
    """
    limit = reach(shape, sigma)
    squares = np.linspace(0.0, limit**2, 2049)
    table = np.append(shape_function(shape, np.sqrt(squares), sigma), 0.0)
    return float(_quality(image, geometry(lattice), table, squares[1], limit))
