"""Aperture of a picture from the mean subimages of its zones: one disc, or two that part towards the corners."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.special import ndtr

from lfflow.kernels.lattice.aperture import OVERLAPPING, Aperture
from lfflow.kernels.lattice.lens_light import FloatArray
from lfflow.kernels.lattice.radial import Radial
from lfflow.kernels.lattice.zones import Zones

KNOT = 0.4
"""Distance of the knots of a profile in widths (standard deviations) of its edge."""
NARROWEST = 0.15
"""Knots are at least so many pixels apart: a pixel's own area blurs every edge."""
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
