"""Islands of a few lenses, which are errors far more often than things: they take the disparity of what is around."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

UNIT = 0.001
"""Disparities are told apart in this unit."""
NONE = -32000


def without_islands(disparity: FloatArray, *, size: int = 12, step: float = 0.1, rounds: int = 2) -> FloatArray:
    """Disparity (t, s), NaN where unknown, whose islands of at most `size` lenses are gone.

    Parameters
    ----------
    step
        Difference of neighbours, lens pitches per view step, that separates an island from what is around.
    rounds
        How often an island takes the median of five by five lenses: what is left of a larger one goes from its border.
    """
    known = np.isfinite(disparity)
    whole = np.where(known, disparity, 0)
    labels = np.where(known, np.rint(whole / UNIT), NONE).astype(np.int16)
    cv2.filterSpeckles(labels, NONE, size, round(step / UNIT))
    island = known & (labels == NONE)
    for _ in range(rounds):
        whole = np.where(island, cv2.medianBlur(whole.astype(np.float32), 5), whole)
    return np.where(known, whole, np.nan).astype(np.float32)
