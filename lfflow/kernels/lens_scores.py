"""Per-lens score: how far each lens lies from where the lattice puts it, by the light of its own cell alone.

Model of a pixel at offset ρ from its lens: m = (β + γ·ρ)·f(|ρ|)·h(|ρ − o|), with β the lens's brightness, γ a gradient
across it, f the mean subimage and h a second aperture at o that clips it (`lfflow.kernels.aperture`). One Gauss-Newton
step of every lens, with the sensor's noise, leaves its normal equations; what is asked of all lenses together
(`lfflow.kernels.likelihood`) is then a small linear problem. A neighbour's light never enters, so that a brightness
that changes from lens to lens does not move the centres.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.radial import FINE
from lfflow.lattice import Lattice

LEVELS = 24
"""Bins of the noise model over the range 0…`TOP` of the model."""
TOP = 2.5
OUTLIER = 5.0
EDGE_ERROR = 0.05
"""How well the place of the second aperture's edge is known, pixels: its pixels weigh less by that much."""
BOTH_ERROR = 0.29
"""Where both edges shade a pixel its light is f·h if they are soft themselves and min(f, h) if the pixel's own size
blurs them: the deviation of what lies evenly between the two, as a share of their difference."""
RIM_ERROR = 0.5
"""Pixels on the border of two lenses are off by so much of a lens's brightness: they hold the profile's end alone."""
DENSE = 7
"""Parameters of a lens: β, γx, γy (relative; 1 / px), centre x, y, place of the second disc x, y (pixels)."""

FloatImage = npt.NDArray[np.float32]
Flags = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]
Cell = tuple[float, float, float, float, bool]


class Look(NamedTuple):
    """What a lens looks like: tables of f and h (`Radial.table`; h may be empty) and the splines under them.

    `splines` (2, 3): first radius, step, number of coefficients of f and h. `sites` (4,): gain left in each Bayer site.
    `noise` (4, 3): variance of a site by powers of the level. Pixels nearer than `rim` to the border of a cell gather
    light of the next lens too, pixels; 0 where that does no harm.
    """

    f: FloatArray
    h: FloatArray
    splines: FloatArray
    sites: FloatArray
    noise: FloatArray
    rim: float


class Sums(NamedTuple):
    """Moments (number, level, squared residual) by site and level (4, 3, LEVELS); value and model by site (2, 4)."""

    levels: FloatArray
    sites: FloatArray


def cell_of(lattice: Lattice) -> Cell:
    """Shape of a lens's cell as the kernels want it: cos, sin, dh, dv, hexagonal."""
    turn = (math.cos(lattice.theta), math.sin(lattice.theta))
    return (*turn, lattice.dh, lattice.dv, lattice.arrangement == "hexagonal")


@numba.njit(nogil=True, cache=True, inline="always")
def in_cell(dx: float, dy: float, cell: Cell) -> bool:
    """Whether a pixel at an offset from a lens belongs to it."""
    cos, sin, dh, dv, hexagonal = cell
    gx, gy = abs(cos * dx + sin * dy) / dh, abs(cos * dy - sin * dx) / dv
    if hexagonal:
        return gx <= 0.5 and 0.5 * gx + 0.8660254037844386 * gy <= 0.5
    return gx <= 0.5 and gy <= 0.5


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


