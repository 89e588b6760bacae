"""One step towards the highest likelihood, of all that the lenses share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfflow.kernels.lattice.aperture import CLOSE, COMMON, Aperture
from lfflow.kernels.lattice.fit import jacobian, lens_indices, moved
from lfflow.kernels.lattice.lens_light import MOST_COMMON, Flags, FloatArray, FloatImage, cell_of
from lfflow.kernels.lattice.lens_scores import LEVELS, Sums
from lfflow.kernels.lattice.lens_state import State, aside, falloff_of, look_of
from lfflow.kernels.lattice.light_centres import centres_on
from lfflow.kernels.lattice.shared_normals import gather_normals
from lfflow.lattice import Lattice

BLOCKS = 24
"""Blocks along each side of the sensor whose scores count as independent."""
KNOWN_BEFORE = 0.1
"""Before a round, each coefficient of a profile is known to so much: where hardly a pixel tells it stays."""
ALIKE = 1e-3
"""Where both edges overlap, the light at the second disc's is known to so much by the first's."""
COMMON_KNOWN = 0.2
"""To how much the share of the edges' blur that is common is known before."""


def improve(image: FloatImage, flags: Flags, state: State, every: int, *, splines: bool, scene: bool = False) -> State:
    """One Gauss-Newton step on one lens of `every`."""
    centres = centres_on(state.lattice, image.shape, every)
    field = (centres - state.aperture.middle) / state.aperture.middle.max()
    moves = _moves(state.lattice, centres, field, aperture=state.aperture, scene=scene, shapes=splines)
    blocks = np.clip(((field + 1) * BLOCKS / 2).astype(np.int64), 0, BLOCKS - 1) @ np.array([1, BLOCKS])
    look, common = look_of(state), moves.shape[2]
    number = common + (int(look.splines[:, 2].sum()) if splines else 0)
    sums = Sums(np.zeros((4, 3, LEVELS)), np.zeros((2, 4)))
    totals, scores = np.zeros((BLOCKS**2, number, number)), np.zeros((BLOCKS**2, number))
    quality = np.zeros((len(centres), 2))
    gather_normals(
        image, flags, centres, aside(state, centres), moves, blocks, cell_of(state.lattice), look,
        3 if scene else 1, splines, state.typical, sums, totals, scores, quality,
    )  # fmt: skip
    before, order = _alike(state.aperture, common, number)
    step, covariance = _solve(totals, scores, common, before, state.aperture)
    state = replace(state, order_std=float(np.sqrt(order @ covariance @ order)))
    seen = quality[:, 1] > 0
    typical = float(np.median(quality[seen, 1])) if scene and seen.any() else 0.0
    falloff = falloff_of(field[seen], quality[seen, 0]) if splines and not scene else state.falloff
    return replace(_moved(state, step, covariance, centres, moves, sums), typical=typical, falloff=falloff)


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
