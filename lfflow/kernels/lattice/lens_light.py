"""What a pixel under a lens sees: the aperture's disc f, and the light that a second disc h leaves of it.

Blur that both edges have in common, such as the pixel's own area, acts on what they leave together: where both cross
one pixel the light is not f·h but up to min(f, h). It is the probability that two normal variables, of correlation c,
lie below the places of f and h, with c the common share of the edges' blur times the cosine between their normals:
f·h for edges that are soft themselves (c = 0), min(f, h) for sharp ones side by side (c = 1).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.lattice.radial import FINE
from lfflow.lattice import Lattice

EDGE_ERROR = 0.05
"""How well the place of the second aperture's edge is known, pixels: its pixels weigh less by that much."""
RIM_ERROR = 0.5
"""Pixels on the border of two lenses are off by so much of a lens's brightness: they hold the profile's end alone."""
CERTAIN = 5e-4
"""An edge that lets so much or so little through is not counted as one."""
HALF_DIAGONAL = 0.7072
"""Of a pixel: so far from the border of a cell it gathers no light of the next lens, pixels."""
MOST_COMMON = 0.97
"""Largest share of the edges' blur that is common."""
COLUMNS = 15

DX, DY, RADIUS, BY_X, BY_Y, H_RADIUS, H_SLOPE, LIGHT, BY_F, BY_H, BY_COMMON, BY_FOLD, VALUE, SITE, UNSURE = range(
    COLUMNS
)
"""Rows of a lens's table of pixels: offset and distance from its centre (px), and how the light changes as that moves;
distance from the second disc's centre, and the slope of h there; light, and its derivatives by f, h, the common share
and the share from beyond the border; what the picture shows; Bayer site; error of the light as a share of the lens's
brightness. Without a second disc, by h is by g: the cosine of four times the direction."""

FloatImage = npt.NDArray[np.float32]
Flags = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]
Cell = tuple[float, float, float, float, bool]


class Look(NamedTuple):
    """What a lens looks like: tables of f, g and h (`Radial.table`; g or h is empty) and the splines under them.

    `splines` (2, 3): first radius, step, number of coefficients of f, and of g or h. `sites` (4,): gain left in each
    Bayer site. `noise` (4, 3): variance of a site by powers of the level. Pixels nearer than `rim` to the border of a
    cell do not count, pixels. `droop`: f without its edge is 1 + droop·r². `common`: share of the edges' blur that they
    have in common. `fold`: share of the light that pixels on a border have from beyond it (`beyond`).
    """

    f: FloatArray
    g: FloatArray
    h: FloatArray
    splines: FloatArray
    sites: FloatArray
    noise: FloatArray
    rim: float
    droop: float
    common: float
    fold: float


def cell_of(lattice: Lattice) -> Cell:
    """Shape of a lens's cell as the kernels want it: cos, sin, dh, dv, hexagonal."""
    turn = (math.cos(lattice.theta), math.sin(lattice.theta))
    return (*turn, lattice.dh, lattice.dv, lattice.arrangement == "hexagonal")


@numba.njit(nogil=True, cache=True, inline="always")
def border(dx: float, dy: float, cell: Cell) -> tuple[float, float, float]:
    """Distance of a pixel from the nearest border of its lens's cell, negative beyond it, and the border's normal.

    The normal is that in a lattice that is not turned.
    """
    cos, sin, dh, dv, hexagonal = cell
    gx, gy = (cos * dx + sin * dy) / dh, (cos * dy - sin * dx) / dv
    wide, high = abs(gx), abs(gy)
    distance, nx, ny = dh * (0.5 - wide), math.copysign(1.0, gx), 0.0
    if hexagonal:
        other = dh * (0.5 - 0.5 * wide - 0.8660254037844386 * high)
        if other < distance:
            distance, nx, ny = other, math.copysign(0.5, gx), math.copysign(0.8660254037844386, gy)
    else:
        other = dv * (0.5 - high)
        if other < distance:
            distance, nx, ny = other, 0.0, math.copysign(1.0, gy)
    return distance, nx, ny


@numba.njit(nogil=True, cache=True)
def beyond(
    s: float, normal: tuple[float, float], light: float, slope: tuple[float, float], growth: tuple[float, float]
) -> tuple[float, float]:
    """Light that a square pixel has from the next lens, less what it has not from its own; and its share beyond.

    The next lens is this one mirrored on the border of the cell, brighter by `growth` per pixel, relative, times the
    pitch. With the border at the distance s along its `normal` and t that of a point of the pixel, the mirror adds
    −f'·2E(t − s)₊ to light of the `slope` f' along it, and the brightness adds its share of what lies at t > s.
    """
    nx, ny = normal
    a, b = 0.5 * max(abs(nx), abs(ny)), max(0.5 * min(abs(nx), abs(ny)), 1e-3)
    outer, inner = max(a + b - s, 0.0), max(a - b - s, 0.0)
    excess = (outer**3 - inner**3) / (24.0 * a * b)
    share = (outer**2 - inner**2) / (8.0 * a * b)
    along = nx * slope[0] + ny * slope[1]
    brighter = nx * growth[0] + ny * growth[1]
    return -2.0 * along * excess + brighter * (share * light + along * (s * share - excess)), share


@numba.njit(nogil=True, cache=True, inline="always")
def _at(table: FloatArray, radius: float) -> tuple[float, float]:
    """Value and slope of a table; beyond its end the last value, flat."""
    place = radius * FINE
    index = int(place)
    if index >= table.shape[0] - 1:
        return table[table.shape[0] - 1, 0], 0.0
    part = place - index
    return (
        table[index, 0] + part * (table[index + 1, 0] - table[index, 0]),
        table[index, 1] + part * (table[index + 1, 1] - table[index, 1]),
    )


