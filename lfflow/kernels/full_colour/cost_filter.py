"""Guided filter of cost slices: the mean over a neighbourhood on one side of the picture's edges.

At each place the cost is taken for a linear function of the picture (He, Sun & Tang 2013, eq. 5–8; Rhemann et al. 2011
for costs), so that it may jump where the picture does, and no cost crosses the outline of an object.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

_WINDOW = (5, 5)


class CostFilter:
    """Filter for all slices (t, s) of one view.

    Parameters
    ----------
    picture
        (t, s) luminance of the view, 0..1.
    noise
        Variance of the picture that is no edge.
    """

    def __init__(self, picture: FloatArray, noise: float) -> None:
        self._picture = picture
        self._mean = _mean(picture)
        self._spread = _mean(picture * picture) - self._mean * self._mean + np.float32(noise)

    def __call__(self, cost: FloatArray) -> FloatArray:
        """Filtered slice (t, s)."""
        mean = _mean(cost)
        slope = np.asarray((_mean(self._picture * cost) - self._mean * mean) / self._spread, dtype=np.float32)
        level = mean - slope * self._mean
        return _mean(slope) * self._picture + _mean(level)


def _mean(values: FloatArray) -> FloatArray:
    return np.asarray(cv2.blur(values, _WINDOW), dtype=np.float32)
