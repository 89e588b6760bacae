"""Disparity of the central view of a mosaicked field, from its own samples to a map with an error (METHOD 8).

First pass: same-colour pairs of one row or column, where their support allows. Second pass: the central view is
completed in colour along that disparity, and every sample of every view is compared with it. The costs of the sides of
the aperture are fused without the worst, regularised along the picture's edges and refined below the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.kernels.aggregate import fill, regularise
from lfflow.kernels.completion import complete_centre
from lfflow.kernels.error_map import FILLED, LOW_TEXTURE, error_map, half_range
from lfflow.kernels.fusion import Fusion, fuse_costs
from lfflow.kernels.model_cost import model_costs
from lfflow.kernels.mosaic_field import MosaicField
from lfflow.kernels.pair_cost import Interpolation, pair_cost, pair_support
from lfflow.kernels.refine import refine
from lfflow.kernels.subpixel import CostInterpolation, minimum
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]
Pair = tuple[int, int]

FIRST_RANGE = 1.0
WIDEST_RANGE = 4.0
SECOND_STEP = 0.0625
LONGEST = 4
TEXTURED = 0.75
"""The range is judged at the places with more contrast than this share of all."""
PRESSED = 0.05
"""Share of those places that may lie at the border before the range is doubled."""
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
    fusion: Fusion = "trimmed"
    second_pass: bool = True
    regularise: bool = True
    min_support: float = 0.2
    threads: int = 1


def match_field(field: MosaicField, options: Matching) -> tuple[FloatArray, FloatArray, ByteArray]:
    """Disparity, std and flags (t, s) of view (0, 0)."""
    _, colour, confidence = field.view(0, 0)
    level = field._replace(mosaic=even_noise(field))
    found = _first_pass(level, options)
    picture, _ = complete_centre(level, found, _doubt(found, 3))
    if options.second_pass:
        found = _second_pass(level, picture, found, options)
        picture, _ = complete_centre(level, found, _doubt(found, 2))
    better = refine(level, picture, found)
    known = np.isfinite(found) & inside(field)
    std, flags = error_map(better, known, (colour != CFA_NONE) & (confidence < CLIPPED_WEIGHT))
    disparity = np.where(known, better.disparity, np.nan).astype(np.float32)
    if options.regularise:
        doubtful = known & ((flags & LOW_TEXTURE) > 0)
        filled = fill(disparity, std, known & ~doubtful, np.moveaxis(picture, 0, -1), brick=_is_brick(field))
        replaced = doubtful & np.isfinite(filled)
        disparity = np.where(replaced, filled, disparity)
        flags[replaced] |= FILLED
    return disparity, std, flags


def inside(field: MosaicField) -> npt.NDArray[np.bool_]:
    """Lenses (t, s) that lie on the sensor: at least a quarter of the views has a sample there."""
    count = (field.cfa != CFA_NONE).sum(axis=(0, 1))
    return np.asarray(count >= max(1, 0.25 * count.max()))


def even_noise(field: MosaicField) -> FloatArray:
    """Root of the radiance (v, u, t, s): photon noise is then the same everywhere, and shadows match like lights."""
    root = np.sqrt(np.maximum(field.mosaic, 0) + np.float32(READ_LEVEL))
    return np.where(field.cfa == CFA_NONE, 0, root).astype(np.float32)


def supported_pairs(field: MosaicField, least: float = 0.6) -> list[Pair]:
    """Pairs of view (0, 0) along its row and column that meet their own colour over the range of small shifts.

    The support is measured on the field itself at shifts of 0, ½ and 1 lens; the longest and the half as long are taken
    on each side, and the best ones if too few have enough.
    """
    across = [(int(a), 0) for a in field.u if 2 <= abs(a) <= LONGEST]
    down = [(0, int(b)) for b in field.v if 2 <= abs(b) <= LONGEST]
    support = {pair: pair_support(field, pair) for pair in across + down}
    good = [pair for pair, share in support.items() if share >= least]
    if len(good) >= 2:
        return good
    return sorted(support, key=lambda pair: -support[pair])[:4]


def _first_pass(field: MosaicField, options: Matching) -> FloatArray:
    pairs = list(options.pairs) if options.pairs is not None else supported_pairs(field)
    longest = max(max(abs(a), abs(b)) for a, b in pairs)
    reach = FIRST_RANGE
    while True:
        labels = _labels(options, 0.5 / longest, (-reach, reach))
        cost = partial(pair_cost, field, hypotheses=labels, sigma=options.sigma, min_support=options.min_support,
                       interpolation=options.interpolation)  # fmt: skip
        costs = np.stack(each(cost, pairs, options.threads))
        fused = fuse_costs(costs, labels, options.fusion)
        found = _decide(fused, labels, None, options, brick=_is_brick(field))
        if options.hypotheses is not None or reach >= WIDEST_RANGE:
            return found
        if not _presses(fused, found, reach - 1 / longest):
            return found
        reach *= 2


def _presses(cost: FloatArray, found: FloatArray, border: float) -> bool:
    """Whether disparities lie at the border of the range at the places with the most contrast."""
    contrast = np.where(np.isfinite(cost).all(axis=0), cost.mean(axis=0), np.nan)
    if not np.isfinite(contrast).any():
        return False
    clear = (contrast > np.nanquantile(contrast, TEXTURED)) & np.isfinite(found)
    return bool(clear.any()) and float(np.mean(np.abs(found[clear]) > border)) > PRESSED


def _second_pass(field: MosaicField, picture: FloatArray, first: FloatArray, options: Matching) -> FloatArray:
    if not np.isfinite(first).any():
        return first
    low, high = np.nanquantile(first, (0.005, 0.995))
    labels = _labels(options, SECOND_STEP, (low - 0.1, high + 0.1))
    costs = model_costs(field, picture, labels, threads=options.threads)
    found = _decide(fuse_costs(costs, labels, options.fusion), labels, picture, options, brick=_is_brick(field))
    return np.where(np.isfinite(found), found, first).astype(np.float32)


def _labels(options: Matching, step: float, span: tuple[float, float]) -> npt.NDArray[np.float64]:
    if options.hypotheses is not None:
        low, high = min(options.hypotheses), max(options.hypotheses)
        span, step = (low, high), min(step, (high - low) / max(len(options.hypotheses) - 1, 1)) or step
    count = max(int(np.ceil((span[1] - span[0]) / step - 1e-9)), 2)
    return np.asarray(span[0] + step * np.arange(count + 1))


def _decide(
    cost: FloatArray, labels: npt.NDArray[np.float64], picture: FloatArray | None, options: Matching, *, brick: bool
) -> FloatArray:
    if not options.regularise:
        return minimum(cost, labels, options.cost_interpolation)[0]
    guide = None if picture is None else np.moveaxis(picture, 0, -1)
    edge = {"small": 0.15, "large": 1.0} if picture is None else {"small": 0.15, "large": 1.0, "edge": 0.05}
    return regularise(cost, labels, guide, None, brick=brick, **edge)


def _doubt(disparity: FloatArray, reach: int) -> FloatArray:
    """How far off a disparity may be where it is used to collect colours: near a step it may be the other side's."""
    return 0.02 + half_range(disparity, reach)


def _is_brick(field: MosaicField) -> bool:
    return bool(field.offset.max() > 0)
