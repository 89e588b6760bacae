"""Gauss–Newton step of the disparity at which all views agree along their lines; views that disagree are left out.

The residual of a view is its difference to the mean of all (which has less noise than the central view), its derivative
−(u ∂x + v ∂y) of the mean as well: a view's own derivatives would add the square of their noise to the curvature, and
every step would fall short. The sums over views and layers give at each place the curvature A and the slope B of half
the squared residual, so that d + B/A minimises it, and A / noise is the information (1/variance) about d.
"""

from __future__ import annotations

import numba
import numpy as np

from lfflow.kernels.full_colour.spline import slopes, weights

_FLAGS = {"nsz", "contract", "reassoc", "arcp"}


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _read(layers, y, x, value, by_y, by_x):  # type: ignore[no-untyped-def]
    """Value of each layer (t, s, layer) at (y, x), and its derivatives."""
    top, left = int(np.floor(y)), int(np.floor(x))
    a, b = weights(y - top), weights(x - left)
    da, db = slopes(y - top), slopes(x - left)
    for c in range(layers.shape[2]):
        total, down, right = np.float32(0), np.float32(0), np.float32(0)
        for k in range(4):
            row = layers[top - 1 + k]
            p, q, r, z = row[left - 1, c], row[left, c], row[left + 1, c], row[left + 2, c]
            along = b[0] * p + b[1] * q + b[2] * r + b[3] * z
            total += a[k] * along
            down += da[k] * along
            right += a[k] * (db[0] * p + db[1] * q + db[2] * r + db[3] * z)
        value[c], by_y[c], by_x[c] = total, down, right


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _agree(value, weight, mean, count, tolerance):  # type: ignore[no-untyped-def]
    """Weights of the views by their distance to the mean, which follows them; returns their sum."""
    total = np.float32(0)
    for q in range(count):
        apart = np.float32(0)
        for c in range(mean.shape[0]):
            apart += (value[q, c] - mean[c]) ** 2
        trust = np.float32(1) / (np.float32(1) + apart / tolerance)
        weight[q] = trust * trust
        total += weight[q]
    mean[:] = 0
    for q in range(count):
        for c in range(mean.shape[0]):
            mean[c] += weight[q] * value[q, c] / total
    return total


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _sums(value, by_y, by_x, u, v, weight, count, tolerance):  # type: ignore[no-untyped-def]
    """Curvature, slope and mean squared residual of `count` views (view, layer), those that disagree left out."""
    layers = value.shape[1]
    mean = np.zeros(layers, dtype=np.float32)
    for q in range(count):
        for c in range(layers):
            mean[c] += value[q, c] / np.float32(count)
    total = np.float32(0)
    for _ in range(2):
        total = _agree(value, weight, mean, count, tolerance)
    middle_u, middle_v = np.float32(0), np.float32(0)
    for q in range(count):
        middle_u += weight[q] * u[q] / total
        middle_v += weight[q] * v[q] / total
    curvature, slope, square = np.float32(0), np.float32(0), np.float32(0)
    for c in range(layers):
        down, right = np.float32(0), np.float32(0)
        for q in range(count):
            down += weight[q] * by_y[q, c] / total
            right += weight[q] * by_x[q, c] / total
        for q in range(count):
            residual = value[q, c] - mean[c]
            way = -(u[q] - middle_u) * right - (v[q] - middle_v) * down
            curvature += weight[q] * way * way
            slope -= weight[q] * way * residual
            square += weight[q] * residual * residual
    return curvature, slope, square / total


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def normal_equations(views, seen, disparity, u, v, rows, margin, tolerance, out):  # type: ignore[no-untyped-def]
    """Fill `out` (3, t, s) with curvature, slope and mean squared residual for the rows first..last − 1.

    Parameters
    ----------
    views
        (view, t, s, layer) padded by `margin`, the central view among them.
    seen
        (view, t, s) bool.
    disparity
        (t, s); places that a shift moves out of the padding are read at its border.
    u, v
        (view,) float32 offsets.
    rows
        (first, last).
    tolerance
        Squared residual, summed over the layers, at which a view counts a quarter.
    """
    count, layers = views.shape[0], views.shape[3]
    height, width = disparity.shape
    value = np.empty((count, layers), dtype=np.float32)
    by_y, by_x = np.empty_like(value), np.empty_like(value)
    weight, its_u, its_v = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    lowest, bottom, right = np.float32(1), np.float32(height + 2 * margin - 3), np.float32(width + 2 * margin - 3)
    for t in range(rows[0], rows[1]):
        for s in range(width):
            d = disparity[t, s]
            used = 0
            for q in range(count):
                if seen[q, t, s]:
                    y = min(max(np.float32(t + margin) - d * v[q], lowest), bottom)
                    x = min(max(np.float32(s + margin) - d * u[q], lowest), right)
                    _read(views[q], y, x, value[used], by_y[used], by_x[used])
                    its_u[used], its_v[used] = u[q], v[q]
                    used += 1
            out[:, t, s] = (0, 0, 0)
            if used > 1:
                out[:, t, s] = _sums(value, by_y, by_x, its_u, its_v, weight, used, tolerance)
