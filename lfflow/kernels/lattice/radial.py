"""Radial profiles as uniform cubic B-splines: the mean subimage f, even about its centre, and a clipping edge h."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

FINE = 64
"""Entries of a table per pixel."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Radial:
    """A profile by the coefficients of its B-splines at the radii first + j·step.

    Parameters
    ----------
    coefficients
        Shape (n,).
    first, step
        Pixels. With `first` 0 the profile is even.
    reach
        Radius at which it ends, pixels; beyond its knots it is 0.
    inner
        Its value below its knots, where `first` is not 0.
    """

    coefficients: FloatArray
    first: float
    step: float
    reach: float
    inner: float = 1.0

    @classmethod
    def like(cls, function: Callable[[FloatArray], FloatArray], first: float, last: float, step: float) -> Radial:
        """Profile nearest to a function between two radii, pixels."""
        count = max(int(np.ceil((last - first) / step)) + 2, 4)
        empty = cls(np.zeros(count), first, step, last)
        radius = np.arange(first, last, step / 8)
        weights, fixed = empty.basis(radius)
        found = np.linalg.lstsq(weights, function(radius) - fixed, rcond=None)[0]
        return replace(empty, coefficients=np.asarray(found, dtype=np.float64))

    def basis(self, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights of the coefficients (radii, n), and the part that hangs on none."""
        count = len(self.coefficients)
        place = (radius - self.first) / self.step
        index = np.floor(place).astype(int)
        part = place - index
        rest = 1 - part
        shares = [rest**3 / 6, (4 - 6 * part**2 + 3 * part**3) / 6, (4 - 6 * rest**2 + 3 * rest**3) / 6, part**3 / 6]
        weights, fixed = np.zeros((len(radius), count)), np.zeros(len(radius))
        for offset, share in zip((-1, 0, 1, 2), shares, strict=True):
            knot = np.abs(index + offset) if self.first == 0 else index + offset
            inside = (knot >= 0) & (knot < count)
            weights[np.nonzero(inside)[0], knot[inside]] += share[inside]
            fixed += np.where(knot < 0, self.inner * share, 0.0)
        return weights, fixed

    def table(self) -> FloatArray:
        """Value and slope at the radii j / FINE, shape (m, 2)."""
        radius = np.arange(int(self.reach * FINE) + 2) / FINE
        weights, fixed = self.basis(radius)
        values = weights @ self.coefficients + fixed
        return np.stack([values, np.gradient(values) * FINE], axis=1)

    def moved(self, step: FloatArray) -> Radial:
        """Profile with its coefficients changed by `step`."""
        return replace(self, coefficients=self.coefficients + step)
