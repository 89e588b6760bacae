"""The mean subimage of a picture: how the light falls off from a lens centre to the aperture's edge."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from lfflow.lattice import Lattice

STEP = 0.5
"""Grid of a profile, sensor pixels."""

FloatImage = npt.NDArray[np.float32]
Profile = npt.NDArray[np.float64]
Geometry = tuple[float, float, float, float, float, float, bool]


def geometry(lattice: Lattice) -> Geometry:
    """Lattice as the numba kernels want it: cos, sin, dh, dv, cx, cy, hexagonal."""
    return (
        math.cos(lattice.theta),
        math.sin(lattice.theta),
        lattice.dh,
        lattice.dv,
        lattice.cx,
        lattice.cy,
        lattice.arrangement == "hexagonal",
    )


@numba.njit(nogil=True, cache=True, inline="always")
def offset_from_lens(x: float, y: float, lens: Geometry) -> tuple[float, float]:
    """Offset of a sensor point from its nearest lens centre, along the axes of the lattice, pixels."""
    cos, sin, dh, dv, cx, cy, hexagonal = lens
    gx, gy = (cos * (x - cx) + sin * (y - cy)) / dh, (-sin * (x - cx) + cos * (y - cy)) / dv
    if not hexagonal:
        return (gx - math.floor(gx + 0.5)) * dh, (gy - math.floor(gy + 0.5)) * dv
    height = 0.8660254037844386
    low = math.floor(gy / height)
    odd = 0.5 * (low % 2)
    ax, ay = gx - odd - math.floor(gx - odd + 0.5), gy - height * low
    other = 0.5 - odd
    bx, by = gx - other - math.floor(gx - other + 0.5), ay - height
    if bx * bx + by * by < ax * ax + ay * ay:
        ax, ay = bx, by
    return ax * dh, ay * dv


@numba.njit(nogil=True, cache=True)
def _accumulate(image: FloatImage, lens: Geometry, half: int, ceiling: float) -> tuple[Profile, Profile]:
    side = 2 * half + 1
    total, weight = np.zeros((side, side)), np.zeros((side, side))
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            value = image[y, x]
            if not value <= ceiling:
                continue
            a, b = offset_from_lens(float(x), float(y), lens)
            column, row = int(np.rint(a / STEP)) + half, int(np.rint(b / STEP)) + half
            if 0 <= column < side and 0 <= row < side:
                total[row, column] += value
                weight[row, column] += 1.0
    return total, weight


def mean_profile(image: FloatImage, lattice: Lattice, ceiling: float = 4.0) -> Profile:
    """Mean of the subimages of all lenses on a grid of half pixels about the centre, 1 at its peak.

    Parameters
    ----------
    image
        Gray image, shape (y, x), the scene divided out.
    lattice
        Where the lenses are.
    ceiling
        Samples above it (highlights) are left out.

    Returns
    -------
    profile
        Shape (2n + 1, 2n + 1), rows down, the lens centre in the middle.
    """
    half = int(np.ceil(0.62 * max(lattice.dh, lattice.dv) / STEP)) + 1
    total, weight = _accumulate(image, geometry(lattice), half, ceiling)
    profile = np.where(weight > 0, total / np.maximum(weight, 1), 0.0)
    return profile / max(float(profile.max()), 1e-12)


@numba.njit(nogil=True, cache=True)
def _spread(profile: Profile, lens: Geometry, out: FloatImage) -> None:
    half = profile.shape[0] // 2
    last = profile.shape[0] - 1.001
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            a, b = offset_from_lens(float(x), float(y), lens)
            px, py = min(max(a / STEP + half, 0.0), last), min(max(b / STEP + half, 0.0), last)
            i, j = int(px), int(py)
            fx, fy = px - i, py - j
            top = profile[j, i] * (1 - fx) + profile[j, i + 1] * fx
            bottom = profile[j + 1, i] * (1 - fx) + profile[j + 1, i + 1] * fx
            out[y, x] = top * (1 - fy) + bottom * fy


def spread_profile(profile: Profile, lattice: Lattice, shape: tuple[int, int]) -> FloatImage:
    """Value of the mean subimage at every sensor pixel, float32 (y, x)."""
    out = np.empty(shape, np.float32)
    _spread(profile, geometry(lattice), out)
    return out
