"""Disparity of the central view of a mosaicked field, from its own samples to a map with an error (METHOD 8).

First pass: same-colour pairs of one row or column, where their support allows. Second pass: the central view is
completed in colour along that disparity, and every sample of every view is compared with it. The costs of the sides of
the aperture are fused without the worse ones and regularised along the picture's edges. Below the step of the
hypotheses the samples decide again, joined by a surface of little curvature that also spans what has no texture.
Lenses beside jumps go to the side that the views and the colours tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, minimum_filter

from lfflow.conventions import CFA_NONE
from lfflow.kernels.aggregate import regularise
from lfflow.kernels.colour.completion import complete_centre
from lfflow.kernels.mosaicked.clarity import is_clear, noise_level, told_range
from lfflow.kernels.mosaicked.edge_place import place_edges
from lfflow.kernels.mosaicked.error_map import TEXTURELESS, error_map, half_range
from lfflow.kernels.mosaicked.fusion import Fusion, fuse_costs
from lfflow.kernels.mosaicked.islands import without_islands
from lfflow.kernels.mosaicked.levelling import levelled, without_strangers
from lfflow.kernels.mosaicked.model_cost import model_costs
from lfflow.kernels.mosaicked.mosaic_field import MosaicField
from lfflow.kernels.mosaicked.pair_cost import Interpolation, pair_cost, pair_support
from lfflow.kernels.mosaicked.refine import Evidence, evidence
from lfflow.kernels.mosaicked.sides import choose_sides
from lfflow.kernels.mosaicked.subpixel import CostInterpolation, minimum
from lfflow.kernels.surface import fit_surface, lattice_axes
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]
Pair = tuple[int, int]

FIRST_RANGE = 1.0
WIDEST_RANGE = 4.0
SECOND_STEP = 0.08
SHORTEST, LONGEST = 2, 4
"""Steps between the views of a pair of the first pass."""
PRESSED = 0.04
"""Share of the clear places that may lie at the border before the range is doubled."""
INNER, OUTER, RIM = 0.58, 0.73, 1.09
"""Radii, in units of the aperture's: views within the first make the picture, those between the others are compared."""
FIRST_PENALTIES, SECOND_PENALTIES = (0.1, 0.7), (1.6, 8.0)
"""Price of a change by one step and of a jump, in units of the cost of what fits."""
EDGE, LEAST_EDGE = 1.5, 0.02
"""Change of the picture (mean over the colours) at an edge: in units of a sample's noise, and at least. It makes jumps
2.7 times cheaper, and loosens the surface to half."""
PAIR_NOISE = 1.2
"""Mean square of the difference of a sample and an interpolated one, in units of the variance of one."""
STRANGE, UNEVEN = 6.0, 0.1
"""Differences of a view from the picture, in units of a sample's noise: of one sample that shows something else, and of
the mean over several lenses where the light of the view is another."""
SECOND_BLOCK = 0.8
"""Gaussian of the second pass, lens pitches."""
MOSTLY_NOISE = 0.25
"""Share of clear places up to which the second pass is done twice: the picture along the first disparity is poor."""
BAND, BAND_REACH = 0.25, 3
"""The second pass looks so much, and so many lenses, around the first disparity."""
STIFFNESS, JUMP, STEPS = 2e4, 0.02, 40
"""Of the surface, `lfflow.kernels.surface.fit_surface`; what has little texture needs that many steps to settle."""
BREAKS, LATER_BREAKS = 12, 3
"""How often its breaks are sought again, the first time and later: jumps that nothing tells of heal from their ends."""
QUIET, FEWEST, MOST = 0.008, 2, 8
"""How often the samples are asked is this noise over theirs, within bounds: the less noise, the less may differ and yet
be alike, and the shorter the way that one answer leads."""
MOST_DOUBT = 0.03
"""The surface breaks where it bends by more than a place knows its disparity, and by more than this in any case."""
TELLING = 0.45
"""Radius of the aperture from which views are asked for what is below the hypotheses: the inner ones know little."""
READ_LEVEL = 0.005
"""Radiance added under the root that makes photon noise the same at all levels: that of the read noise."""
CLIPPED_WEIGHT = 0.02
"""A sample with less confidence was clipped by the sensor."""


