"""How far a disparity may be off, and why it is not to be trusted (METHOD 8.3)."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, minimum_filter

from lfflow.kernels.refine import Refined

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]

NO_DATA: Final = 1
LOW_TEXTURE: Final = 2
SATURATED: Final = 4
OCCLUDED: Final = 8
FILLED: Final = 16

MODEL_ERROR = 0.003
"""What stays without noise: interpolation between lenses and the slope of surfaces inside a block (simulated F01)."""
NOISE_FACTOR = 1.6
"""Measured over predicted error: neighbours share the completed picture, so their residuals are not independent."""
STEP_SHARE = 0.12
"""Error per difference of the disparities within two lenses."""
STEP = 0.08
"""Half the difference of the disparities within two lenses beyond which a place may belong to either side."""
TEXTURELESS = 0.05
"""Predicted std, from what has the lens's own colour, beyond which the picture does not tell its disparity."""


def half_range(disparity: FloatArray, reach: int = 2) -> FloatArray:
    """Half the difference of the largest and smallest disparity within `reach` lenses (t, s)."""
    known = np.isfinite(disparity)
    if not known.any():
        return np.zeros_like(disparity)
    high = maximum_filter(np.where(known, disparity, -np.inf), 2 * reach + 1)
    low = minimum_filter(np.where(known, disparity, np.inf), 2 * reach + 1)
    with np.errstate(invalid="ignore"):
        return np.where(known, (high - low) / 2, 0).astype(np.float32)


def error_map(better: Refined, known: npt.NDArray[np.bool_], saturated: npt.NDArray[np.bool_]
              ) -> tuple[FloatArray, ByteArray]:  # fmt: skip
    """Standard deviation and flags (t, s) of a refined disparity.

    The std joins the closed formula of the noise, a floor for what noise does not explain, and the step of the
    disparity nearby: there the block and the completed picture mix two surfaces, so the place is flagged occluded where
    the step is large. It is calibrated on simulated F01 captures.
    """
    step = half_range(np.where(known, better.disparity, np.nan).astype(np.float32))
    parts = MODEL_ERROR**2 + (NOISE_FACTOR * better.predicted) ** 2 + (STEP_SHARE * step) ** 2
    std = np.where(known, np.sqrt(parts), np.nan).astype(np.float32)
    flags = np.where(known, 0, NO_DATA).astype(np.uint8)
    flags[known & (better.own > TEXTURELESS)] |= LOW_TEXTURE
    flags[known & (step > STEP)] |= OCCLUDED
    flags[saturated] |= SATURATED
    return std, flags
