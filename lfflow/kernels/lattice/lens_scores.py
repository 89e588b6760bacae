"""Per-lens score: how far each lens lies from where the lattice puts it, by the light of its own cell alone.

Model of a pixel at offset ρ from its lens: m = (β + γ·ρ)·l(ρ), with β the lens's brightness, γ a gradient across it and
l the light under the two discs (`lens_light`). One Gauss-Newton step of every lens, with the sensor's
noise, leaves its normal equations. A neighbour's light never enters, so that a brightness that changes from lens to
lens does not move the centres.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.lattice.lens_light import (
    BY_COMMON,
    BY_F,
    BY_FOLD,
    BY_H,
    BY_X,
    BY_Y,
    COLUMNS,
    DX,
    DY,
    H_RADIUS,
    H_SLOPE,
    LIGHT,
    RADIUS,
    SITE,
    UNSURE,
    VALUE,
    Cell,
    Flags,
    FloatArray,
    FloatImage,
    gather_pixels,
)
from lfflow.kernels.lattice.radial import FINE

LEVELS = 24
"""Bins of the noise model over the range 0…`TOP` of the model."""
TOP = 2.5
OUTLIER = 5.0
DENSE = 8
"""Parameters of a lens: β, γx, γy (relative; 1 / px), centre x, y, place of the second disc x, y (pixels), and the
common share of the edges' blur."""
PLAIN = 6
"""Those of a lens without a second disc: the last is the share of the light from beyond the border."""


class Sums(NamedTuple):
    """Moments (number, level, squared residual) by site and level (4, 3, LEVELS); value and model by site (2, 4)."""

    levels: FloatArray
    sites: FloatArray


@numba.njit(nogil=True, cache=True, fastmath=True)
def derive(
    pixels: FloatArray, count: int, bright: float, ox: float, oy: float, look: Any, slopes: FloatArray, sums: Any
) -> tuple[float, int]:
    """Rows of `slopes` (DENSE + 2): derivatives of a lens's parameters in σ, residual in σ, 1 / σ; χ² and pixels."""
    squares, used = 0.0, 0
    for k in range(count):
        site = int(pixels[SITE, k])
        model = bright * pixels[LIGHT, k]
        residual = pixels[VALUE, k] - model
        level = max(model, 0.0)
        variance = look.noise[site, 0] + level * (look.noise[site, 1] + level * look.noise[site, 2])
        unsure = (bright * pixels[UNSURE, k]) ** 2
        known = unsure < 0.1 * variance
        variance += unsure
        good = residual * residual <= OUTLIER * OUTLIER * variance
        weight = 1.0 / math.sqrt(variance) if good else 0.0
        if good:
            if known:
                place = min(int(level * (LEVELS / TOP)), LEVELS - 1)
                sums.levels[site, 0, place] += 1
                sums.levels[site, 1, place] += model
                sums.levels[site, 2, place] += residual * residual
            sums.sites[0, site] += pixels[VALUE, k]
            sums.sites[1, site] += model
            squares += residual * residual / variance
            used += 1
        dx, dy = pixels[DX, k], pixels[DY, k]
        model *= weight
        slopes[0, k], slopes[1, k], slopes[2, k] = model, model * dx, model * dy
        slopes[3, k], slopes[4, k] = weight * bright * pixels[BY_X, k], weight * bright * pixels[BY_Y, k]
        push = -weight * bright * pixels[BY_H, k] * pixels[H_SLOPE, k] / max(pixels[H_RADIUS, k], 1e-9)
        slopes[5, k], slopes[6, k] = push * (dx - ox), push * (dy - oy)
        if look.g.shape[0] > 0:
            slopes[5, k] = weight * bright * pixels[BY_FOLD, k]
        slopes[7, k] = weight * bright * pixels[BY_COMMON, k]
        slopes[DENSE, k], slopes[DENSE + 1, k] = weight * residual, weight
    return squares, used


