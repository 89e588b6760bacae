"""What clips a subimage: the aperture's own disc, and a second one that wanders over the field (cat's eye).

The disc that limits the central subimages is the aperture: its image lies at the same place under every lens and marks
the lens centre. A rim elsewhere in the main lens is seen as a second disc whose centre o moves linearly with the place
on the sensor, o = M·(c − middle) + o₀: a lattice of another pitch. Where it clips, the centroid of the light moves with
it, and only the arc that it leaves free tells where the lens is.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numba
import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.special import ndtr

from lfflow.kernels.lattice.lens_light import Cell, Flags, FloatArray, FloatImage, in_cell
from lfflow.kernels.lattice.radial import FINE, Radial

ZONES = 5
"""Zones along each side of the sensor."""
CELLS = 12
"""Bins of a zone's mean subimage per lens pitch."""
KNOT = 0.4
"""Distance of the knots of a profile in widths (standard deviations) of its edge."""
NARROWEST = 0.15
"""Knots are at least so many pixels apart: a pixel's own area blurs every edge."""
RINGS = 40
"""Rings per lens pitch within which the misfit of the edges' shape is averaged."""
SIGNIFICANT = 6.0
"""The subimages must be so many standard deviations narrower towards the corners before a second disc is looked for"""
RESOLVED = 0.7
"""and it must move by so many widths (standard deviations) of the edge from the middle of the sensor to its border:
below, either disc may be the aperture;"""
FADED = 0.5
"""Subimages whose light seems to fall to less towards their edge are not one disc: a second one smears them."""
LARGEST_START = 0.25
"""Largest motion of the second disc to start from, lens pitches from the middle of the sensor to its border."""
SUSPECT = 2.0
"""so many before the lattice is said to be less certain for one that may be there."""
TWIN = 3.0
"""The discs in exchanged roles explain the picture about as well: up to so many times the sum of squares."""
SHARP = 0.25
"""An edge that is wider (standard deviation) than so many radii of the aperture is not told from a gradient."""


@dataclass(frozen=True, slots=True)
class Zones:
    """Mean subimages of the zones of a sensor: bins that hold light, one row each.

    Parameters
    ----------
    dx, dy, value, weight
        Mean offset from the lens centre (px), mean value, number of pixels: shape (n,).
    zone
        Zone of each bin, (n,).
    centres
        Mean lens centre of each zone, (zones, 2).
    """

    dx: FloatArray
    dy: FloatArray
    value: FloatArray
    weight: FloatArray
    zone: npt.NDArray[np.int64]
    centres: FloatArray


@dataclass(frozen=True, slots=True)
class Aperture:
    """The mean subimage, and what clips it.

    Parameters
    ----------
    f
        Mean subimage by the distance from the lens centre.
    h
        Light that the second disc lets through by the distance from its centre; None without one.
    matrix, origin, middle
        That centre relative to the lens at c: matrix·(c − middle) + origin, pixels.
    sharp
        Whether the edge is narrow enough to be told from a gradient of the light across the subimages.
    hidden
        By how much the subimages' centres may be off at the end of the longer half axis of the sensor if a second disc
        as large as the first is there, pixels; 0 where nothing speaks for one.
    droop
        f without its edge is 1 + droop·r², r in pixels.
    common
        Share of the edges' blur that both have in common (`lfflow.kernels.lattice.lens_light`).
    """

    f: Radial
    h: Radial | None
    matrix: FloatArray
    origin: FloatArray
    middle: FloatArray
    sharp: bool
    hidden: float
    droop: float = 0.0
    common: float = 0.5

    @property
    def order(self) -> float:
        """By how much the second disc is larger than the first, pixels, by the middles of their edges."""
        return 0.0 if self.h is None else _middle(self.h.table()) - _middle(self.f.table())

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
                if not in_cell(dx, dy, cell) or flags[j, i] != 0:
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
    return Zones(dx / weight, dy / weight, value / weight, weight, zone, np.stack(means, axis=1))


