"""What is known of a lattice and of what its lenses look like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfflow.kernels.lattice.aperture import Aperture
from lfflow.kernels.lattice.lens_light import HALF_DIAGONAL, FloatArray, Look
from lfflow.lattice import Lattice

NARROW_RIM = 0.07
"""The rim is never more than this share of the lens pitch."""
DEGREE = 4
"""Of the polynomial of the place on the sensor (−1…1) that the logarithm of the lenses' brightness is."""


@dataclass(frozen=True, slots=True)
class State:
    """What the rounds know of a picture.

    Parameters
    ----------
    lattice, aperture
        The lattice, and what its lenses look like.
    noise
        Variance of the Bayer sites by powers of the level, (4, 3).
    sites
        Gain left in each Bayer site, (4,).
    covariance
        Of (dh, dv, theta, cx, cy), (5, 5).
    typical
        Misfit (χ² per degree of freedom) of a typical lens of a scene; 0 as long as it is not known.
    falloff
        Logarithm of the lenses' brightness, by powers of the field right and down, (5, 5); 0 in a scene.
    order_std
        Standard deviation of `Aperture.order`, pixels.
    """

    lattice: Lattice
    aperture: Aperture
    noise: FloatArray
    sites: FloatArray
    covariance: FloatArray
    typical: float
    falloff: FloatArray
    order_std: float = 0.0


def look_of(state: State) -> Look:
    """A state as the kernels want it."""
    f, g, h = state.aperture.f, state.aperture.g, state.aperture.h
    splines = [
        (0, 1, 0) if one is None else (one.first, one.step, len(one.coefficients)) for one in (f, g if h is None else h)
    ]
    second, third = (np.zeros((0, 2)) if one is None else one.table() for one in (g, h))
    rim = 0.0 if h is None else min(HALF_DIAGONAL, NARROW_RIM * state.lattice.dh)
    droop, common, fold = state.aperture.droop, state.aperture.common, state.aperture.fold
    numbers = np.array(splines, dtype=float), state.sites, state.noise
    return Look(f.table(), second, third, *numbers, rim, droop, common, fold)


def falloff_of(field: FloatArray, brightness: FloatArray) -> FloatArray:
    """Polynomial of the logarithm of the lenses' brightness; those far off (dust, borders) do not count."""
    x, y = _powers(field)
    i, j = np.nonzero(np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1)) <= DEGREE)
    powers = x[:, i] * y[:, j]
    value, good = np.log(brightness), brightness > 0.2 * np.median(brightness)
    for _ in range(2):
        found = np.linalg.lstsq(powers[good], value[good], rcond=None)[0]
        off = np.abs(value - powers @ found)
        good = off < 4 * np.median(off[good]) / 0.6745
    falloff = np.zeros((DEGREE + 1, DEGREE + 1))
    falloff[i, j] = found
    return falloff


def _powers(field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Powers 0 to `DEGREE` of the place on the sensor right and down, (n, DEGREE + 1) each."""
    x, y = (np.vander(axis, DEGREE + 1, increasing=True) for axis in field.T)
    return x, y


def aside(state: State, centres: FloatArray) -> FloatArray:
    """What the kernels want of each lens (n, 2): the second disc's centre, or else the change of the brightness."""
    if state.aperture.h is not None:
        return state.aperture.offsets(centres)
    half = state.aperture.middle.max()
    x, y = _powers((centres - state.aperture.middle) / half)
    order = np.arange(1, DEGREE + 1)
    right = ((x[:, :-1] @ (state.falloff[1:] * order[:, None])) * y).sum(axis=1)
    down = ((y[:, :-1] @ (state.falloff[:, 1:] * order).T) * x).sum(axis=1)
    return np.asarray(np.stack([right, down], axis=1) / half)
