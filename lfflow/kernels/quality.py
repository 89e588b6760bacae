"""The global method (seed 6.2.1): shape functions, the mask, its quality Υ over the image, and the ascent on it."""

from __future__ import annotations

import math
from typing import Literal

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.lattice_fit import moved
from lfflow.kernels.subimage import Geometry, geometry, offset_from_lens
from lfflow.lattice import Lattice

Shape = Literal["gaussian", "cosine4", "rectangular"]
SHAPES: tuple[Shape, ...] = ("gaussian", "cosine4", "rectangular")


@numba.njit(nogil=True, cache=True, inline="always")
def _shape(kind: int, radius: float, sigma: float) -> float:
    if kind == 0:
        return math.exp(-0.5 * (radius / sigma) ** 2)
    if kind == 1:
        return math.cos(math.pi * radius / (4.0 * sigma)) ** 4 if radius <= 2.0 * sigma else 0.0
    return 1.0 if radius <= sigma else 0.0


@numba.njit(nogil=True, cache=True)
def _quality(image: npt.NDArray[np.float32], lens: Geometry, kind: int, sigma: float) -> float:
    total = 0.0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            a, b = offset_from_lens(float(x), float(y), lens)
            total += image[y, x] * _shape(kind, math.sqrt(a * a + b * b), sigma)
    return total


def quality(image: npt.NDArray[np.float32], lattice: Lattice, shape: Shape, sigma: float) -> float:
    """Υ: sum over the image times the mask f ∗ Σδ(p − c_i) (seed equations 6.5 to 6.7), the nearest lens's term.

    Parameters
    ----------
    image
        Gray image with equal gains, shape (y, x); take its mean off, so that a mask of larger area gains nothing.
    lattice
        The parameters whose quality is asked.
    shape, sigma
        Shape function of the seed's Table 1 (its constants are lost in the text: the Gaussian is exp(−ρ²/2σ²), the
        cosine cos⁴(πρ/4σ) up to 2σ, the rectangle 1 up to σ) and its width, pixels.
    """
    return float(_quality(image, geometry(lattice), SHAPES.index(shape), sigma))


def ascend(
    image: npt.NDArray[np.float32], lattice: Lattice, shape: Shape = "gaussian", sigma: float = 2.5, rounds: int = 12
) -> Lattice:
    """Gradient ascent on Υ over (dh, dv, θ, C), one coordinate's parabola at a time, with shrinking steps.

    The lattice is numbered from the middle of the image while it climbs, so that pitch and origin do not lean on each
    other. The start must lie within about a third of a pitch everywhere (`lfflow.kernels.spectrum.start`).
    """
    height, width = image.shape
    flat = image - np.float32(image.mean())
    t, s = lattice.nearest((width - 1) / 2, (height - 1) / 2)
    cx, cy = lattice.centres(t - t % 2, s)
    now = Lattice(lattice.dh, lattice.dv, lattice.theta, float(cx), float(cy), lattice.arrangement)
    arm = max(height, width) / 2
    scale = np.array([lattice.dh / arm, lattice.dv / arm, 1 / arm, 1.0, 1.0]) * 0.1 * lattice.dh
    for _ in range(rounds):
        moves = np.zeros(5)
        for index in range(5):
            step = np.zeros(5)
            step[index] = scale[index]
            low, mid, high = (quality(flat, moved(now, sign * step), shape, sigma) for sign in (-1, 0, 1))
            bend = 2 * mid - low - high
            vertex = 0.5 * (high - low) / bend if bend > 0 else math.copysign(1.0, high - low)
            moves[index] = scale[index] * min(max(vertex, -1.0), 1.0)
            now = moved(now, moves * (np.arange(5) == index))
        scale = np.maximum(np.minimum(scale, 2 * np.abs(moves)), scale / 4)
    return now
