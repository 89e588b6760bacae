"""Maximum likelihood: the lattice that explains every pixel of a picture, with the sensor's own noise.

The normal equations of every lens (`lens_scores`) are gathered into those of what all lenses share: the
lattice, a gradient of the light across the subimages that changes linearly over the sensor, the second aperture's disc
and the profiles of both edges with the share of their blur that they have in common. What a centre is follows from the
mean subimage being a function of the radius. The covariance is the sandwich of the Fisher matrix and the scatter of the
scores over blocks of lenses, so that it holds for whatever noise the picture has, and by how far the model holds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.lattice.aperture import CLOSE, COMMON
from lfflow.kernels.lattice.fit import Fit, jacobian, moved
from lfflow.kernels.lattice.gauss_newton import improve
from lfflow.kernels.lattice.lens_light import Flags, FloatArray, FloatImage, cell_of
from lfflow.kernels.lattice.lens_state import DEGREE, State
from lfflow.kernels.lattice.light_centres import centres_on
from lfflow.kernels.lattice.two_discs import two_discs
from lfflow.kernels.lattice.zones import zone_means

SPARSE = 12
"""The rounds before the last read one lens of so many (more of them where there are less than 40 000)."""
FEW, MANY = 5000, 20000
"""Lenses that are read, with a second disc, in each round and in the last precise one: the edges' profiles are looked
for too. Twice as many in each round where the edges are close."""
MOST_ROUNDS = 12
MOST_EXCHANGES = 2
"""A second disc that turns out to be the smaller so often is not told from the first."""
SETTLED, WANDERED = 1e-3, 1e-2
"""Those rounds end when the lattice, and the second disc at the border of the sensor, move by less, pixels."""
MODEL_ERROR = 3e-3
"""The model of two edges holds to this share of the distance by which the second disc moves over the sensor,"""
OVERLAP_ERROR = 4e-3
"""and to this one times the square of the edges' width over that distance: where they overlap they are one shape."""


def refine(
    image: FloatImage, first: Fit, flags: Flags | None = None, *, scene: FloatImage | None = None, precise: bool = True
) -> tuple[Fit, State]:
    """Lattice of the highest likelihood, its covariance, and what its lenses look like.

    Parameters
    ----------
    image
        Gray image with equal gains of the Bayer sites, shape (y, x).
    first
        Lattice from the subimages' peaks.
    flags
        Pixels to leave out, where not 0.
    scene
        Where the image shows a scene: the same with the scene divided out (`centres.flatten_scene`).
    precise
        Read every lens at last; else one of `SPARSE`.

    Returns
    -------
    fit, state
        In a scene whose subimages have no sharp edge the first lattice stays: their shape says less than their peaks.

    Raises
    ------
    LatticeNotFoundError
        The steps leave the neighbourhood of the first lattice.
    """
    flags = np.zeros(image.shape, np.uint8) if flags is None else flags
    states = find_aperture(image if scene is None else scene, flags, first)
    if scene is not None and not states[0].aperture.sharp:
        return first, replace(states[0], lattice=first.lattice)
    state = _untangled(image, flags, states[:-1], first, scene=scene is not None, precise=precise)
    if state is None:
        thin = max(1, round(SPARSE * min(1.0, first.count / 40000)))
        if precise or scene is not None:
            rounds = [(thin, True), (thin, True)] + [(1, False)] * precise
        else:
            rounds = [(max(thin, round(first.count / FEW)), True), (thin, False)]
        state = _improved(image, flags, states[-1], rounds, first, scene=scene is not None)
    state = replace(state, covariance=state.covariance + _systematic(state))
    return replace(first, lattice=state.lattice, covariance=state.covariance), state


