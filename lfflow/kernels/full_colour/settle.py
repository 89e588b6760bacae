"""Edges of depth moved to the edges of the picture: a place near a jump takes the side that its colour belongs to.

The side is the weighted median of the disparities around, with weights that fall with distance and difference of colour
(Ma et al. 2013); places that stay on their side keep their own value.
"""

from __future__ import annotations

import math

import cv2
import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.threads import bands, each
from lfflow.kernels.weighted_median import weighted_median

FloatArray = npt.NDArray[np.float32]

_REACH = 7
_COLOUR = 0.02
_JUMP = 0.25
_CHANGE = np.float32(0.15)
_NOTHING = 7.0
"""Exponent from which on a weight does not count."""


def settle_edges(disparity: FloatArray, guide: FloatArray, rounds: int, threads: int = 1) -> FloatArray:
    """Disparity (t, s) whose jumps follow the guide.

    Parameters
    ----------
    guide
        (t, s, channel) picture of the same view, 0..1.
    """
    found = np.asarray(disparity, dtype=np.float32)
    picture = np.ascontiguousarray(guide, dtype=np.float32)
    for _ in range(rounds):
        found = _settled(found, picture, threads)
    return found


def _settled(disparity: FloatArray, guide: FloatArray, threads: int) -> FloatArray:
    """One round."""
    window = np.ones((2 * _REACH + 1, 2 * _REACH + 1), dtype=np.uint8)
    span = cv2.dilate(disparity, window[:3, :3]) - cv2.erode(disparity, window[:3, :3])
    near = cv2.dilate((span > _JUMP).astype(np.uint8), window).astype(np.bool_)
    out = disparity.copy()

    def band(rows: tuple[int, int]) -> None:
        _settle(disparity, guide, near, rows, out)

    each(band, bands(len(disparity)), threads)
    return out


@numba.njit(nogil=True, cache=True)
def _settle(disparity, guide, near, span, out):  # type: ignore[no-untyped-def]
    """Write the places of the rows first..last − 1 that change sides."""
    rows, columns, channels = guide.shape
    side = 2 * _REACH + 1
    value, weight = np.empty(side * side, dtype=np.float32), np.empty(side * side, dtype=np.float32)
    for t in range(span[0], span[1]):
        for s in range(columns):
            if not near[t, s]:
                continue
            count = 0
            for a in range(max(t - _REACH, 0), min(t + _REACH + 1, rows)):
                for b in range(max(s - _REACH, 0), min(s + _REACH + 1, columns)):
                    apart = np.float32(0)
                    for c in range(channels):
                        apart += (guide[a, b, c] - guide[t, s, c]) ** 2
                    away = ((a - t) ** 2 + (b - s) ** 2) / (_REACH / 1.5) ** 2
                    exponent = (apart / _COLOUR**2 + away) / 2
                    if exponent < _NOTHING:
                        value[count] = disparity[a, b]
                        weight[count] = math.exp(-exponent)
                        count += 1
            if _elsewhere(value[:count], weight[:count], disparity[t, s]):
                out[t, s] = weighted_median(value[:count], weight[:count])


@numba.njit(nogil=True, cache=True)
def _elsewhere(value, weight, own):  # type: ignore[no-untyped-def]
    """Whether the weighted median is another than about its own value."""
    below, above, total = 0.0, 0.0, 0.0
    for k in range(value.shape[0]):
        total += weight[k]
        if value[k] < own - _CHANGE:
            below += weight[k]
        elif value[k] > own + _CHANGE:
            above += weight[k]
    return max(below, above) > total / 2
