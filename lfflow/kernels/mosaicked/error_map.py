"""How far a disparity may be off, and why it is not to be trusted (METHOD 8.3)."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, minimum_filter

from lfflow.kernels.mosaicked.block import block_sum, block_weights
from lfflow.kernels.mosaicked.mosaic_field import MosaicField
from lfflow.kernels.mosaicked.refine import Evidence

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]

NO_DATA: Final = 1
LOW_TEXTURE: Final = 2
SATURATED: Final = 4
OCCLUDED: Final = 8
FILLED: Final = 16

MODEL_ERROR = 0.0035
"""What stays without noise, as planes show it: the picture is read between its lenses (simulated F01 and Illum)."""
NOISE_FACTOR = 0.6
"""Measured over predicted error of the evidence within `AROUND`: the surface collects it from farther away."""
APART_SHARE = 0.25
"""Share, in the variance, of the scatter of the evidence about the surface."""
STEP_SHARE = 0.12
"""Error per difference of the disparities within two lenses."""
STEP = 0.08
"""Half the difference of the disparities within two lenses beyond which a place may belong to either side."""
TEXTURELESS = 0.05
"""Std, from what has the lens's own colour, beyond which the picture does not tell its disparity."""
AROUND = 2.0
"""Gaussian, lens pitches, over which the evidence for a surface is collected."""
LEAST_KNOWN = 0.3
"""Largest standard deviation that is stated, lens pitches per view step."""


def half_range(disparity: FloatArray, reach: int = 2) -> FloatArray:
    """Half the difference of the largest and smallest disparity within `reach` lenses (t, s)."""
    known = np.isfinite(disparity)
    if not known.any():
        return np.zeros_like(disparity)
    high = maximum_filter(np.where(known, disparity, -np.inf), 2 * reach + 1)
    low = minimum_filter(np.where(known, disparity, np.inf), 2 * reach + 1)
    with np.errstate(invalid="ignore"):
        return np.where(known, (high - low) / 2, 0).astype(np.float32)


def error_map(
    disparity: FloatArray,
    told: Evidence,
    saturated: npt.NDArray[np.bool_],
    field: MosaicField,
    *,
    filled: bool,
) -> tuple[FloatArray, ByteArray]:
    """Standard deviation and flags (t, s) of a disparity (t, s), NaN where there is none.

    The std joins the variance that the evidence around a place leaves, how far that evidence lies from the disparity,
    a floor for what noise does not explain, and the step of the disparity nearby: there the block and the completed
    picture mix two surfaces, so the place is flagged occluded where the step is large. Without texture it is what the
    place knows by itself: what fills it may be another surface's. It is calibrated on simulated F01 captures. What is
    `filled` where there is no texture is flagged so.
    """
    known = np.isfinite(disparity)
    step = half_range(disparity)
    weights = block_weights(AROUND, field.row_pitch, brick=bool(field.offset.max() > 0))
    around = block_sum(told.information, field.offset, *weights)
    off = np.where(known, told.disparity - disparity, 0).astype(np.float32) ** 2
    apart = block_sum(told.information * off, field.offset, *weights) / np.maximum(around, 1e-9)
    lenses = 4 * np.pi * AROUND**2 * 2 / np.sqrt(3)
    variance = 1 / (lenses * around + LEAST_KNOWN**-2)
    std = np.sqrt(MODEL_ERROR**2 + NOISE_FACTOR**2 * variance + APART_SHARE * apart + (STEP_SHARE * step) ** 2)
    plain = told.own > TEXTURELESS
    std[plain] = np.maximum(std, np.minimum(told.own, LEAST_KNOWN))[plain]
    flags = np.where(known, 0, NO_DATA).astype(np.uint8)
    flags[known & plain] |= LOW_TEXTURE | (FILLED if filled else 0)
    flags[known & (step > STEP)] |= OCCLUDED
    flags[saturated] |= SATURATED
    return np.where(known, std, np.nan).astype(np.float32), flags
