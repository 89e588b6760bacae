"""Reading a row of places in a view at their disparities, by cubic B-splines (`lfflow.kernels.full_colour.spline`)."""

from __future__ import annotations

import numba
import numpy as np

from lfflow.kernels.full_colour.spline import slopes, weights

_FLAGS = {"nsz", "contract", "reassoc", "arcp"}


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def locate(disparity, places, t, u, v, margin, shape, base, along, change):  # type: ignore[no-untyped-def]
    """Where a view shows places of row t.

    Parameters
    ----------
    disparity, places
        (place,) disparity and column.
    u, v
        Offset of the view.
    margin, shape
        Padding of the view, and its rows and columns with it; what lies beyond is read at its border.
    base
        (place,) filled with the index of the first of 4 × 4 samples.
    along, change
        (2, 4, place) filled with the spline's weights down and right, and with their derivatives.
    """
    bottom, end = np.float32(shape[0] - 3), np.float32(shape[1] - 3)
    for s in range(places.shape[0]):
        y = min(max(np.float32(t + margin) - disparity[s] * v, np.float32(1)), bottom)
        x = min(max(np.float32(places[s] + margin) - disparity[s] * u, np.float32(1)), end)
        top, left = int(y), int(x)
        base[s] = (top - 1) * shape[1] + left - 1
        along[0, 0, s], along[0, 1, s], along[0, 2, s], along[0, 3, s] = weights(y - top)
        along[1, 0, s], along[1, 1, s], along[1, 2, s], along[1, 3, s] = weights(x - left)
        change[0, 0, s], change[0, 1, s], change[0, 2, s], change[0, 3, s] = slopes(y - top)
        change[1, 0, s], change[1, 1, s], change[1, 2, s], change[1, 3, s] = slopes(x - left)


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def read(layer, base, down, right, out):  # type: ignore[no-untyped-def]
    """Spline (place,) of a layer (t, s) with the weights (4, place) of `locate`."""
    samples, width = layer.ravel(), layer.shape[1]
    for s in range(out.shape[0]):
        total = np.float32(0)
        for k in range(4):
            first = base[s] + np.uintp(k * width)
            total += down[k, s] * (
                right[0, s] * samples[first]
                + right[1, s] * samples[first + np.uintp(1)]
                + right[2, s] * samples[first + np.uintp(2)]
                + right[3, s] * samples[first + np.uintp(3)]
            )
        out[s] = total


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def derive(layer, base, along, change, out, by_y, by_x):  # type: ignore[no-untyped-def]
    """Spline (place,) as of `read`, and its derivatives down and right, from the same samples."""
    samples, width = layer.ravel(), layer.shape[1]
    for s in range(out.shape[0]):
        total, down, right = np.float32(0), np.float32(0), np.float32(0)
        for k in range(4):
            first = base[s] + np.uintp(k * width)
            a, b = samples[first], samples[first + np.uintp(1)]
            c, d = samples[first + np.uintp(2)], samples[first + np.uintp(3)]
            row = along[1, 0, s] * a + along[1, 1, s] * b + along[1, 2, s] * c + along[1, 3, s] * d
            total += along[0, k, s] * row
            down += change[0, k, s] * row
            right += along[0, k, s] * (
                change[1, 0, s] * a + change[1, 1, s] * b + change[1, 2, s] * c + change[1, 3, s] * d
            )
        out[s], by_y[s], by_x[s] = total, down, right
