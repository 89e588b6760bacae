"""Maximum likelihood: the lattice that explains every pixel of a picture, with the sensor's own noise.

The normal equations of every lens (`lens_scores`) are gathered into those of what all lenses share: the
lattice, a gradient of the light across the subimages that changes linearly over the sensor, the second aperture's disc
and the profiles of both edges with the share of their blur that they have in common. What a centre is follows from the
mean subimage being a function of the radius. The covariance is the sandwich of the Fisher matrix and the scatter of the
scores over blocks of lenses, so that it holds for whatever noise the picture has, and by how far the model holds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from lfflow.distortion import STRAIGHT, Distortion
from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.lattice.aperture import CLOSE, COMMON, Aperture, two_discs, zone_means
from lfflow.kernels.lattice.centres import lens_centres
from lfflow.kernels.lattice.fit import Fit, jacobian, lens_indices, moved
from lfflow.kernels.lattice.lens_light import HALF_DIAGONAL, MOST_COMMON, Flags, FloatArray, FloatImage, Look, cell_of
from lfflow.kernels.lattice.lens_scores import DENSE, LEVELS, PLAIN, Sums, lens_normals
from lfflow.kernels.lattice.shared_normals import gather_normals
from lfflow.lattice import Lattice

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
NARROW_RIM = 0.07
"""The rim is never more than this share of the lens pitch."""
BLOCKS = 24
"""Blocks along each side of the sensor whose scores count as independent."""
KNOWN_BEFORE = 0.1
"""Before a round, each coefficient of a profile is known to so much: where hardly a pixel tells it stays."""
DEGREE = 4
"""Of the polynomial of the place on the sensor (−1…1) that the logarithm of the lenses' brightness is."""
ALIKE = 1e-3
"""Where both edges overlap, the light at the second disc's is known to so much by the first's."""
COMMON_KNOWN = 0.2
"""To how much the share of the edges' blur that is common is known before."""
MODEL_ERROR = 3e-3
"""The model of two edges holds to this share of the distance by which the second disc moves over the sensor,"""
OVERLAP_ERROR = 4e-3
"""and to this one times the square of the edges' width over that distance: where they overlap they are one shape."""


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
    centres = _centres(lattice, image.shape, 3)
    zones = zone_means(image, flags, centres, cell_of(lattice))
    k = (zones.centres - (lattice.cx, lattice.cy)) @ np.linalg.inv(lattice.matrix).T
    middle = np.array([image.shape[1] - 1, image.shape[0] - 1]) / 2
    found = two_discs(zones, jacobian(lattice, k), lattice.dh, middle)
    noise = np.tile([0.05, 0.05, 0.0], (4, 1))
    return [
        State(moved(lattice, step), look, noise, np.ones(4), first.covariance, 0.0, np.zeros((DEGREE + 1, DEGREE + 1)))
        for look, step in found
    ]


def _centres(lattice: Lattice, shape: tuple[int, ...], every: int) -> FloatArray:
    return lens_centres(lattice, shape[0], shape[1], margin=0.6 * max(lattice.dh, lattice.dv), every=every)


