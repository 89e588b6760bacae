"""The centre of every lens by its own light."""

from __future__ import annotations

import numpy as np

from lfflow.distortion import STRAIGHT, Distortion
from lfflow.kernels.lattice.centres import lens_centres
from lfflow.kernels.lattice.lens_light import Flags, FloatArray, FloatImage, cell_of
from lfflow.kernels.lattice.lens_scores import DENSE, LEVELS, PLAIN, Sums, lens_normals
from lfflow.kernels.lattice.lens_state import State, aside, look_of
from lfflow.lattice import Lattice


def centres_on(lattice: Lattice, shape: tuple[int, ...], every: int) -> FloatArray:
    """Centres (n, 2) as (x, y) of one lens of `every` that lies well inside an image of `shape`, pixels."""
    return lens_centres(lattice, shape[0], shape[1], margin=0.6 * max(lattice.dh, lattice.dv), every=every)


def measure_lenses(
    image: FloatImage, flags: Flags, state: State, distortion: Distortion = STRAIGHT
) -> tuple[FloatArray, FloatArray]:
    """Centre of every lens by its own light, and its standard deviation: (n, 2) each as (x, y), pixels.

    Each is one step from where the lattice and its `distortion` put it.

    A lens whose light does not tell is NaN. What clips the subimages and the pixel grid's phase do not move these
    centres, unlike those of `lfflow.kernels.lattice.centres.measure_centres`.
    """
    centres = np.stack(distortion.moved(tuple(centres_on(state.lattice, image.shape, 1).T)), axis=1)
    size = DENSE if state.aperture.h is not None else PLAIN
    normals, rights = np.zeros((len(centres), size, size)), np.zeros((len(centres), size))
    quality, sums = np.zeros((len(centres), 3)), Sums(np.zeros((4, 3, LEVELS)), np.zeros((2, 4)))
    lens_normals(
        image,
        flags,
        centres,
        aside(state, centres),
        cell_of(state.lattice),
        look_of(state),
        sums,
        normals,
        rights,
        quality,
    )
    keep = np.array([0, 3, 4])  # a gradient of one lens alone is nothing that its centre should give way to
    inverse = np.linalg.inv(normals[:, keep[:, None], keep] + 1e-9 * np.eye(3))
    shift = np.einsum("nij,nj->ni", inverse, rights[:, keep])[:, 1:]
    spread = np.sqrt(np.maximum(np.einsum("nii->ni", inverse)[:, 1:], 0))
    dark = ~(spread.max(axis=1) < 0.1 * state.lattice.dh) | (np.hypot(*shift.T) > 0.2 * state.lattice.dh)
    shift[dark] = np.nan
    return centres + shift, np.where(dark[:, None], np.nan, spread)
