"""Relative illumination of every sensor pixel, from a picture of any scene.

It is the product of what the lenses look like (`aperture`: edges that wander over the field) and of a
correction by the place in the subimage, measured zone by zone on the picture without its scene and blended between the
zones: it holds what is not a function of the radius, and gradients that change over the field.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.lattice.aperture import Aperture
from lfflow.kernels.lattice.radial import FINE
from lfflow.kernels.lattice.subimage import Geometry, geometry, offset_from_lens
from lfflow.lattice import Lattice

MOST_ZONES = 6
"""Zones along each side of the sensor, at most."""
LENSES_A_ZONE = 600
CELLS = 10
"""Bins of the correction per lens pitch."""
FAINT = 0.1
"""Light (1 at the peak) below which the correction fades out."""
HIGHLIGHT = 4.0
"""Pixels of the flattened picture above it are left out."""

FloatImage = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]


@numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _model(
    flat: FloatImage,
    lens: Geometry,
    f: FloatArray,
    h: FloatArray,
    matrix: FloatArray,
    origin: FloatArray,
    middle: FloatArray,
    scale: float,
    out: FloatImage,
    seen: FloatArray,
    due: FloatArray,
) -> None:
    """Draw the aperture's light; add the picture and it to the bins of each zone: (zones, zones, side, side)."""
    cos, sin = lens[0], lens[1]
    zones, half = seen.shape[0], seen.shape[2] // 2
    for y in range(out.shape[0]):
        row = y * zones // out.shape[0]
        for x in range(out.shape[1]):
            a, b = offset_from_lens(float(x), float(y), lens)
            value = f[min(int(math.sqrt(a * a + b * b) * FINE + 0.5), f.shape[0] - 1)]
            if h.shape[0] > 0:
                dx, dy = cos * a - sin * b, sin * a + cos * b
                u, v = x - dx - middle[0], y - dy - middle[1]
                ex = dx - matrix[0, 0] * u - matrix[0, 1] * v - origin[0]
                ey = dy - matrix[1, 0] * u - matrix[1, 1] * v - origin[1]
                value *= h[min(int(math.sqrt(ex * ex + ey * ey) * FINE + 0.5), h.shape[0] - 1)]
            light = max(value, 0.0)
            out[y, x] = light
            i, j = int(a * scale + half + 0.5), int(b * scale + half + 0.5)
            if flat[y, x] <= HIGHLIGHT and 0 <= i <= 2 * half and 0 <= j <= 2 * half:
                column = x * zones // out.shape[1]
                seen[row, column, j, i] += flat[y, x]
                due[row, column, j, i] += light


@numba.njit(nogil=True, cache=True, inline="always")
def _between(place: float, last: int) -> tuple[int, float]:
    """Lower of the two nodes about a place, 0…last − 1, and the share of the upper one."""
    place = min(max(place, 0.0), last - 1e-6)
    return int(place), place - int(place)


@numba.njit(nogil=True, cache=True)
def _between_rows(table: FloatImage, v: int, share: float, row: FloatImage) -> None:
    """Blend two rows of zones."""
    for u in range(row.shape[0]):
        for j in range(row.shape[1]):
            for i in range(row.shape[2]):
                row[u, j, i] = table[v, u, j, i] + np.float32(share) * (table[v + 1, u, j, i] - table[v, u, j, i])


@numba.njit(nogil=True, cache=True, inline="always")
def _inside(zone: FloatImage, i: int, j: int, fi: np.float32, fj: np.float32) -> np.float32:
    upper = zone[j, i] + fi * (zone[j, i + 1] - zone[j, i])
    lower = zone[j + 1, i] + fi * (zone[j + 1, i + 1] - zone[j + 1, i])
    return np.float32(upper + fj * (lower - upper))


@numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _correct(model: FloatImage, lens: Geometry, scale: float, ratio: FloatImage) -> None:
    """Multiply the model by the ratio, interpolated between the bins and the middles of the zones."""
    zones, half = ratio.shape[0], ratio.shape[2] // 2
    row = np.empty(ratio.shape[1:], np.float32)
    for y in range(model.shape[0]):
        v, fv = _between((y + 0.5) / model.shape[0] * zones - 0.5, zones - 1)
        _between_rows(ratio, v, fv, row)
        for x in range(model.shape[1]):
            u, fu = _between((x + 0.5) / model.shape[1] * zones - 0.5, zones - 1)
            a, b = offset_from_lens(float(x), float(y), lens)
            i, fi = _between(a * scale + half, 2 * half)
            j, fj = _between(b * scale + half, 2 * half)
            left = _inside(row[u], i, j, np.float32(fi), np.float32(fj))
            right = _inside(row[u + 1], i, j, np.float32(fi), np.float32(fj))
            model[y, x] *= left + np.float32(fu) * (right - left)


def shade(aperture: Aperture, lattice: Lattice, flat: FloatImage) -> FloatImage:
    """Light under each pixel's lens relative to its brightest place, 0 to 1, float32 (y, x).

    How bright a lens is against another is left out: in a picture of a scene that is the scene's.

    Parameters
    ----------
    aperture, lattice
        What the lenses look like, and where they are.
    flat
        The picture with its scene divided out (`lfflow.kernels.lattice.centres.flatten_scene`), shape (y, x).
    """
    model, lens = np.empty(flat.shape, np.float32), geometry(lattice)
    f = aperture.f.table()[:, 0]
    h = np.zeros(0) if aperture.h is None else aperture.h.table()[:, 0]
    scale, half = CELLS / lattice.dh, math.ceil(0.62 * CELLS * max(1.0, lattice.dv / lattice.dh)) + 1
    lenses = flat.size / (lattice.dh**2 * lattice.row_pitch)
    zones = int(np.clip(math.sqrt(lenses / LENSES_A_ZONE), 2, MOST_ZONES))
    seen, due = np.zeros((2, zones, zones, 2 * half + 1, 2 * half + 1))
    place = aperture.matrix, aperture.origin, aperture.middle
    _model(flat, lens, f / f.max(), h, *place, scale, model, seen, due)
    _correct(model, lens, scale, _ratio(seen, due).astype(np.float32))
    model /= np.float32(max(float(np.percentile(model[::7, ::5], 99)), 1e-6))
    return np.minimum(model, 1, out=model)


def _ratio(seen: FloatArray, due: FloatArray) -> FloatArray:
    """Picture over model in each bin, 1 on the mean of a zone; the model holds where it expects no light."""
    total, expected = (sums.sum(axis=(2, 3), keepdims=True) for sums in (seen, due))
    level = np.where(expected > 0, total / np.maximum(expected, 1e-12), 1)
    prior = FAINT * expected / seen[0, 0].size
    return np.asarray((seen / np.maximum(level, 1e-12) + prior) / np.maximum(due + prior, 1e-12))