@numba.njit(nogil=True, cache=True)
def _place_of(share: float) -> float:
    """Place below which a standard normal variable lies with the probability `share`; error below 5e-4."""
    tail = math.sqrt(-2.0 * math.log(min(share, 1.0 - share)))
    top = 2.515517 + tail * (0.802853 + tail * 0.010328)
    place = tail - top / (1.0 + tail * (1.432788 + tail * (0.189269 + tail * 0.001308)))
    return -place if share < 0.5 else place


@numba.njit(nogil=True, cache=True)
def _below(place: float) -> float:
    return 0.5 * math.erfc(-0.7071067811865476 * place)


@numba.njit(nogil=True, cache=True)
def overlap(f: float, h: float, c: float) -> tuple[float, float, float, float]:
    """Light that two edges leave that let f and h (0…1) through alone, and its derivatives by f, h and c.

    The bivariate normal distribution with the correlation c, by Gauss's rule of six points over arcsin c.
    """
    x, y = _place_of(f), _place_of(h)
    squares, product, total = x * x + y * y, x * y, 0.0
    end = math.asin(c)
    for side, weight in ((0.2386191860831969, 0.46791393457269104), (0.6612093864662645, 0.36076157304813861),
                         (0.9324695142031521, 0.17132449237917036)):  # fmt: skip
        for share in (0.5 * (1.0 - side), 0.5 * (1.0 + side)):
            sine = math.sin(end * share)
            total += weight * math.exp((sine * product - 0.5 * squares) / (1.0 - sine * sine))
    rest = 1.0 - c * c
    root = math.sqrt(rest)
    density = math.exp((c * product - 0.5 * squares) / rest) / (6.283185307179586 * root)
    light = f * h + total * 0.5 * end / 6.283185307179586
    return light, _below((y - c * x) / root), _below((x - c * y) / root), density


@numba.njit(nogil=True, cache=True, fastmath=True)
def gather_pixels(
    image: FloatImage,
    flags: Flags,
    x: float,
    y: float,
    ox: float,
    oy: float,
    cell: Cell,
    look: Any,
    pixels: FloatArray,
) -> tuple[int, float]:
    """Fill `pixels` (COLUMNS, n) with those of the cell of the lens at (x, y); their number, and its brightness.

    (ox, oy) is the centre of the second disc relative to the lens, pixels; without one, the relative change of the
    lenses' brightness per pixel to the right and down.
    """
    reach = look.f.shape[0] / FINE
    count, top, bottom = 0, 0.0, 0.0
    clipped = look.h.shape[0] > 0
    square = np.inf if clipped else look.splines[1, 0] - 2 * look.splines[1, 1]
    for j in range(max(int(y - reach) + 1, 0), min(int(y + reach) + 1, image.shape[0])):
        for i in range(max(int(x - reach) + 1, 0), min(int(x + reach) + 1, image.shape[1])):
            dx, dy = i - x, j - y
            distance, nx, ny = border(dx, dy, cell)
            if distance < 0.0 or flags[j, i] != 0:
                continue
            r = math.sqrt(dx * dx + dy * dy)
            f, steep = _at(look.f, r)
            light, by_f, by_h, by_common, slope, r2 = f, 1.0, f, 0.0, 0.0, 0.0
            by_x, by_y = -steep * dx / max(r, 1e-9), -steep * dy / max(r, 1e-9)
            folded = 0.0
            if r > square:
                if distance < HALF_DIAGONAL:
                    nx, ny = cell[0] * nx - cell[1] * ny, cell[1] * nx + cell[0] * ny
                    brighter = (2.0 - look.fold) * cell[2]
                    folded, share = beyond(distance, (nx, ny), f, (-by_x, -by_y), (brighter * ox, brighter * oy))
                    light += look.fold * folded
                    turned = 2.0 * look.fold * share * (by_x * nx + by_y * ny)
                    by_x, by_y = by_x - turned * nx, by_y - turned * ny
                r2, by_h = r, 1.0 - 8.0 * (dx * dy / (r * r)) ** 2
                light += by_h * _at(look.g, r)[0]
            if clipped:
                ex, ey = dx - ox, dy - oy
                r2 = math.sqrt(ex * ex + ey * ey)
                h, slope = _at(look.h, r2)
                light, by_f = f * h, h
                whole = 1.0 + look.droop * r * r
                edge = f / whole
                if CERTAIN < edge < 1.0 - CERTAIN and CERTAIN < h < 1.0 - CERTAIN:
                    cosine = (dx * ex + dy * ey) / (r * r2)
                    light, by_f, by_h, by_common = overlap(edge, h, look.common * cosine)
                    light, by_h, by_common = light * whole, by_h * whole, by_common * whole * cosine
            site = 2 * (j % 2) + i % 2
            value = image[j, i] / look.sites[site]
            pixels[DX, count], pixels[DY, count], pixels[RADIUS, count] = dx, dy, r
            pixels[BY_X, count], pixels[BY_Y, count] = by_f * by_x, by_f * by_y
            pixels[H_RADIUS, count], pixels[H_SLOPE, count] = r2, slope
            pixels[LIGHT, count], pixels[BY_F, count], pixels[BY_H, count] = light, by_f, by_h
            pixels[BY_COMMON, count], pixels[BY_FOLD, count] = by_common, folded
            pixels[VALUE, count], pixels[SITE, count] = value, site
            pixels[UNSURE, count] = EDGE_ERROR * by_h * slope
            if distance < look.rim:
                pixels[UNSURE, count] = RIM_ERROR
            count += 1
            top += value * light
            bottom += light * light
    return count, top / bottom if bottom > 0 else 0.0
