"""Disparity of the central view of a mosaicked field."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lfflow.kernels.fusion import spread, weighted_median
from lfflow.kernels.mosaic_field import MosaicField
from lfflow.kernels.pair_cost import pair_cost
from lfflow.kernels.subpixel import minimum

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]


def match_pairs(
    field: MosaicField, pairs: list[tuple[int, int]], hypotheses: npt.NDArray[np.float64], sigma: float
) -> tuple[FloatArray, FloatArray, ByteArray]:
    """Disparity, std and flags (t, s): median and spread over the pairs of the place of the smallest cost."""
    found = [minimum(pair_cost(field, pair, hypotheses, sigma=sigma), hypotheses)[0] for pair in pairs]
    each = np.stack(found)
    weights = np.isfinite(each).astype(np.float32)
    disparity = weighted_median(each, weights)
    flags = np.where(np.isfinite(disparity), 0, 1).astype(np.uint8)
    return disparity, spread(each, weights, disparity), flags
