"""What clips a subimage: the aperture's own disc, and a second one that wanders over the field (cat's eye).

The disc that limits the central subimages is the aperture: its image lies at the same place under every lens and marks
the lens centre. A rim elsewhere in the main lens is seen as a second disc whose centre o moves linearly with the place
on the sensor, o = M·(c − middle) + o₀: a lattice of another pitch. Where it clips, the centroid of the light moves with
it, and only the arc that it leaves free tells where the lens is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lfflow.kernels.lattice.lens_light import FloatArray
from lfflow.kernels.lattice.radial import FINE, Radial

ROUNDS = 8
"""Steps, at most, to the difference of two discs' radii."""
COMMON = 0.25
"""Share of the edges' blur that both have in common, before it is measured."""
OVERLAPPING = 0.9
"""Where the second disc moves by less than so many widths of the edge, no pixel sees one of the edges alone,"""
CLOSE = 0.4
"""and by less than so many, the edges' shape has the same effect as the common share of their blur."""


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
