"""What clips a subimage: the aperture's own disc, and a second one that wanders over the field (cat's eye).

The disc that limits the central subimages is the aperture: its image lies at the same place under every lens and marks
the lens centre. A rim elsewhere in the main lens is seen as a second disc whose centre o moves linearly with the place
on the sensor, o = M·(c − middle) + o₀: a lattice of another pitch. Where it clips, the centroid of the light moves with
it, and only the arc that it leaves free tells where the lens is.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numba
import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.special import ndtr

from lfflow.kernels.lattice.lens_light import Cell, Flags, FloatArray, FloatImage, border
from lfflow.kernels.lattice.radial import FINE, Radial

ROUNDS = 8
"""Steps, at most, to the difference of two discs' radii."""
ZONES = 5
"""Zones along each side of the sensor."""
CELLS = 12
"""Bins of a zone's mean subimage per lens pitch."""
KNOT = 0.4
"""Distance of the knots of a profile in widths (standard deviations) of its edge."""
NARROWEST = 0.15
"""Knots are at least so many pixels apart: a pixel's own area blurs every edge."""
COMMON = 0.25
"""Share of the edges' blur that both have in common, before it is measured."""
OVERLAPPING = 0.9
"""Where the second disc moves by less than so many widths of the edge, no pixel sees one of the edges alone,"""
CLOSE = 0.4
"""and by less than so many, the edges' shape has the same effect as the common share of their blur."""
SIGNIFICANT = 4.0
"""The subimages must be so many standard deviations narrower towards the corners before a second disc is looked for,"""
SUSPECT = 2.0
"""and so many before the lattice is said to be less certain for one that may be there."""
SOFTEST = 0.4
"""A second disc whose edge is wider than so many of its radii is a gradient, which every lens may have."""
FADED = 0.5
"""Subimages whose light seems to fall to less towards their edge are not one disc: a second one smears them."""
LARGEST_START = 0.25
"""Largest motion of the second disc to start from, lens pitches from the middle of the sensor to its border."""
SHARP = 0.25
"""An edge that is wider (standard deviation) than so many radii of the aperture is not told from a gradient."""


@dataclass(frozen=True, slots=True)
class Zones:
    """Mean subimages of the zones of a sensor: bins that hold light, one row each.

    Parameters
    ----------
    dx, dy, value, weight
        Mean offset from the lens centre (px), mean value, number of pixels: shape (n,).
    zone, bin
        Zone of each bin, and which of those of its subimage it is, (n,).
    centres
        Mean lens centre of each zone, (zones, 2).
    """

    dx: FloatArray
    dy: FloatArray
    value: FloatArray
    weight: FloatArray
    zone: npt.NDArray[np.int64]
    bin: npt.NDArray[np.int64]
    centres: FloatArray