def measure_lenses(
    image: FloatImage, flags: Flags, state: State, distortion: Distortion = STRAIGHT
) -> tuple[FloatArray, FloatArray]:
    """Centre of every lens by its own light, and its standard deviation: (n, 2) each as (x, y), pixels.

    Each is one step from where the lattice and its `distortion` put it.

    A lens whose light does not tell is NaN. What clips the subimages and the pixel grid's phase do not move these
    centres, unlike those of `lfflow.kernels.lattice.centres.measure_centres`.
    """
    centres = np.stack(distortion.moved(tuple(_centres(state.lattice, image.shape, 1).T)), axis=1)
    size = DENSE if state.aperture.h is not None else PLAIN
    normals, rights = np.zeros((len(centres), size, size)), np.zeros((len(centres), size))
    quality, sums = np.zeros((len(centres), 3)), Sums(np.zeros((4, 3, LEVELS)), np.zeros((2, 4)))
    lens_normals(
        image,
        flags,
        centres,
        _aside(state, centres),
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


def improve(image: FloatImage, flags: Flags, state: State, every: int, *, splines: bool, scene: bool = False) -> State:
    """One Gauss-Newton step on one lens of `every`."""
    centres = _centres(state.lattice, image.shape, every)
    field = (centres - state.aperture.middle) / state.aperture.middle.max()
    moves = _moves(state.lattice, centres, field, aperture=state.aperture, scene=scene, shapes=splines)
    blocks = np.clip(((field + 1) * BLOCKS / 2).astype(np.int64), 0, BLOCKS - 1) @ np.array([1, BLOCKS])
    look, common = look_of(state), moves.shape[2]
    number = common + (int(look.splines[:, 2].sum()) if splines else 0)
    sums = Sums(np.zeros((4, 3, LEVELS)), np.zeros((2, 4)))
    totals, scores = np.zeros((BLOCKS**2, number, number)), np.zeros((BLOCKS**2, number))
    quality = np.zeros((len(centres), 2))
    gather_normals(
        image, flags, centres, _aside(state, centres), moves, blocks, cell_of(state.lattice), look,
        3 if scene else 1, splines, state.typical, sums, totals, scores, quality,
    )  # fmt: skip
    before, order = _alike(state.aperture, common, number)
    step, covariance = _solve(totals, scores, common, before, state.aperture)
    state = replace(state, order_std=float(np.sqrt(order @ covariance @ order)))
    seen = quality[:, 1] > 0
    typical = float(np.median(quality[seen, 1])) if scene and seen.any() else 0.0
    falloff = _falloff(field[seen], quality[seen, 0]) if splines and not scene else state.falloff
    return replace(_moved(state, step, covariance, centres, moves, sums), typical=typical, falloff=falloff)


def _falloff(field: FloatArray, brightness: FloatArray) -> FloatArray:
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


def _aside(state: State, centres: FloatArray) -> FloatArray:
    """What the kernels want of each lens (n, 2): the second disc's centre, or else the change of the brightness."""
    if state.aperture.h is not None:
        return state.aperture.offsets(centres)
    half = state.aperture.middle.max()
    x, y = _powers((centres - state.aperture.middle) / half)
    order = np.arange(1, DEGREE + 1)
    right = ((x[:, :-1] @ (state.falloff[1:] * order[:, None])) * y).sum(axis=1)
    down = ((y[:, :-1] @ (state.falloff[:, 1:] * order).T) * x).sum(axis=1)
    return np.asarray(np.stack([right, down], axis=1) / half)


def _moved(
    state: State, step: FloatArray, covariance: FloatArray, centres: FloatArray, moves: FloatArray, sums: Sums
) -> State:
    """State after a step of the common parameters and the profiles."""
    common = moves.shape[2]
    aperture, shift = state.aperture, moves @ step[:common]
    if aperture.h is not None:
        aperture = aperture.shifted(centres, shift[:, -3:-1] - shift[:, -5:-3])
        common_blur = float(np.clip(aperture.common + step[common - 1], 0.0, MOST_COMMON))
        aperture = replace(aperture, common=common_blur)
    elif len(step) > common:
        aperture = replace(aperture, fold=aperture.fold + float(step[common - 1]))
    if len(step) > common:
        of_f, of_rest = np.split(step[common:], [len(aperture.f.coefficients)])
        g, h = (one if one is None else one.moved(of_rest) for one in (aperture.g, aperture.h))
        aperture = replace(aperture, f=aperture.f.moved(of_f), g=g, h=h)
    sites = state.sites * np.where(sums.sites[1] > 0, sums.sites[0] / np.maximum(sums.sites[1], 1e-12), 1)
    noise = np.array([_noise_model(*site) for site in zip(sums.levels, state.noise, strict=True)])
    lattice = moved(state.lattice, step[:5])
    return replace(
        state,
        lattice=lattice,
        aperture=aperture,
        noise=noise,
        sites=sites / sites.mean(),
        covariance=covariance[:5, :5],
    )


def _moves(
    lattice: Lattice, centres: FloatArray, field: FloatArray, *, aperture: Aperture, scene: bool, shapes: bool
) -> FloatArray:
    """Derivatives of each lens's gradient, centre and second disc by the common parameters, (n, 2 to 7, parameters).

    `shapes`: the share of the light from beyond the border is one of them.
    """
    first, clipped = 0 if scene else 2, aperture.h is not None
    gradients = 6 if aperture.sharp and not scene else 0
    moves = np.zeros((len(centres), first + (5 if clipped else 2 + shapes), 5 + gradients + (5 if clipped else shapes)))
    moves[:, first : first + 2, :5] = np.moveaxis(jacobian(lattice, lens_indices(lattice, centres)), 0, 1)
    for axis in (0, 1):
        if gradients:
            moves[:, axis, 5 + 3 * axis] = 1
            moves[:, axis, 6 + 3 * axis : 8 + 3 * axis] = field
        if clipped:
            moves[:, first + 2 + axis, 5 + gradients + axis] = 1
            moves[:, first + 2 + axis, 7 + gradients + axis] = field[:, axis]
    if shapes or clipped:
        moves[:, -1, -1] = 1
    return moves


def _alike(aperture: Aperture, common: int, number: int) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """What is known before of the second disc's edge: that it is like the first's, but for its radius.

    Precision (number, number) of the shared parameters and its score, and how `Aperture.order` changes by them.
    """
    precision, score, order = np.zeros((number, number)), np.zeros(number), np.zeros(number)
    if aperture.h is not None and number > common:
        _, unlike, slopes, moved = aperture.alike(aperture.h)
        order[common:] = -(moved @ slopes) / (moved @ moved)
        slopes = slopes + np.outer(moved, order[common:])
        if aperture.overlapping:
            precision[common:, common:] = slopes.T @ slopes / ALIKE**2
            score[common:] = -slopes.T @ unlike / ALIKE**2
        known = 1e-3 if aperture.apart < CLOSE else COMMON_KNOWN
        precision[common - 1, common - 1] = known**-2
        score[common - 1] = (COMMON - aperture.common) * known**-2
    return (precision, score), order


def _solve(
    totals: FloatArray, scores: FloatArray, common: int, before: tuple[FloatArray, FloatArray], aperture: Aperture
) -> tuple[FloatArray, FloatArray]:
    """Step and covariance of the shared parameters from the normal equations of blocks and what is known `before`."""
    totals = np.tril(totals) + np.swapaxes(np.tril(totals, -1), 1, 2)
    normal = totals.sum(axis=0) + before[0]
    normal[range(common, len(normal)), range(common, len(normal))] += KNOWN_BEFORE**-2
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-30))
    scaled = normal * np.outer(scale, scale)
    # A coefficient that no pixel hangs on stays, and so does the first one: the profile's height is the lenses' own.
    ridge = np.full(len(scaled), 1e-6)
    ridge[:common] = 0.0
    ridge[common : common + 1] = 1e3
    inverse = np.linalg.inv(scaled + np.diag(ridge)) * np.outer(scale, scale)
    step = inverse @ (scores.sum(axis=0) + before[1])
    last = common - 1
    share = aperture.common + float(step[last])
    if aperture.h is not None and not 0.0 <= share <= MOST_COMMON:  # the best step to the bound of the common share
        towards = inverse[last] / inverse[last, last]
        step = step + (min(max(share, 0.0), MOST_COMMON) - share) * towards
        inverse = inverse - np.outer(towards, inverse[last])
    left = scores - totals @ step
    covariance = inverse @ (left.T @ left + before[0]) @ inverse
    return step, covariance


def _noise_model(levels: FloatArray, before: FloatArray) -> FloatArray:
    """Variance by powers of the level (offset, slope, square), none below 0, from the residuals' moments."""
    from scipy.optimize import nnls

    count, total, squares = levels
    filled = count > 100
    if filled.sum() < 3:
        return before
    level, variance = total[filled] / count[filled], squares[filled] / count[filled]
    weight = np.sqrt(count[filled]) / np.maximum(variance, 1e-12)
    found, _ = nnls(level[:, None] ** np.arange(3) * weight[:, None], variance * weight)
    return np.array([max(found[0], 0.2 * float(variance.min())), found[1], found[2]])
