"""Islands of a few lenses, which are errors far more often than things: they take the disparity of what is around."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

FloatArray = npt.NDArray[np.float32]

UNIT = 0.001
"""Disparities are told apart in this unit."""
NONE = -32000


def without_islands(
    disparity: FloatArray,
    plain: npt.NDArray[np.bool_],
    *,
    size: int = 12,
    plain_size: int = 60,
    step: float = 0.1,
) -> FloatArray:
    """Disparity (t, s), NaN where unknown, whose islands have what lies next to them, most of five by five lenses.

    Parameters
    ----------
    plain
        (t, s) lenses without texture of their own: what they hold against their surroundings is worth little.
    size, plain_size
        Lenses of the largest island of any kind, and of one of which the plain lenses go.
    step
        Difference of neighbours, lens pitches per view step, that separates an island from what is around.
    """
    known = np.isfinite(disparity)
    whole = np.where(known, disparity, 0)
    island = _islands(whole, known, size, step) | (_islands(whole, known, plain_size, step) & plain)
    if not island.any() or island.all():
        return disparity
    nearest = distance_transform_edt(island | ~known, return_distances=False, return_indices=True)
    filled = whole[tuple(nearest)].astype(np.float32)
    return np.where(island, cv2.medianBlur(filled, 5), disparity).astype(np.float32)


def _islands(disparity: FloatArray, known: npt.NDArray[np.bool_], size: int, step: float) -> npt.NDArray[np.bool_]:
    labels = np.where(known, np.rint(np.clip(disparity / UNIT, NONE + 1, -NONE)), NONE).astype(np.int16)
    cv2.filterSpeckles(labels, NONE, size, round(step / UNIT))
    return np.asarray(known & (labels == NONE))