@dataclass(frozen=True, slots=True)
class Aperture:
    """The mean subimage, and what clips it.

    Parameters
    ----------
    f
        Mean subimage by the distance from the lens centre.
    g
        What square pixels add to f by the distance from the lens centre, times cos 4φ of the direction φ; None with a
        second disc.
    h
        Light that the second disc lets through by the distance from its centre; None without one.
    matrix, origin, middle
        That centre relative to the lens at c: matrix·(c − middle) + origin, pixels.
    sharp
        Whether the edge is narrow enough to be told from a gradient of the light across the subimages.
    hidden
        By how much the subimages' centres may be off at the end of the longer half axis of the sensor if a second disc
        as large as the first is there, pixels; 0 where nothing speaks for one.
    width
        Of the wider edge (standard deviation), pixels, as first seen.
    apart
        Motion of the second disc from the middle of the sensor to its border in widths of the edge, as first seen.
    droop
        f without its edge is 1 + droop·r², r in pixels.
    common
        Share of the edges' blur that both have in common (`lfflow.kernels.lattice.lens_light`).
    fold
        Share of the light that a pixel on the border of two lenses has from the next one: 1 for one that gathers light
        on all its area, 0 for one that does so at its middle.
    """

    f: Radial
    g: Radial | None
    h: Radial | None
    matrix: FloatArray
    origin: FloatArray
    middle: FloatArray
    sharp: bool
    hidden: float
    width: float
    apart: float = 0.0
    droop: float = 0.0
    common: float = COMMON
    fold: float = 0.0

    @property
    def overlapping(self) -> bool:
        """Whether no pixel sees one disc's edge alone."""
        return self.apart < OVERLAPPING

    @property
    def motion(self) -> float:
        """By how much the second disc moves from the middle of the sensor to its border, pixels."""
        return math.sqrt(0.5) * float(np.linalg.norm(self.matrix)) * float(self.middle.max())

    def alike(self, h: Radial) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """By how much a second disc is larger than the first if their edges are alike, pixels, and how unlike they are.

        Returns
        -------
        larger, unlike, slopes, moved
            At radii a knot apart, `unlike` (n,) is by how much h lets more light through than f, without its droop and
            moved outwards by `larger`; `slopes` (n, p) are its derivatives by the coefficients of f, then of h, and
            `moved` (n,) that by `larger`.
        """
        larger = max(_middle(h.table()) - _middle(self.f.table()), h.first + 8 * h.step - self.f.reach)
        for _ in range(ROUNDS):
            radius = np.arange(h.first, min(h.reach, self.f.reach + larger - 3 * self.f.step), h.step)
            weights, fixed = h.basis(radius)
            place = np.abs(radius - larger)
            onto = self.f.basis(place)[0] / (1 + self.droop * place**2)[:, None]
            value = onto @ self.f.coefficients
            unlike, moved = weights @ h.coefficients + fixed - value, np.gradient(value, radius)
            change = -float(moved @ unlike) / max(float(moved @ moved), 1e-12)
            larger = max(larger + change, h.first + 8 * h.step - self.f.reach)
            if abs(change) < 1e-5:
                break
        return larger, unlike, np.concatenate([-onto, weights], axis=1), moved

    @property
    def order(self) -> float:
        """By how much the second disc is larger than the first, pixels."""
        return 0.0 if self.h is None else self.alike(self.h)[0]

    def exchanged(self) -> Aperture:
        """The same light with the discs in exchanged roles: its lattice is that of the second disc's centres."""
        if self.h is None:
            return self
        first, second = self.f.table()[:, 0], self.h.table()[:, 0]
        place = np.arange(max(len(first), len(second))) / FINE
        first, second = (np.interp(place, place[: len(one)], one) for one in (first, second))
        whole = 1 + self.droop * place**2
        shift, step = self.order, min(self.f.step, self.h.step)
        f = Radial.like(lambda r: np.interp(r, place, second * whole), 0, self.f.reach, step)
        low, high = max(self.h.first - shift, step), self.h.reach - shift
        h = Radial.like(lambda r: np.interp(r, place, first / whole), low, high, step)
        return replace(self, f=f, h=h, matrix=-self.matrix, origin=-self.origin)

    def offsets(self, centres: FloatArray) -> FloatArray:
        """Centre of the second disc relative to each lens, (n, 2)."""
        return np.asarray((centres - self.middle) @ self.matrix.T + self.origin, dtype=np.float64)

    def shifted(self, centres: FloatArray, by: FloatArray) -> Aperture:
        """Aperture whose second disc has moved by `by` (n, 2) relative to the lenses, an affine function of place."""
        design = np.column_stack([centres - self.middle, np.ones(len(centres))])
        change = np.linalg.lstsq(design, by, rcond=None)[0]
        return replace(self, matrix=self.matrix + change[:2].T, origin=self.origin + change[2])


def _middle(table: FloatArray) -> float:
    """Radius at which a profile first falls to half of its middle, pixels; outside it no light tells the profile."""
    dark = np.nonzero(table[:, 0] < 0.5 * table[0, 0])[0]
    return float(dark[0] if len(dark) else len(table)) / FINE