@dataclass(frozen=True, slots=True)
class Matching:
    """What may be chosen (interpolations are compared in pipelines/subpixel_study.py)."""

    pairs: tuple[Pair, ...] | None = None
    hypotheses: tuple[float, ...] | None = None
    sigma: float = 1.5
    interpolation: Interpolation = "cubic"
    cost_interpolation: CostInterpolation = "parabola"
    fusion: Fusion = "opposite"
    second_pass: bool = True
    regularise: bool = True
    min_support: float = 0.2
    threads: int = 1


class First(NamedTuple):
    """What the first pass tells.

    Parameters
    ----------
    disparity
        (t, s), lens pitches per view step.
    noise
        Standard deviation of the noise of a sample.
    clear
        Share of the lenses whose blocks have enough texture to stand out of the noise.
    """

    disparity: FloatArray
    noise: float
    clear: float


def match_field(field: MosaicField, options: Matching) -> tuple[FloatArray, FloatArray, ByteArray]:
    """Disparity, std and flags (t, s) of view (0, 0).

    Raises
    ------
    ValueError
        With fewer than 2 × 2 lenses, or without views that make pairs with view (0, 0).
    """
    rows, columns = field.rho.shape[1:]
    if min(rows, columns) < 2:
        raise ValueError(f"a field of {rows} × {columns} lenses: disparity takes at least 2 × 2")
    _, colour, confidence = field.view(0, 0)
    level = without_strangers(field._replace(mosaic=even_noise(field, options.threads)))
    found, told = further_passes(level, first_pass([level], options), options)
    known = np.isfinite(found) & inside(field)
    saturated = (colour != CFA_NONE) & (confidence < CLIPPED_WEIGHT)
    std, flags = error_map(np.where(known, found, np.nan), told, saturated, field, filled=options.regularise)
    return np.where(known, found, np.nan).astype(np.float32), std, flags


def further_passes(level: MosaicField, first: First, options: Matching) -> tuple[FloatArray, Evidence]:
    """Disparity (t, s) from all samples, started from `first`, and what the samples told of it.

    `level` holds samples whose noise is the same at all levels.
    """
    found, noise = first.disparity, first.noise
    if options.second_pass:
        for _ in range(1 if first.clear > MOSTLY_NOISE else 2):
            found = _second_pass(level, found, noise, options)
    return _refined(level, found, noise, options)


def _refined(field: MosaicField, found: FloatArray, noise: float, options: Matching) -> tuple[FloatArray, Evidence]:
    """Disparity below the step of the hypotheses, its jumps in their places, and what the samples told of it."""
    axes = lattice_axes(field.offset)
    telling = field.views(TELLING * field.aperture())
    turns = int(np.clip(round(QUIET / noise), FEWEST, MOST))
    for turn in range(turns):
        last = turn == turns - 1
        views = telling if last else telling[turn % 2 :: 2]
        picture, _ = complete_centre(field, found, _doubt(found, 2), threads=options.threads)
        if options.second_pass and not last:
            field = _levelled(field, telling, picture, found, noise, options)
        told = evidence(field, picture, found, views=views, noise=noise, threads=options.threads)
        if not options.regularise:
            found = told.disparity
            continue
        guide = np.moveaxis(picture, 0, -1)
        doubt = np.minimum(told.own, MOST_DOUBT)
        trust = (told.information / (1 + (doubt / TEXTURELESS) ** 2)).astype(np.float32)
        found = fit_surface(told.disparity, trust, found, guide, axes, stiffness=STIFFNESS,
                            jump=np.hypot(JUMP, doubt), edge=_edge(noise),
                            rounds=BREAKS if turn == 0 else LATER_BREAKS, iterations=STEPS)  # fmt: skip
    if options.second_pass and options.regularise:
        found = choose_sides(found, picture, field, noise, options.threads)
        found = place_edges(found, picture, field.offset, field.row_pitch, contrast=4 * noise)
        found = without_islands(found, told.own > TEXTURELESS)
    return found, told