@dataclass(frozen=True, slots=True)
class _Problem:
    """Least squares of the two-disc model on zone means; lengths in lens pitches, field −1…1."""

    offset: tuple[FloatArray, FloatArray]
    value: FloatArray
    root: FloatArray
    zone: npt.NDArray[np.int64]
    field: FloatArray
    motion: FloatArray
    parts: list[slice]
    tilted: bool = False

    def model(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Light of each bin, and its derivatives, shape (n, parameters).

        The parameters are radius, width and droop of the aperture and five moves of the lattice; with a second disc
        its scale, its origin (x, y) and its radius.
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
            outer, steep = _edge(p[11] - far, p[1])
            rim = light * steep
            to_x, to_y = rim * ex / far, rim * ey / far
            columns = [column * outer for column in columns]
            columns[1] -= rim * (p[11] - far) / p[1]
            by_x, by_y, light = by_x * outer - to_x, by_y * outer - to_y, light * outer
            columns += [field[:, 0] * to_x + field[:, 1] * to_y, to_x, to_y, rim]
        moved = [-by_x * moves[0, :, q] - by_y * moves[1, :, q] for q in range(5)]
        return light, np.stack(columns[:3] + moved + columns[3:], axis=1)

    def residual(self, p: FloatArray) -> FloatArray:
        """Misfit of each bin, the zone's brightness solved for."""
        return self._fitted(p)[0]

    def jacobian(self, p: FloatArray) -> FloatArray:
        """Its derivatives, as far as they cannot be made up for by the brightness."""
        return self._fitted(p)[1]

    def odd(self, p: FloatArray) -> float:
        """Sum of squares that no function of the radius explains: what the edges' shape cannot be blamed for."""
        left = self.residual(p)
        ring = (np.hypot(*self.offset) * RINGS).astype(np.int64)
        bottom = np.maximum(np.bincount(ring, self.root**2), 1e-12)
        left = left - (np.bincount(ring, left * self.root) / bottom)[ring] * self.root
        return float(left @ left)

    def narrowing(self, p: FloatArray) -> tuple[float, float]:
        """How much narrower the subimages are towards the corners than across, where field is 1, and its deviation.

        Two discs alike that part by ±d leave f·(1 + ½ d² ∂² log f), the derivative along d: to first order they look
        like one disc in their middle, to second order they are narrower along d. This is d², in lens pitches squared;
        its deviation is that of the zones.
        """
        left, radius = self.residual(p), np.hypot(*self.offset)
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

    The last has one disc. Before it come those with two, if there is a second one: both where either disc may be the
    aperture, for `Aperture.order` tells once their profiles are measured.

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
        if narrower > max(SIGNIFICANT * deviation, (0.5 * RESOLVED * single[1]) ** 2):
            first = np.array([0.46, 0.06, -0.2, *np.zeros(5)]) if smeared else single
            sides = [
                _solve(problem, np.concatenate([first, [side, 0, 0, first[0] * 1.1]])) for side in _starts(narrower)
            ]
            clipping = [p for p in sorted(sides, key=problem.odd) if _clips(p)]
            found = [p for p in clipping if problem.odd(p) < TWIN * problem.odd(clipping[0])] + found
        if narrower > SUSPECT * deviation:
            hidden = pitch * float(np.sqrt(narrower + deviation))
    return [(_aperture(p, pitch, middle, sharp=sharp, hidden=hidden), np.asarray(p[3:8] / scale)) for p in found]


def _starts(narrower: float) -> tuple[float, float]:
    """Motions of the second disc to start from: of two discs alike, each moves by √`narrower` against their middle."""
    motion = min(max(2 * np.sqrt(narrower), 0.01), LARGEST_START)
    return -motion, motion


def _clips(p: FloatArray) -> bool:
    """Whether what was found is a second disc: about as large as the aperture."""
    return bool(0.85 < p[11] / p[0] < 1 + 1.5 * abs(p[8]) / p[0] + 0.5 * abs(p[1]) / p[0])


def _solve(problem: _Problem, start: FloatArray) -> FloatArray:
    found = least_squares(problem.residual, start, problem.jacobian, method="lm", max_nfev=25, xtol=1e-5, ftol=1e-5)
    return np.asarray(found.x, dtype=np.float64)


def _aperture(p: FloatArray, pitch: float, middle: FloatArray, *, sharp: bool, hidden: float) -> Aperture:
    knot, droop = max(KNOT * abs(p[1]) * pitch, NARROWEST), float(p[2]) / pitch**2
    f = Radial.like(lambda r: (1 + p[2] * (r / pitch) ** 2) * ndtr((p[0] - r / pitch) / p[1]), 0, 0.585 * pitch, knot)
    if len(p) == 8:
        return Aperture(f, None, np.zeros((2, 2)), np.zeros(2), middle, sharp, hidden, droop)
    low, high = ((p[11] + side * abs(p[1])) * pitch for side in (-4, 4))
    h = Radial.like(lambda r: ndtr((p[11] - r / pitch) / p[1]), low, high, knot)
    return Aperture(f, h, np.eye(2) * p[8] * pitch / middle.max(), p[9:11] * pitch, middle, sharp, hidden, droop)