@numba.njit(nogil=True, cache=True)
def _accumulate(
    image: FloatImage,
    flags: Flags,
    centres: FloatArray,
    zones: npt.NDArray[np.int64],
    cell: Cell,
    step: float,
    total: FloatArray,
) -> None:
    half = total.shape[1] // 2
    reach = half * step
    for lens in range(centres.shape[0]):
        x, y = centres[lens, 0], centres[lens, 1]
        for j in range(max(int(y - reach) + 1, 0), min(int(y + reach) + 1, image.shape[0])):
            for i in range(max(int(x - reach) + 1, 0), min(int(x + reach) + 1, image.shape[1])):
                dx, dy = i - x, j - y
                if border(dx, dy, cell)[0] < 0.0 or flags[j, i] != 0:
                    continue
                row, column = int(np.rint(dy / step)) + half, int(np.rint(dx / step)) + half
                if 0 <= row < total.shape[1] and 0 <= column < total.shape[1]:
                    cellsum = total[zones[lens], row, column]
                    cellsum[0] += 1.0
                    cellsum[1] += dx
                    cellsum[2] += dy
                    cellsum[3] += image[j, i]


def zone_means(image: FloatImage, flags: Flags, centres: FloatArray, cell: Cell, zones: int = ZONES) -> Zones:
    """Mean subimage of each of `zones`² zones of the sensor.

    Parameters
    ----------
    image, flags
        Gray image, and the pixels to leave out where not 0, shape (y, x).
    centres
        Lens centres (n, 2).
    cell
        `lfflow.kernels.lattice.lens_light.cell_of`.
    """
    pitch = max(cell[2], cell[3])
    step, half = pitch / CELLS, int(0.6 * CELLS) + 1
    height, width = image.shape
    column = np.clip((centres[:, 0] / width * zones).astype(np.int64), 0, zones - 1)
    row = np.clip((centres[:, 1] / height * zones).astype(np.int64), 0, zones - 1)
    index = row * zones + column
    total = np.zeros((zones * zones, 2 * half + 1, 2 * half + 1, 4))
    _accumulate(image, flags, centres, index, cell, step, total)
    zone, j, i = np.nonzero(total[..., 0])
    weight, dx, dy, value = total[zone, j, i].T
    number = np.maximum(np.bincount(index, minlength=zones * zones), 1)
    means = [np.bincount(index, centres[:, axis], zones * zones) / number for axis in (0, 1)]
    return Zones(
        dx / weight, dy / weight, value / weight, weight, zone, j * (2 * half + 1) + i, np.stack(means, axis=1)
    )