def inside(field: MosaicField) -> npt.NDArray[np.bool_]:
    """Lenses (t, s) that lie on the sensor: at least a quarter of the views has a sample there."""
    count = (field.cfa != CFA_NONE).sum(axis=(0, 1))
    return np.asarray(count >= max(1, 0.25 * count.max()))


def even_noise(field: MosaicField, threads: int = 1) -> FloatArray:
    """Root of the radiance (v, u, t, s): photon noise is then the same everywhere, and shadows match like lights."""
    root = np.empty_like(field.mosaic)

    def row_of_views(j: int) -> None:
        light = np.maximum(field.mosaic[j], 0) + np.float32(READ_LEVEL)
        root[j] = np.where(field.cfa[j] == CFA_NONE, np.float32(0), np.sqrt(light))

    each(row_of_views, range(len(field.v)), threads)
    return root


def supported_pairs(field: MosaicField, least: float = 0.6) -> list[Pair]:
    """Pairs of view (0, 0) along its row and column that meet their own colour over the range of small shifts.

    The support is measured on the field itself at shifts of 0, ½ and 1 lens; the longest and the half as long are taken
    on each side, and the best ones if too few have enough.
    """
    across = [(int(a), 0) for a in field.u if SHORTEST <= abs(a) <= LONGEST]
    down = [(0, int(b)) for b in field.v if SHORTEST <= abs(b) <= LONGEST]
    if not across + down:
        raise ValueError(
            f"no view {SHORTEST} to {LONGEST} steps from u=0, v=0 in its row or column, where colours meet their own: "
            f"the field has u {field.u.tolist()}, v {field.v.tolist()}"
        )
    support = {pair: pair_support(field, pair) for pair in across + down}
    good = [pair for pair, share in support.items() if share >= least]
    if len(good) >= 2:
        return good
    return sorted(support, key=lambda pair: -support[pair])[:4]


def first_pass(fields: Sequence[MosaicField], options: Matching) -> First:
    """What same-colour pairs tell.

    Several fields of the same lenses and views, one for each colour, are matched together.
    """
    field = fields[0]
    pairs = list(options.pairs) if options.pairs is not None else supported_pairs(field)
    longest = max(max(abs(a), abs(b)) for a, b in pairs)
    within = inside(field)
    reach, costs = FIRST_RANGE, np.empty((len(pairs), 0, *field.rho.shape[1:]), dtype=np.float32)
    while True:
        labels = _labels(options, 0.5 / longest, (-reach, reach))
        more = (len(labels) - costs.shape[1]) // 2
        beyond = np.concatenate([labels[:more], labels[len(labels) - more :]]) if costs.size else labels
        fresh = np.stack(each(partial(_pair_cost, fields, beyond, options), pairs, options.threads))
        costs = np.concatenate([fresh[:, :more], costs, fresh[:, more:]], axis=1) if costs.size else fresh
        fused = fuse_costs(costs, labels, options.fusion)
        differences = fused if options.fusion != "median" else fuse_costs(costs, labels, "opposite")
        clear = is_clear(differences) & within
        best = np.abs(minimum(fused, labels, "none")[0])[clear]
        if options.hypotheses is None and reach < WIDEST_RANGE and _presses(best, reach - 1 / longest):
            reach *= 2
            continue
        found = _decide(fused, labels, None, options, brick=field.brick)
        told = told_range(differences, labels, found, clear=clear, among=within, row_pitch=field.row_pitch)
        if options.hypotheses is None and told is not None:
            found = np.clip(found, *told)
        share = float(clear.sum() / max(within.sum(), 1))
        return First(found, float(np.sqrt(noise_level(differences) / PAIR_NOISE)), share)