@numba.njit(nogil=True, cache=True, fastmath=True)
def dense_normals(slopes: FloatArray, count: int, size: int, normal: FloatArray, right: FloatArray) -> None:
    """Normal equations of the first `size` rows."""
    for i in range(size):
        total = 0.0
        for k in range(count):
            total += slopes[i, k] * slopes[DENSE, k]
        right[i] = total
        for j in range(i + 1):
            total = 0.0
            for k in range(count):
                total += slopes[i, k] * slopes[j, k]
            normal[i, j] = total
            normal[j, i] = total


@numba.njit(nogil=True, cache=True)
def spread(
    pixels: FloatArray,
    slopes: FloatArray,
    count: int,
    bright: float,
    splines: FloatArray,
    which: int,
    places: npt.NDArray[np.int64],
    shares: FloatArray,
) -> None:
    """Spline coefficients that each pixel hangs on (4, count), −1 where none, and the derivatives by them in σ."""
    first, step, number = splines[which, 0], splines[which, 1], int(splines[which, 2])
    for k in range(count):
        place = (pixels[H_RADIUS if which else RADIUS, k] - first) / step
        index = int(math.floor(place))  # noqa: RUF046 - numba's floor gives a float
        part = place - index
        rest = 1.0 - part
        scale = slopes[DENSE + 1, k] * bright * pixels[BY_H if which else BY_F, k] / 6.0
        shares[0, k] = scale * rest**3
        shares[1, k] = scale * (4.0 - 6.0 * part**2 + 3.0 * part**3)
        shares[2, k] = scale * (4.0 - 6.0 * rest**2 + 3.0 * rest**3)
        shares[3, k] = scale * part**3
        for a in range(4):
            knot = index - 1 + a
            if which == 0:
                knot = abs(knot)
            places[a, k] = knot if 0 <= knot < number else -1


@numba.njit(nogil=True, cache=True)
def cross_normals(
    slopes: FloatArray,
    count: int,
    size: int,
    places: npt.NDArray[np.int64],
    shares: FloatArray,
    normal: FloatArray,
    right: FloatArray,
) -> None:
    """Add the rows of the spline coefficients (their places counted from `size` on) to the normal equations."""
    for k in range(count):
        for a in range(places.shape[0]):
            p, share = places[a, k], shares[a, k]
            if p < 0 or share == 0.0:
                continue
            row = size + p
            right[row] += share * slopes[DENSE, k]
            for i in range(size):
                normal[row, i] += share * slopes[i, k]
            for b in range(places.shape[0]):
                q = places[b, k]
                if q >= 0 and q <= p:
                    normal[row, size + q] += share * shares[b, k]


@numba.njit(nogil=True, cache=True)
def lens_normals(
    image: FloatImage,
    flags: Flags,
    centres: FloatArray,
    offsets: FloatArray,
    cell: Cell,
    look: Any,
    sums: Any,
    normals: FloatArray,
    rights: FloatArray,
    quality: FloatArray,
) -> None:
    """Normal equations of every lens: `normals` (n, p, p), `rights` (n, p), `quality` (n, 3): brightness, χ², pixels.

    Parameters
    ----------
    image, flags
        Gray image, and the pixels to leave out where not 0, shape (y, x).
    centres, offsets
        Lens centres, and the centre of the second disc relative to each, (n, 2), pixels.
    cell, look, sums
        `cell_of`, `Look`, and `Sums`, which are added to.
    """
    size = rights.shape[1]
    pixels = np.zeros((COLUMNS, int(4 * (look.f.shape[0] / FINE + 1) ** 2)))
    slopes = np.zeros((DENSE + 2, pixels.shape[1]))
    for lens in range(centres.shape[0]):
        ox, oy = offsets[lens, 0], offsets[lens, 1]
        count, bright = gather_pixels(image, flags, centres[lens, 0], centres[lens, 1], ox, oy, cell, look, pixels)
        quality[lens, 0] = bright
        if bright <= 0.0:
            continue
        quality[lens, 1], quality[lens, 2] = derive(pixels, count, bright, ox, oy, look, slopes, sums)
        dense_normals(slopes, count, size, normals[lens], rights[lens])