@dataclass(frozen=True, slots=True)
class _Problem:
    """Least squares of the two-disc model on zone means; lengths in lens pitches, field −1…1."""

    offset: tuple[FloatArray, FloatArray]
    value: FloatArray
    root: FloatArray
    zone: npt.NDArray[np.int64]
    bin: npt.NDArray[np.int64]
    field: FloatArray
    motion: FloatArray
    parts: list[slice]
    tilted: bool = False

    def model(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Light of each bin, and its derivatives, shape (n, parameters).

        The parameters are radius, width and droop of the aperture and five moves of the lattice; with a second disc
        its scale, its origin (x, y), its radius and the width of its edge, without which it is the aperture's.
        """
        moves = self.motion[:, self.zone]
        dx, dy = (self.offset[axis] - moves[axis] @ p[3:8] for axis in (0, 1))
        square = dx * dx + dy * dy
        radius = np.sqrt(square) + 1e-9
        top = 1 + p[2] * square
        inner, slope = _edge(p[0] - radius, p[1])
        light = top * inner
        down = 2 * p[2] * inner - top * slope / radius
        by_x, by_y = down * dx, down * dy
        columns = [top * slope, -top * slope * (p[0] - radius) / p[1], square * inner]
        if len(p) > 8:
            field = self.field[self.zone]
            ex, ey = dx - field[:, 0] * p[8] - p[9], dy - field[:, 1] * p[8] - p[10]
            far = np.hypot(ex, ey) + 1e-9
            own = 12 if len(p) > 12 else 1
            outer, steep = _edge(p[11] - far, p[own])
            rim = light * steep
            to_x, to_y = rim * ex / far, rim * ey / far
            columns = [column * outer for column in columns]
            wider = -rim * (p[11] - far) / p[own]
            by_x, by_y, light = by_x * outer - to_x, by_y * outer - to_y, light * outer
            columns += [field[:, 0] * to_x + field[:, 1] * to_y, to_x, to_y, rim]
            if own == 1:
                columns[1] += wider
            else:
                columns.append(wider)
        moved = [-by_x * moves[0, :, q] - by_y * moves[1, :, q] for q in range(5)]
        return light, np.stack(columns[:3] + moved + columns[3:], axis=1)

    def residual(self, p: FloatArray) -> FloatArray:
        """Misfit of each bin, the zone's brightness solved for."""
        return self._fitted(p)[0]

    def jacobian(self, p: FloatArray) -> FloatArray:
        """Its derivatives, as far as they cannot be made up for by the brightness."""
        return self._fitted(p)[1]

    def narrowing(self, p: FloatArray) -> tuple[float, float]:
        """How much narrower the subimages are towards the corners than across, where field is 1, and its deviation.

        Two discs alike that part by ±d leave f·(1 + ½ d² ∂² log f), the derivative along d: to first order they look
        like one disc in their middle, to second order they are narrower along d. This is d², in lens pitches squared;
        its deviation is that of the zones. What all zones have in common is their bins' and their lenses' shape.
        """
        left, radius = self.residual(p), np.hypot(*self.offset)
        shared = np.bincount(self.bin, left * self.root) / np.maximum(np.bincount(self.bin, self.root**2), 1e-12)
        left = left - shared[self.bin] * self.root
        inside, steep = _edge(p[0] - radius, p[1])
        bend = -steep * ((p[0] - radius) / p[1] ** 2 + steep / np.maximum(inside, 1e-3))
        field = self.field[self.zone]
        along = (field[:, 0] * self.offset[0] + field[:, 1] * self.offset[1]) / np.maximum(radius, 1e-9)
        shape = 0.5 * bend * (along**2 - 0.5 * (field**2).sum(axis=1)) * self.root
        score, size = [], []
        for part in self.parts:
            tilt = np.stack([np.ones(part.stop - part.start), *(axis[part] for axis in self.offset)], axis=1)
            base = (inside * self.root)[part, None] * tilt
            bright = float(base[:, 0] @ self.value[part] / max(base[:, 0] @ base[:, 0], 1e-12))
            ring = bright * (shape[part] - base @ np.linalg.lstsq(base, shape[part], rcond=None)[0])
            score.append(float(ring @ left[part]))
            size.append(float(ring @ ring))
        scores, sizes = np.array(score), np.array(size)
        value = scores.sum() / sizes.sum()
        return float(value), float(np.linalg.norm(scores - value * sizes) / sizes.sum())

    def _fitted(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Misfit and its derivatives, each zone's brightness (and gradient, if `tilted`) solved for."""
        light, slopes = self.model(p)
        light, slopes = light * self.root, slopes * self.root[:, None]
        left = self.value.copy()
        for part in self.parts:
            tilt = np.stack([np.ones(part.stop - part.start), *(axis[part] for axis in self.offset)], axis=1)
            base = light[part, None] * tilt[:, : 3 if self.tilted else 1]
            inverse = np.linalg.inv(base.T @ base + 1e-9 * np.eye(base.shape[1]))
            shares = inverse @ (base.T @ self.value[part])
            left[part] -= base @ shares
            bright = tilt[:, : len(shares)] @ shares
            slope = slopes[part] * bright[:, None]
            slopes[part] = base @ (inverse @ (base.T @ slope)) - slope
        return left, slopes


def _edge(inside: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """A soft edge at the distance `inside` of its line, and its slope."""
    place = inside / width
    return ndtr(place), np.exp(-0.5 * np.minimum(place * place, 200.0)) / (abs(width) * 2.5066282746310002)


def two_discs(zones: Zones, motion: FloatArray, pitch: float, middle: FloatArray) -> list[tuple[Aperture, FloatArray]]:
    """Aperture of a picture, and how the five lattice parameters must change.

    The last has one disc. Before it comes that with two, if there is a second one: which of them is the aperture
    `Aperture.order` tells once their profiles are measured.

    Parameters
    ----------
    zones
        Mean subimages about the lattice's centres.
    motion
        Derivatives of the zones' mean centres by the lattice's parameters, (2, zones, 5).
    pitch
        Lens pitch, pixels.
    middle
        Middle of the sensor (x, y).
    """
    scale = np.abs(motion).max(axis=(0, 1)) / pitch
    peak = float(np.percentile(zones.value, 98))
    root = np.sqrt(zones.weight / zones.weight.mean())
    field = (zones.centres - middle) / middle.max()
    problem = _Problem(
        (zones.dx / pitch, zones.dy / pitch),
        zones.value / peak * root,
        root,
        zones.zone,
        zones.bin,
        field,
        motion / scale / pitch,
        [slice(a, b) for a, b in itertools.pairwise(np.searchsorted(zones.zone, np.arange(len(zones.centres) + 1)))],
    )
    start = np.array([0.46, 0.06, -0.2, *np.zeros(5)])
    single = _solve(problem, start)
    sharp = abs(single[1]) < SHARP * single[0]
    found, hidden = [single], 0.0
    if sharp:
        problem = replace(problem, tilted=True)
        single = _solve(problem, single)
        narrower, deviation = problem.narrowing(single)
        smeared = bool(1 + single[2] * single[0] ** 2 < FADED)
        if smeared:
            narrower = max(narrower, LARGEST_START**2)
        if narrower > SIGNIFICANT * deviation:
            first = np.array([0.46, 0.06, -0.2, *np.zeros(5)]) if smeared else _halved(single)
            apart = min(2 * math.sqrt(narrower), LARGEST_START)  # each moves by half against their middle
            for side in (-apart, apart):
                double = _solve(problem, np.concatenate([first, [side, 0, 0, first[0]]]))
                if _clips(double) and _apart(double) >= OVERLAPPING:
                    double = _solve(problem, np.append(double, double[1]))
                if _clips(double):
                    found.insert(0, double)
                    break
        if narrower > SUSPECT * deviation:
            hidden = pitch * float(np.sqrt(narrower + deviation))
    return [(_aperture(p, pitch, middle, sharp=sharp, hidden=hidden), np.asarray(p[3:8] / scale)) for p in found]


def _apart(p: FloatArray) -> float:
    """Motion of the second disc in widths of the edge."""
    return float(abs(p[8] / p[1]))


def _halved(single: FloatArray) -> FloatArray:
    """One of two like discs whose product looks like a single one: larger and softer."""
    radius, width = single[:2]
    return np.concatenate([[radius + 0.67 * width, 1.23 * width], single[2:]])


def _clips(p: FloatArray) -> bool:
    """Whether what was found is a second disc: about as large as the aperture, and with an edge."""
    if len(p) > 12 and abs(p[12]) > SOFTEST * p[11]:
        return False
    return bool(0.8 < p[11] / p[0] < 1 + 1.5 * abs(p[8]) / p[0] + 0.5 * abs(p[1]) / p[0])


def _solve(problem: _Problem, start: FloatArray) -> FloatArray:
    found = least_squares(problem.residual, start, problem.jacobian, method="lm", max_nfev=25, xtol=1e-5, ftol=1e-5)
    return np.asarray(found.x, dtype=np.float64)


def _aperture(p: FloatArray, pitch: float, middle: FloatArray, *, sharp: bool, hidden: float) -> Aperture:
    width, droop = max(abs(float(w)) for w in (p[1], *p[12:])) * pitch, float(p[2]) / pitch**2
    knot = max(KNOT * abs(p[1]) * pitch, NARROWEST)
    f = Radial.like(lambda r: (1 + p[2] * (r / pitch) ** 2) * ndtr((p[0] - r / pitch) / p[1]), 0, 0.585 * pitch, knot)
    if len(p) == 8:
        low = max((p[0] - 4 * abs(p[1])) * pitch, 5 * knot)
        g = Radial(
            np.zeros(max(int(np.ceil((0.585 * pitch - low) / (2 * knot))) + 2, 4)), low, 2 * knot, 0.585 * pitch, 0.0
        )
        return Aperture(f, g, None, np.zeros((2, 2)), np.zeros(2), middle, sharp, hidden, width, droop=droop)
    own = p[12] if len(p) > 12 else p[1]
    low, high = (max((p[11] + side * abs(own)) * pitch, knot) for side in (-4, 4))
    h = Radial.like(lambda r: ndtr((p[11] - r / pitch) / own), low, high, max(KNOT * abs(own) * pitch, NARROWEST))
    matrix, origin = np.eye(2) * p[8] * pitch / middle.max(), p[9:11] * pitch
    return Aperture(f, None, h, matrix, origin, middle, sharp, hidden, width, _apart(p), droop)
