"""Cubic B-spline weights: they smooth a little, and nearly as much at whatever fraction.

Interpolation with Keys' kernel leaves all of the noise at whole shifts and 64 % of it at halves, so that weak texture
drifts towards disparities whose shifts are fractions. The B-spline leaves 50 % and 46 %.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

_WHOLE = np.array([1 / 6, 2 / 3, 1 / 6], dtype=np.float32)


@numba.njit(nogil=True, cache=True)
def weights(fraction):  # type: ignore[no-untyped-def]
    """Weights of the four samples around a position between the middle two."""
    f = np.float32(fraction)
    g = np.float32(1) - f
    sixth, two_thirds, half = np.float32(1 / 6), np.float32(2 / 3), np.float32(0.5)
    return (
        sixth * g * g * g,
        two_thirds - f * f * (np.float32(1) - half * f),
        two_thirds - g * g * (np.float32(1) - half * g),
        sixth * f * f * f,
    )


@numba.njit(nogil=True, cache=True)
def slopes(fraction):  # type: ignore[no-untyped-def]
    """Derivatives of `weights`."""
    f = np.float32(fraction)
    g = np.float32(1) - f
    half, two, more = np.float32(0.5), np.float32(2), np.float32(1.5)
    return -half * g * g, -f * (two - more * f), g * (two - more * g), half * f * f


def smoothed(layers: FloatArray) -> FloatArray:
    """Layers (layer, t, s) as the spline shows them at whole positions."""
    return np.stack([cv2.sepFilter2D(layer, -1, _WHOLE, _WHOLE) for layer in layers]).astype(np.float32)
