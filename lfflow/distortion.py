"""A bent lattice: the smooth displacement of the lens centres from the lattice that fits them best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.polynomial import legendre

FloatArray = npt.NDArray[np.float64]

DEGREE = 5
TERMS = tuple((i, total - i) for total in range(1, DEGREE + 1) for i in range(total, -1, -1))
"""Degrees (i, j) of the products of Legendre polynomials P_i(x)·P_j(y), by rising total degree. Degree 0 is the
lattice's own, and all of degree 1 but a shear; over the sensor every other product is orthogonal to them."""


def products(x: npt.ArrayLike, y: npt.ArrayLike, half: FloatArray, degree: int = DEGREE) -> FloatArray:
    """Products of `TERMS` up to a total `degree`, shape (..., terms).

    The polynomials' −1 and 1 are the sensor's edges: `half` holds half the distance of the first and the last pixel
    across and down.
    """
    across = legendre.legvander(np.asarray(x, dtype=np.float64) / half[0] - 1, degree)
    down = legendre.legvander(np.asarray(y, dtype=np.float64) / half[1] - 1, degree)
    return np.stack([across[..., i] * down[..., j] for i, j in TERMS if i + j <= degree], axis=-1)


@dataclass(frozen=True, eq=False, slots=True)
class Distortion:
    """Displacement of the lens centres as a polynomial of their place on the lattice.

    Parameters
    ----------
    numbers
        For x and y: half the distance of the sensor's first and last pixel, then the coefficients of `TERMS`; sensor
        pixels, shape (2, 1 + terms). All 0 (`STRAIGHT`) or NaN: nothing is displaced.
    """

    numbers: FloatArray

    @property
    def straight(self) -> bool:
        """Whether nothing is displaced."""
        return not np.nan_to_num(self.numbers[:, 1:]).any()

    def displacement(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Displacement (right, down) of centres that the lattice puts at (x, y), sensor pixels."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        if self.straight:
            return np.zeros(x.shape), np.zeros(x.shape)
        shift = products(x, y, self.numbers[:, 0]) @ self.numbers[:, 1:].T
        return shift[..., 0], shift[..., 1]

    def moved(self, centres: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Centres (x, y) of a lattice where the bend puts them; the same arrays where it is straight."""
        if self.straight:
            return centres
        right, down = self.displacement(*centres)
        return centres[0] + right, centres[1] + down


STRAIGHT = Distortion(np.zeros((2, 1 + len(TERMS))))
"""Of a lattice that is not bent."""
