"""How far a disparity may be off, and why it is not to be trusted (METHOD 8.3)."""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, minimum_filter

from lfflow.kernels.mosaicked.block import block_sum, block_weights
from lfflow.kernels.mosaicked.mosaic_field import MosaicField
from lfflow.kernels.mosaicked.refine import AROUND, Evidence
from lfflow.kernels.surface import lattice_axes

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]

NO_DATA: Final = 1
LOW_TEXTURE: Final = 2
SATURATED: Final = 4
OCCLUDED: Final = 8
FILLED: Final = 16

FLOOR = 0.00072
"""What stays without noise where all samples carry the information, lens pitches per view step: the picture is read
between its lenses, and what it is wrong by averages out over the samples that do."""
SCATTER = 1.15
"""Std of the surface in units of what the evidence around a place leaves, times how the evidence scatters about it."""
BEND = 0.0008
"""Bend of the surface, within a lens, that doubles the std: where it follows single places, less of them decide."""
OF_BLOCK = 0.5
"""Std of a place that is not held by its surroundings, in units of what the closed formula says of its block."""
STRAY = 5.0
"""Most that one place adds to the scatter, in units of its own std."""
OWN_SHARE = 0.2
"""Share of what a place without texture knows by itself."""
STEP = 0.08
"""Half the difference of the disparities within two lenses beyond which a place may belong to either side."""
TEXTURELESS = 0.05
"""Std, from what has the lens's own colour, beyond which the picture does not tell its disparity."""
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

    The std is what the closed formula leaves of the evidence around a place, times how much more than that formula says
    the evidence scatters about the surface, times a factor that grows where the surface bends: there fewer places hold
    it, and what bends without need follows errors. It is no less than a floor, which is higher where few of the samples
    carry the information. At the border, where the surface is held and the views are seen from one side only, it is
    divided by the square of the share of the surroundings that there is. The constants are calibrated on simulated
    captures of both cameras and of several sensitivities. Beside a step it is no more than half of the step, and the
    place is flagged occluded: it belongs to either side. Without texture, part of what the place knows by itself is
    added: what fills it may be another surface's. What is not `filled` from around has the std of its own block.
    """
    known = np.isfinite(disparity)
    step = half_range(disparity)
    beside = step > STEP
    if filled:
        std = _of_surface(disparity, told, field)
        std[beside] = np.minimum(std, step)[beside]
    else:
        std = np.hypot(FLOOR / np.sqrt(told.carriers), OF_BLOCK / np.sqrt(told.information + LEAST_KNOWN**-2))
        std[beside] = np.maximum(std, step)[beside]
    plain = told.own > TEXTURELESS
    std[plain] = np.hypot(std, OWN_SHARE * told.own)[plain]
    std = np.minimum(std, LEAST_KNOWN)
    flags = np.where(known, 0, NO_DATA).astype(np.uint8)
    flags[known & plain] |= LOW_TEXTURE | (FILLED if filled else 0)
    flags[known & beside] |= OCCLUDED
    flags[saturated] |= SATURATED
    return np.where(known, std, np.nan).astype(np.float32), flags


def _of_surface(disparity: FloatArray, told: Evidence, field: MosaicField) -> FloatArray:
    """Std (t, s) of a surface through the evidence of all places around."""
    known = np.isfinite(disparity)
    weights = block_weights(AROUND, field.row_pitch, brick=field.brick)
    around, share = (
        block_sum(one.astype(np.float32), field.offset, *weights) for one in (told.information * known, known)
    )
    lenses = 4 * np.pi * AROUND**2 / field.row_pitch
    formula = 1 / np.sqrt(lenses * around + LEAST_KNOWN**-2)
    away = told.information * np.where(known, told.disparity - disparity, 0) ** 2
    scatter = block_sum(np.minimum(away, STRAY**2).astype(np.float32), field.offset, *weights)
    scatter = np.sqrt(scatter / np.maximum(share, 1e-6))
    bend = maximum_filter(_bend(np.where(known, disparity, np.nan), lattice_axes(field.offset)), 3)
    floor = FLOOR / np.sqrt(told.carriers)
    std: FloatArray = np.hypot(floor, SCATTER * scatter * formula * (1 + bend / BEND)) / np.maximum(share, 0.1) ** 2
    return std


@numba.njit(nogil=True, cache=True)
def _bend(disparity, axes):  # type: ignore[no-untyped-def]
    """Largest second difference (t, s) along the rows of lenses; 0 at the border and beside unknown places."""
    rows, columns = disparity.shape
    out = np.zeros((rows, columns), dtype=np.float32)
    for t in range(1, rows - 1):
        for axis in range(axes.shape[1]):
            t0, s0, t1, s1 = axes[t, axis]
            for s in range(1, columns - 1):
                bend = abs(disparity[t + t0, s + s0] - 2 * disparity[t, s] + disparity[t + t1, s + s1])
                if bend > out[t, s]:
                    out[t, s] = bend
    return out
