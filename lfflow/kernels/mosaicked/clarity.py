"""Where a cost volume tells one disparity from the others, and the range of those that it tells."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from lfflow.kernels.mosaicked.subpixel import minimum

FloatArray = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

CLEAR, WIDE_CLEAR = 4.0, 0.4
"""A cost is clear when its mean exceeds its smallest by this many times the cost of what fits: that of a block, and
that of a wide surrounding, where noise differs less between the hypotheses."""
WIDE = 4.0
"""Gaussian of that surrounding, lens pitches."""
ENOUGH = 0.01
"""Share of the places that must be clear for their disparities to bound those of all."""
MARGIN = 0.15
"""What the range is wider than the clear disparities, lens pitches per view step."""


def noise_level(cost: FloatArray) -> float:
    """What a cost (hypothesis, t, s) is where it fits: the lower quartile over the places of their smallest cost.

    Unlike the contrast of the costs it depends on the noise alone, not on how much texture a picture has.
    """
    least = np.where(np.isfinite(cost), cost, np.inf).min(axis=0)
    least = least[np.isfinite(least)]
    return max(float(np.quantile(least, 0.25)), 1e-6) if least.size else 1e-6


def is_clear(cost: FloatArray) -> BoolArray:
    """Places (t, s) whose block has enough texture for its smallest cost to stand out of the noise."""
    return _stands_out(cost, CLEAR * noise_level(cost))


def told_range(
    cost: FloatArray,
    labels: npt.NDArray[np.floating],
    found: FloatArray,
    *,
    clear: BoolArray,
    among: BoolArray,
    row_pitch: float,
) -> tuple[float, float] | None:
    """Range of the disparities that clear places and clear surroundings have, a little wider; None where hardly any is.

    A faint surface is clear nowhere and yet tells its disparity when the costs of many lenses are put together.

    Parameters
    ----------
    cost
        (hypothesis, t, s) at the disparities `labels`.
    found
        Disparity (t, s) that was chosen.
    clear, among
        Places (t, s) that `is_clear` tells, and those that count.
    row_pitch
        Distance of the rows, lens pitches.
    """
    wide = _surrounding(cost, row_pitch)
    ranges = []
    for sure, values in (
        (clear, found),
        (_stands_out(wide, WIDE_CLEAR * noise_level(cost)), minimum(wide, labels, "none")[0]),
    ):
        told = values[sure & among]
        if told.size > ENOUGH * among.sum():
            ranges.append(np.quantile(told, (0.01, 0.99)))
    if not ranges:
        return None
    low, high = np.transpose(ranges)
    return float(low.min()) - MARGIN, float(high.max()) + MARGIN


def _stands_out(cost: FloatArray, least_contrast: float) -> BoolArray:
    known = np.isfinite(cost)
    mean = np.where(known, cost, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    least = np.where(known, cost, np.inf).min(axis=0)
    return np.asarray((mean > least + least_contrast) & known.any(axis=0))


def _surrounding(cost: FloatArray, row_pitch: float) -> FloatArray:
    """Mean cost (hypothesis, t, s) over a wide surrounding of each place; NaN where most of it is undefined."""
    out = np.empty_like(cost)
    for at, one in zip(out, cost, strict=True):
        known = np.isfinite(one)
        total, share = (
            cv2.GaussianBlur(part.astype(np.float32), (0, 0), WIDE, sigmaY=WIDE / row_pitch)
            for part in (np.where(known, one, 0), known)
        )
        at[:] = np.where(share > 0.5, total / np.maximum(share, 0.5), np.nan)
    return out
