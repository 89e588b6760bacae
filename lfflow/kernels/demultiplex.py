"""Every sensor pixel to its view and lens: exact integer sampling, no colour mixed (METHOD 7.a, 7.1).

A pixel belongs to the lens whose centre is nearest (`Lattice.nearest`) and, there, to the view that is its offset from
the rounded centre. Each pixel therefore has one place at most, and the loop runs over pixels: what is read twice or
written twice cannot exist.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.distortion import STRAIGHT, Distortion
from lfflow.kernels.radiometry import colour_tile, level_tiles
from lfflow.lattice import Lattice

MIN_VIGNETTING = 0.1
"""Below this share of the peak illumination a sample is left out: division would only amplify its noise."""

SATURATED_WEIGHT = 1.0 / 64.0
"""Factor on the weight of a clipped sample; it brings every such weight below `MIN_VIGNETTING`, and so marks it."""

Float32Array = npt.NDArray[np.float32]


class FieldArrays(NamedTuple):
    """Arrays (v, u, t, s) of a light field: radiance, colour code, weight."""

    mosaic: Float32Array
    cfa: npt.NDArray[np.uint8]
    weight: Float32Array


def round_to_pixel(position: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Sensor pixel of a sensor position: halves go up (right and down). The one rounding rule of lfflow."""
    return np.floor(np.asarray(position, dtype=np.float64) + 0.5).astype(np.int64)


def lens_centres(
    lattice: Lattice, t: npt.ArrayLike, s: npt.ArrayLike, distortion: Distortion = STRAIGHT
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Centres (x, y) of the lenses of rows `t` and columns `s`, sensor pixels, each (t, s)."""
    return distortion.moved(lattice.centres(np.asarray(t)[:, np.newaxis], np.asarray(s)))


def residuals(
    lattice: Lattice, t: npt.ArrayLike, s: npt.ArrayLike, distortion: Distortion = STRAIGHT
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """ρ = rounded centre − centre in x and y, pixels, each (t, s): sample (u, v) was taken at aperture (u, v) + ρ."""
    x, y = lens_centres(lattice, t, s, distortion)
    return round_to_pixel(x) - x, round_to_pixel(y) - y


def empty_field(shape: tuple[int, ...]) -> FieldArrays:
    """Arrays of `shape` that hold no sample: NaN, 255, 0."""
    return FieldArrays(
        np.full(shape, np.nan, np.float32), np.full(shape, CFA_NONE, np.uint8), np.zeros(shape, np.float32)
    )


def demultiplex_frame(
    raw: npt.NDArray[Any],
    vignetting: Float32Array,
    pixel_flags: npt.NDArray[np.uint8],
    lattice: Lattice,
    *,
    black: npt.NDArray[np.float64],
    white: npt.NDArray[np.float64],
    pattern: str,
    out: FieldArrays,
    distortion: Distortion = STRAIGHT,
) -> None:
    """Write the samples of one frame (y, x) into `out` (v, u, t, s), which must hold no sample (`empty_field`).

    ``lattice`` is numbered for the grid of `out`; ``vignetting`` (y, x) is 1 at its peak; pixels with any flag are
    left out, and so are those with a vignetting below `MIN_VIGNETTING`. ``black`` and ``white`` (4,) are counts at the
    sites (r, gr, gb, b). ``distortion`` bends the lattice. Radiance is
    (raw − black)/(white − black)/vignetting, the weight is the vignetting.
    """
    shape = (out.mosaic.shape[2], out.mosaic.shape[3])
    x, y = lens_centres(lattice, np.arange(shape[0]), np.arange(shape[1]), distortion)
    bend = np.zeros((2, 0, 0))
    if not distortion.straight:
        straight_x, straight_y = lens_centres(lattice, np.arange(shape[0]), np.arange(shape[1]))
        bend = np.stack([x - straight_x, y - straight_y])
    _scatter(
        np.ascontiguousarray(raw),
        np.ascontiguousarray(vignetting, dtype=np.float32),
        np.ascontiguousarray(pixel_flags, dtype=np.uint8),
        round_to_pixel(x).astype(np.int32),
        round_to_pixel(y).astype(np.int32),
        bend,
        (math.cos(lattice.theta), math.sin(lattice.theta), lattice.dh, lattice.dv, lattice.cx, lattice.cy),
        lattice.arrangement == "hexagonal",
        level_tiles(black, white, pattern),
        colour_tile(pattern),
        out.mosaic,
        out.cfa,
        out.weight,
    )


_HALF_HEIGHT = math.sqrt(3) / 2


@numba.njit(nogil=True, cache=True)
def owner(gx: float, gy: float, hexagonal: bool) -> tuple[int, int]:  # pragma: no cover - compiled
    """Lens (t, s) nearest to a point in lens pitches: `Lattice.nearest`, operation by operation."""
    if not hexagonal:
        return math.floor(gy + 0.5), math.floor(gx + 0.5)
    t = math.floor(gy / _HALF_HEIGHT)
    shift = 0.5 * (t & 1)
    s = math.floor(gx - shift + 0.5)
    distance = (gx - s - shift) ** 2 + (gy - _HALF_HEIGHT * t) ** 2
    below = t + 1
    below_shift = 0.5 - shift
    below_s = math.floor(gx - below_shift + 0.5)
    if (gx - below_s - below_shift) ** 2 + (gy - _HALF_HEIGHT * below) ** 2 < distance:
        return below, below_s
    return t, s


@numba.njit(nogil=True, cache=True)
def _scatter(  # type: ignore[no-untyped-def]
    raw, vignetting, flags, centre_x, centre_y, bend, geometry, hexagonal, levels, colours, mosaic, cfa, weight
):  # pragma: no cover - compiled
    cos, sin, dh, dv, cx, cy = geometry
    black, gain, white = levels
    views_v, views_u, rows, columns = mosaic.shape
    radius_v, radius_u = views_v // 2, views_u // 2
    height, width = raw.shape
    least = np.float32(MIN_VIGNETTING)
    clipped = np.float32(SATURATED_WEIGHT)
    for y in range(height):
        py = y - cy
        for x in range(width):
            shade = vignetting[y, x]
            if flags[y, x] != 0 or not shade >= least:
                continue
            px = x - cx
            t, s = owner((cos * px + sin * py) / dh, (-sin * px + cos * py) / dv, hexagonal)
            if bend.size:
                near_t, near_s = min(max(t, 0), rows - 1), min(max(s, 0), columns - 1)
                bx, by = px - bend[0, near_t, near_s], py - bend[1, near_t, near_s]
                t, s = owner((cos * bx + sin * by) / dh, (-sin * bx + cos * by) / dv, hexagonal)
            if t < 0 or t >= rows or s < 0 or s >= columns:
                continue
            u = x - centre_x[t, s] + radius_u
            v = y - centre_y[t, s] + radius_v
            if u < 0 or u >= views_u or v < 0 or v >= views_v:
                continue
            count = np.float32(raw[y, x])
            mosaic[v, u, t, s] = (count - black[y & 1, x & 1]) * gain[y & 1, x & 1] / shade
            cfa[v, u, t, s] = colours[y & 1, x & 1]
            weight[v, u, t, s] = shade if count < white[y & 1, x & 1] else shade * clipped