@numba.njit(nogil=True, cache=True, fastmath=True)
def _gather(
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
    """Columns dx, dy, r, f, f′, r₂, h, h′, value, site, rim of the pixels of a cell; their number, and β."""
    reach = look.f.shape[0] / FINE
    count, top, bottom = 0, 0.0, 0.0
    inner = (cell[0], cell[1], cell[2] - 2 * look.rim, cell[3] - 2 * look.rim, cell[4])
    clipped = look.h.shape[0] > 0
    for j in range(max(int(y - reach) + 1, 0), min(int(y + reach) + 1, image.shape[0])):
        for i in range(max(int(x - reach) + 1, 0), min(int(x + reach) + 1, image.shape[1])):
            dx, dy = i - x, j - y
            if not in_cell(dx, dy, cell) or flags[j, i] != 0:
                continue
            r = math.sqrt(dx * dx + dy * dy)
            f, steep = _at(look.f, r)
            h, slope, r2 = 1.0, 0.0, 0.0
            if clipped:
                r2 = math.sqrt((dx - ox) ** 2 + (dy - oy) ** 2)
                h, slope = _at(look.h, r2)
            site = 2 * (j % 2) + i % 2
            value = image[j, i] / look.sites[site]
            pixels[0, count], pixels[1, count], pixels[2, count] = dx, dy, r
            pixels[3, count], pixels[4, count] = f, steep
            pixels[5, count], pixels[6, count], pixels[7, count] = r2, h, slope
            pixels[8, count], pixels[9, count] = value, site
            pixels[10, count] = 0.0 if in_cell(dx, dy, inner) else RIM_ERROR
            count += 1
            top += value * f * h
            bottom += f * f * h * h
    return count, top / bottom if bottom > 0 else 0.0


@numba.njit(nogil=True, cache=True, fastmath=True)
def _derive(
    pixels: FloatArray, count: int, bright: float, ox: float, oy: float, look: Any, slopes: FloatArray, sums: Any
) -> tuple[float, int]:
    """Rows of `slopes` (DENSE + 2): derivatives of a lens's parameters in σ, residual in σ, 1 / σ; χ² and pixels."""
    squares, used = 0.0, 0
    for k in range(count):
        f, h, slope, site = pixels[3, k], pixels[6, k], pixels[7, k], int(pixels[9, k])
        model = bright * f * h
        residual = pixels[8, k] - model
        level = max(model, 0.0)
        edge = EDGE_ERROR * bright * f * slope
        both = BOTH_ERROR * bright * (min(f, h) - f * h) if h < 1.0 and f < 1.0 else 0.0
        variance = look.noise[site, 0] + level * (look.noise[site, 1] + level * look.noise[site, 2])
        unsure = edge * edge + both * both + (pixels[10, k] * bright) ** 2
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
            sums.sites[0, site] += pixels[8, k]
            sums.sites[1, site] += model
            squares += residual * residual / variance
            used += 1
        dx, dy = pixels[0, k], pixels[1, k]
        model *= weight
        slopes[0, k], slopes[1, k], slopes[2, k] = model, model * dx, model * dy
        push = -weight * bright * pixels[4, k] * h / max(pixels[2, k], 1e-9)
        slopes[3, k], slopes[4, k] = push * dx, push * dy
        push = -weight * bright * f * slope / max(pixels[5, k], 1e-9)
        slopes[5, k], slopes[6, k] = push * (dx - ox), push * (dy - oy)
        slopes[7, k], slopes[8, k] = weight * residual, weight
    return squares, used


@numba.njit(nogil=True, cache=True, fastmath=True)
def _dense(slopes: FloatArray, count: int, size: int, normal: FloatArray, right: FloatArray) -> None:
    """Normal equations of the first `size` rows."""
    for i in range(size):
        total = 0.0
        for k in range(count):
            total += slopes[i, k] * slopes[7, k]
        right[i] = total
        for j in range(i + 1):
            total = 0.0
            for k in range(count):
                total += slopes[i, k] * slopes[j, k]
            normal[i, j] = total
            normal[j, i] = total


@numba.njit(nogil=True, cache=True)
def _spread(
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
        place = (pixels[2 + 3 * which, k] - first) / step
        index = int(math.floor(place))  # noqa: RUF046 - numba's floor gives a float
        part = place - index
        rest = 1.0 - part
        scale = slopes[8, k] * bright * (pixels[6, k] if which == 0 else pixels[3, k]) / 6.0
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
def _cross(
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
            right[row] += share * slopes[7, k]
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
    pixels = np.zeros((11, int(4 * (look.f.shape[0] / FINE + 1) ** 2)))
    slopes = np.zeros((DENSE + 2, pixels.shape[1]))
    for lens in range(centres.shape[0]):
        ox, oy = offsets[lens, 0], offsets[lens, 1]
        count, bright = _gather(image, flags, centres[lens, 0], centres[lens, 1], ox, oy, cell, look, pixels)
        quality[lens, 0] = bright
        if bright <= 0.0:
            continue
        quality[lens, 1], quality[lens, 2] = _derive(pixels, count, bright, ox, oy, look, slopes, sums)
        _dense(slopes, count, size, normals[lens], rights[lens])


@numba.njit(nogil=True, cache=True)
def _solve_local(normal: FloatArray, right: FloatArray, local: int, size: int, ridge: float) -> float:
    """Eliminate the first `local` parameters in place (lower triangle); by how much χ² falls."""
    fall = 0.0
    for p in range(local):
        pivot = normal[p, p]
        if pivot <= ridge:
            continue
        fall += right[p] * right[p] / pivot
        for i in range(p + 1, size):
            factor = normal[i, p] / pivot
            if factor != 0.0:
                right[i] -= factor * right[p]
                for j in range(p + 1, i + 1):
                    normal[i, j] -= factor * normal[j, p]
    return fall


@numba.njit(nogil=True, cache=True)
def _half_chain(
    normal: FloatArray, right: FloatArray, local: int, move: FloatArray, weight: float, score: FloatArray
) -> FloatArray:
    """Lens's equations (lower triangle) with their rows chained to the common parameters, whose score is added to."""
    half = np.zeros((move.shape[1], normal.shape[0]))
    for i in range(move.shape[0]):
        row = local + i
        for c in range(move.shape[1]):
            factor = move[i, c] * weight
            if factor != 0.0:
                score[c] += factor * right[row]
                for j in range(local, row + 1):
                    half[c, j] += factor * normal[row, j]
                for j in range(row + 1, normal.shape[0]):
                    half[c, j] += factor * normal[j, row]
    return half


@numba.njit(nogil=True, cache=True)
def _chain(
    normal: FloatArray,
    right: FloatArray,
    local: int,
    move: FloatArray,
    weight: float,
    total: FloatArray,
    score: FloatArray,
) -> None:
    """Add a lens's equations to those of the common parameters: `move` (DENSE − local, common), then the splines."""
    lens, common = move.shape
    half = _half_chain(normal, right, local, move, weight, score)
    for c in range(common):
        for i in range(lens):
            value = half[c, local + i]
            for d in range(c + 1):
                total[c, d] += value * move[i, d]
    rest = local + lens
    for p in range(rest, normal.shape[0]):
        place = common + p - rest
        score[place] += weight * right[p]
        for c in range(common):
            total[place, c] += half[c, p]
        for q in range(rest, p + 1):
            total[place, common + q - rest] += weight * normal[p, q]


@numba.njit(nogil=True, cache=True)
def gather_normals(
    image: FloatImage,
    flags: Flags,
    centres: FloatArray,
    offsets: FloatArray,
    moves: FloatArray,
    blocks: npt.NDArray[np.int64],
    cell: Cell,
    look: Any,
    local: int,
    splines: bool,
    typical: float,
    sums: Any,
    totals: FloatArray,
    scores: FloatArray,
    misfit: FloatArray,
) -> None:
    """Normal equations of the parameters that the lenses share, by blocks of lenses.

    Parameters
    ----------
    moves
        Derivatives of the lens's parameters that are not its own by the common ones, (n, DENSE − local, common).
    blocks
        Block of each lens, (n,).
    local
        Parameters that each lens has for itself: 1 (β) or 3 (β and γ).
    splines
        Whether the coefficients of the profiles are looked for too.
    typical
        Misfit χ² per degree of freedom of a good lens; a lens weighs less by what it has more. 0: all weigh the same.
    totals, scores, misfit
        Matrices (blocks, common, common; lower triangle), scores (blocks, common), and each lens's misfit (n,), filled.
    """
    clipped = look.h.shape[0] > 0
    dense = DENSE if clipped else DENSE - 2
    number = int(look.splines[0, 2]) + (int(look.splines[1, 2]) if clipped else 0) if splines else 0
    size = dense + number
    pixels = np.zeros((11, int(4 * (look.f.shape[0] / FINE + 1) ** 2)))
    slopes = np.zeros((DENSE + 2, pixels.shape[1]))
    places = np.zeros((8, pixels.shape[1]), np.int64)
    shares = np.zeros((8, pixels.shape[1]))
    normal, right = np.zeros((size, size)), np.zeros(size)
    for lens in range(centres.shape[0]):
        ox, oy = offsets[lens, 0], offsets[lens, 1]
        count, bright = _gather(image, flags, centres[lens, 0], centres[lens, 1], ox, oy, cell, look, pixels)
        if bright <= 0.0:
            continue
        squares, used = _derive(pixels, count, bright, ox, oy, look, slopes, sums)
        normal[:], right[:] = 0.0, 0.0
        _dense(slopes, count, dense, normal, right)
        if splines:
            _spread(pixels, slopes, count, bright, look.splines, 0, places[:4], shares[:4])
            if clipped:
                _spread(pixels, slopes, count, bright, look.splines, 1, places[4:], shares[4:])
                for k in range(count):
                    for a in range(4, 8):
                        if places[a, k] >= 0:
                            places[a, k] += int(look.splines[0, 2])
            _cross(slopes, count, dense, places[: 8 if clipped else 4], shares, normal, right)
        fall = _solve_local(normal, right, local, size, 1e-9)
        misfit[lens] = (squares - fall) / max(used - local, 1)
        weight = 1.0 if typical == 0.0 else typical / max(misfit[lens], typical)
        if used > local + 4:
            _chain(normal, right, local, moves[lens], weight, totals[blocks[lens]], scores[blocks[lens]])