def _systematic(state: State) -> FloatArray:
    """Covariance by what the lenses look like: a second disc not found or taken for the first, a model that errs.

    The lattice is larger or smaller for the first two; pixels are square, so that the last differs along x and y.
    """
    lattice, aperture = state.lattice, state.aperture
    half = aperture.middle.max()
    k = np.array([[0.0, 0.0], [40.0, 0.0], [0.0, 40.0]])
    place = (k @ lattice.matrix.T + (lattice.cx, lattice.cy) - aperture.middle) / half
    design = jacobian(lattice, k).reshape(-1, 5)
    if aperture.h is None:
        motions = [aperture.hidden * place]
    else:
        exchanged = float(ndtr(-aperture.order / state.order_std))
        motions = [np.sqrt(exchanged) * aperture.offsets(aperture.middle + half * place)]
        overlap = aperture.width / max(aperture.motion, 1e-9)
        error = aperture.motion * float(np.hypot(MODEL_ERROR, OVERLAP_ERROR * overlap**2))
        motions += [error * place * axis for axis in np.eye(2)]
    changes = np.stack([np.linalg.lstsq(design, motion.T.ravel(), rcond=None)[0] for motion in motions])
    return np.asarray(changes.T @ changes)


def _untangled(
    image: FloatImage, flags: Flags, states: list[State], first: Fit, *, scene: bool, precise: bool
) -> State | None:
    """Lattice of subimages that two discs clip; the one that turns out to be the smaller is the aperture.

    None where there is no second disc, or where it is not to be told from the first. With `precise`, more lenses are
    read at last.
    """
    if not states:
        return None
    thin = max(1, round(first.count / (FEW * (1 + (states[0].aperture.apart < CLOSE)))))
    state, exchanges = states[0], 0
    for done in range(MOST_ROUNDS):
        if done >= 2 and state.aperture.order < 0:
            state, exchanges = _exchanged(state), exchanges + 1
        lost = state.aperture.overlapping and state.aperture.motion < state.aperture.hidden
        if lost or exchanges > MOST_EXCHANGES:
            return None
        try:
            before, state = state, _improved(image, flags, state, [(thin, True)], first, scene=scene)
        except LatticeNotFoundError:  # not a second disc after all
            return None
        wandered = float(np.abs(state.aperture.matrix - before.aperture.matrix).max() * state.aperture.middle.max())
        settled = wandered < WANDERED and state.lattice.distance_to(before.lattice, *image.shape) < SETTLED
        if settled and state.aperture.order >= 0:
            last = [(max(1, round(first.count / MANY)), True)] * precise
            return _improved(image, flags, state, last, first, scene=scene)
    return None


def _exchanged(state: State) -> State:
    """State whose aperture is the second disc."""
    k = np.array([[0.0, 0.0], [40.0, 0.0], [0.0, 40.0]])
    lattice, aperture = state.lattice, state.aperture
    offset = aperture.offsets(k @ lattice.matrix.T + (lattice.cx, lattice.cy))
    step = np.linalg.lstsq(jacobian(lattice, k).reshape(-1, 5), offset.T.ravel(), rcond=None)[0]
    aperture = replace(aperture.exchanged(), common=COMMON)
    return replace(state, lattice=moved(lattice, np.asarray(step, dtype=np.float64)), aperture=aperture)


def _improved(
    image: FloatImage, flags: Flags, state: State, rounds: list[tuple[int, bool]], first: Fit, *, scene: bool
) -> State:
    for every, splines in rounds:
        state = improve(image, flags, state, every, splines=splines, scene=scene)
        if not state.lattice.distance_to(first.lattice, *image.shape) < 0.5 * first.lattice.dh:
            raise LatticeNotFoundError("the likelihood has no maximum near the measured centres")
    return state


def find_aperture(image: FloatImage, flags: Flags, first: Fit) -> list[State]:
    """Lattice and aperture from the mean subimages of the zones of the sensor (`two_discs`)."""
    lattice = first.lattice
    centres = centres_on(lattice, image.shape, 3)
    zones = zone_means(image, flags, centres, cell_of(lattice))
    k = (zones.centres - (lattice.cx, lattice.cy)) @ np.linalg.inv(lattice.matrix).T
    middle = np.array([image.shape[1] - 1, image.shape[0] - 1]) / 2
    found = two_discs(zones, jacobian(lattice, k), lattice.dh, middle)
    noise = np.tile([0.05, 0.05, 0.0], (4, 1))
    return [
        State(moved(lattice, step), look, noise, np.ones(4), first.covariance, 0.0, np.zeros((DEGREE + 1, DEGREE + 1)))
        for look, step in found
    ]