def _pair_cost(
    fields: Sequence[MosaicField], labels: npt.NDArray[np.float64], options: Matching, pair: Pair
) -> FloatArray:
    costs = [pair_cost(field, pair, labels, sigma=options.sigma, min_support=options.min_support,
                       interpolation=options.interpolation) for field in fields]  # fmt: skip
    return costs[0] if len(costs) == 1 else np.mean(costs, axis=0, dtype=np.float32)


def _presses(away: FloatArray, border: float) -> bool:
    """Whether disparities of clear places, at `away` from 0, lie at the border of the range."""
    return bool(away.size) and float(np.mean(away > border)) > PRESSED


def _second_pass(field: MosaicField, first: FloatArray, noise: float, options: Matching) -> FloatArray:
    """Disparity at which the outer views agree with a picture that the inner views alone make along `first`."""
    if not np.isfinite(first).any():
        return first
    labels = _labels(options, SECOND_STEP, (float(np.nanmin(first)), float(np.nanmax(first))))
    radius, doubt = field.aperture(), _doubt(first, 3)
    guide, _ = complete_centre(field, first, doubt, threads=options.threads)
    inner, outer = field.views(0, INNER * radius), field.views(OUTER * radius, RIM * radius)
    field = _levelled(field, inner + outer, guide, first, noise, options)
    picture, _ = complete_centre(field, first, doubt, within=INNER * radius, threads=options.threads)
    costs = model_costs(field, picture, labels, views=outer, sigma=SECOND_BLOCK, limit=2.7 * noise, band=_band(first),
                        threads=options.threads)  # fmt: skip
    fused = fuse_costs(costs, labels, options.fusion)
    found = _decide(fused, labels, guide, options, edge=_edge(noise), brick=field.brick)
    return np.where(np.isfinite(found), found, first).astype(np.float32)


def _levelled(
    field: MosaicField, views: Sequence[Pair], picture: FloatArray, disparity: FloatArray, noise: float,
    options: Matching,
) -> MosaicField:  # fmt: skip
    return levelled(field, picture, disparity, views=views, limit=STRANGE * noise, least=UNEVEN * noise,
                    threads=options.threads)  # fmt: skip


def _band(first: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest disparity (t, s) of the surroundings of each place, a little wider."""
    size = 2 * BAND_REACH + 1
    low = minimum_filter(np.where(np.isfinite(first), first, -np.inf), size)
    high = maximum_filter(np.where(np.isfinite(first), first, np.inf), size)
    return (low - BAND).astype(np.float32), (high + BAND).astype(np.float32)


def _labels(options: Matching, step: float, span: tuple[float, float]) -> npt.NDArray[np.float64]:
    if options.hypotheses is not None:
        low, high = min(options.hypotheses), max(options.hypotheses)
        span, step = (low, high), min(step, (high - low) / max(len(options.hypotheses) - 1, 1)) or step
    count = max(int(np.ceil((span[1] - span[0]) / step - 1e-9)), 2)
    return np.asarray(span[0] + step * np.arange(count + 1))


def _decide(
    cost: FloatArray,
    labels: npt.NDArray[np.float64],
    picture: FloatArray | None,
    options: Matching,
    *,
    brick: bool,
    edge: float = 1.0,
) -> FloatArray:
    if not options.regularise:
        return minimum(cost, labels, options.cost_interpolation)[0]
    penalties = dict(zip(("small", "large"), FIRST_PENALTIES if picture is None else SECOND_PENALTIES, strict=True))
    guide = None if picture is None else np.moveaxis(picture, 0, -1)
    return regularise(cost, labels, guide, brick=brick, edge=edge, scale=noise_level(cost), threads=options.threads,
                      **penalties)  # fmt: skip


def _edge(noise: float) -> float:
    """Change of the picture that counts as an edge."""
    return max(EDGE * noise, LEAST_EDGE)


def _doubt(disparity: FloatArray, reach: int) -> FloatArray:
    """How far off a disparity may be where it is used to collect colours: near a step it may be the other side's."""
    return 0.02 + half_range(disparity, reach)
