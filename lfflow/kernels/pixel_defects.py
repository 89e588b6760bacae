"""Hot and dead pixels: what sticks out of its eight same-colour neighbours, once the subimages are taken out.

Neighbours of one colour are two pixels apart, where the light of a subimage differs by far more than any threshold
could bear. So each pixel is compared with what its neighbours would read at its own place in the mean subimage.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.demultiplex import owner
from lfflow.lattice import Lattice

CELLS = 4
"""Cells of the mean subimage per sensor pixel."""

FAINT = 0.05
"""Share of the mean subimage's peak below which a neighbour says nothing about the pixel."""

Float32Array = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]

HOT, DEAD = 1, 2


def mean_subimage(radiance: Float32Array, lattice: Lattice) -> Float32Array:
    """Mean of a frame (y, x) by the place in the subimage, 1 at its peak: square, `CELLS` cells per pixel."""
    side = 2 * CELLS * math.ceil(0.65 * max(lattice.dh, lattice.dv)) + 1
    total, count = np.zeros((side, side)), np.zeros((side, side))
    _add_subimages(np.ascontiguousarray(radiance, np.float32), _geometry(lattice), total, count)
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    profile: Float32Array = np.maximum(mean / max(mean.max(), 1e-12), 0).astype(np.float32)
    return profile


def aberrant_pixels(radiance: Float32Array, lattice: Lattice, *, threshold: float = 0.12) -> ByteArray:
    """Flags (y, x) of the pixels that stick out of their 8 same-colour neighbours: 1 above, 2 below.

    Parameters
    ----------
    radiance
        (y, x), 0 black level, 1 white level, not devignetted.
    threshold
        By how much a hot pixel must exceed the largest reading that its neighbours suggest, or by twice
        as much the second largest; radiance. A dead one must
        lie below a tenth of the smallest, where that exceeds a third of `threshold`. A second pass leaves out the
        neighbours that the first has marked, so that defects side by side do not hide each other.
    """
    flags = np.zeros(radiance.shape, np.uint8)
    frame = np.ascontiguousarray(radiance, np.float32)
    geometry, profile = _geometry(lattice), mean_subimage(frame, lattice)
    for _ in range(2):
        _mark(frame, geometry, profile, threshold, flags)
    return flags


def hot_in_dark(radiance: Float32Array, *, threshold: float = 0.03, sigmas: float = 8.0) -> ByteArray:
    """Flags (y, x), 1 where a dark frame is brighter than its median by `threshold` and by `sigmas` of its noise."""
    median = float(np.median(radiance))
    noise = 1.4826 * float(np.median(np.abs(radiance - median)))
    return (radiance > median + max(threshold, sigmas * noise)).astype(np.uint8)


def _geometry(lattice: Lattice) -> tuple[Any, ...]:
    (a, b), (c, d) = lattice.matrix
    turn = (math.cos(lattice.theta), math.sin(lattice.theta), lattice.dh, lattice.dv, lattice.cx, lattice.cy)
    return turn, (float(a), float(b), float(c), float(d)), lattice.arrangement == "hexagonal"


@numba.njit(nogil=True, cache=True)
def _place(x, y, geometry):  # type: ignore[no-untyped-def]
    """Offset (x, y) of a sensor pixel from the centre of its lens."""
    (cos, sin, dh, dv, cx, cy), (a, b, c, d), hexagonal = geometry
    px, py = x - cx, y - cy
    t, s = owner((cos * px + sin * py) / dh, (-sin * px + cos * py) / dv, hexagonal)
    k1 = s - t // 2 if hexagonal else s
    return px - a * k1 - b * t, py - c * k1 - d * t


@numba.njit(nogil=True, cache=True)
def _add_subimages(radiance, geometry, total, count):  # type: ignore[no-untyped-def]
    half = total.shape[0] // 2
    for y in range(radiance.shape[0]):
        for x in range(radiance.shape[1]):
            dx, dy = _place(x, y, geometry)
            i, j = half + round(CELLS * dy), half + round(CELLS * dx)
            if 0 <= i < total.shape[0] and 0 <= j < total.shape[0]:
                total[i, j] += radiance[y, x]
                count[i, j] += 1


@numba.njit(nogil=True, cache=True)
def _shade(x, y, geometry, profile):  # type: ignore[no-untyped-def]
    half = profile.shape[0] // 2
    dx, dy = _place(x, y, geometry)
    i, j = half + round(CELLS * dy), half + round(CELLS * dx)
    return profile[i, j] if 0 <= i < profile.shape[0] and 0 <= j < profile.shape[0] else np.float32(0)


@numba.njit(nogil=True, cache=True)
def _suggested(x, y, radiance, geometry, profile, mine, flags):  # type: ignore[no-untyped-def]
    """Smallest, largest and second largest reading at (x, y) that the neighbours suggest; (inf, -inf, -inf) without."""
    low, high, second = np.inf, -np.inf, -np.inf
    for dy in (-2, 0, 2):
        for dx in (-2, 0, 2):
            i, j = y + dy, x + dx
            if (dx == 0 and dy == 0) or i < 0 or j < 0 or i >= radiance.shape[0] or j >= radiance.shape[1]:
                continue
            if flags[i, j] != 0:
                continue
            theirs = _shade(j, i, geometry, profile)
            if theirs >= FAINT:
                reading = radiance[i, j] / theirs * mine
                low = min(low, reading)
                second = max(second, min(high, reading))
                high = max(high, reading)
    return low, high, second


@numba.njit(nogil=True, cache=True)
def _mark(radiance, geometry, profile, threshold, flags):  # type: ignore[no-untyped-def]
    for y in range(radiance.shape[0]):
        for x in range(radiance.shape[1]):
            value = radiance[y, x]
            if not _sticks_out(x, y, radiance, value, threshold):
                continue
            low, high, second = _suggested(x, y, radiance, geometry, profile, _shade(x, y, geometry, profile), flags)
            if value > min(1.1 * max(high, 0.0) + threshold, 1.1 * max(second, 0.0) + 2 * threshold):
                flags[y, x] = HOT
            elif low > threshold / 3 and value < 0.1 * low and np.isfinite(low):
                flags[y, x] = DEAD


@numba.njit(nogil=True, cache=True)
def _sticks_out(x, y, radiance, value, threshold):  # type: ignore[no-untyped-def]
    """A quick look that spares most pixels the search: neither bright enough to be hot nor dark enough to be dead."""
    if value > threshold:
        return True
    brightest = np.float32(0)
    for i in range(max(y - 2, 0), min(y + 3, radiance.shape[0]), 2):
        for j in range(max(x - 2, 0), min(x + 3, radiance.shape[1]), 2):
            brightest = max(brightest, radiance[i, j])
    return value < 0.1 * brightest
