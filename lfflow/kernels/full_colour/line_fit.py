"""Gauss–Newton step of the disparity at which all views agree along their lines; views that disagree are left out.

The residual of a view is its difference to the mean of all (which has less noise than the central view), its derivative
−(u ∂x + v ∂y) of the mean as well: a view's own derivatives would add the square of their noise to the curvature, and
every step would fall short. The sums over views and layers give at each place the curvature A and the slope B of half
the squared residual, so that d + B/A minimises it, and A / noise is the information (1/variance) about d.
"""

from __future__ import annotations

import numba
import numpy as np

from lfflow.kernels.full_colour.reading import derive, locate, read

_FLAGS = {"nsz", "contract", "reassoc", "arcp"}
_NOTHING = np.float32(1e-9)
"""Sum of the weights where there are none."""


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _add(values, share, out):  # type: ignore[no-untyped-def]
    for s in range(out.shape[0]):
        out[s] += share[s] * values[s]


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _gather(views, chosen, there, disparity, t, u, v, graded, margin, value, by_y, by_x):  # type: ignore[no-untyped-def]
    """Values (view, layer, s) of a row of places, and the derivatives (layer, s) of their mean."""
    layers, shape = views.shape[1], views.shape[2:]
    columns = disparity.shape[1]
    places, base = np.arange(columns), np.empty(columns, dtype=np.uintp)
    along, change = np.empty((2, 4, columns), dtype=np.float32), np.empty((2, 4, columns), dtype=np.float32)
    down, right = np.empty(columns, dtype=np.float32), np.empty(columns, dtype=np.float32)
    number = np.full(columns, _NOTHING, dtype=np.float32)
    by_y[:], by_x[:] = 0, 0
    for q in range(chosen.shape[0]):
        view = views[chosen[q]]
        locate(disparity[t], places, t, u[q], v[q], margin, shape, base, along, change)
        for c in range(layers):
            if graded[q]:
                derive(view[c], base, along, change, value[q, c], down, right)
                _add(down, there[q], by_y[c])
                _add(right, there[q], by_x[c])
            else:
                read(view[c], base, along[0], along[1], value[q, c])
        if graded[q]:
            number += there[q]
    by_y /= number
    by_x /= number


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _average(value, weight, mean, total):  # type: ignore[no-untyped-def]
    """Weighted mean (layer, s) of the views, and the sum of their weights (s,)."""
    total[:], mean[:] = _NOTHING, 0
    for q in range(value.shape[0]):
        total += weight[q]
        for c in range(value.shape[1]):
            _add(value[q, c], weight[q], mean[c])
    mean /= total


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _trust(value, there, mean, tolerance, apart, weight):  # type: ignore[no-untyped-def]
    """Weights (view, s) by the distance to the mean."""
    views, layers, columns = value.shape
    for q in range(views):
        apart[:] = 0
        for c in range(layers):
            for s in range(columns):
                apart[s] += (value[q, c, s] - mean[c, s]) ** 2
        for s in range(columns):
            trust = tolerance / (tolerance + apart[s])
            weight[q, s] = there[q, s] * trust * trust


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _sums(value, by_y, by_x, u, v, weight, total, mean, out):  # type: ignore[no-untyped-def]
    """Curvature, slope and mean squared residual (3, s) of the layers (view, layer, s)."""
    views, layers, columns = value.shape
    out[:] = 0
    middle_u, middle_v = np.zeros(columns, dtype=np.float32), np.zeros(columns, dtype=np.float32)
    for q in range(views):
        for s in range(columns):
            middle_u[s] += weight[q, s] * u[q]
            middle_v[s] += weight[q, s] * v[q]
    middle_u /= total
    middle_v /= total
    for c in range(layers):
        for q in range(views):
            for s in range(columns):
                residual = value[q, c, s] - mean[c, s]
                way = (middle_u[s] - u[q]) * by_x[c, s] + (middle_v[s] - v[q]) * by_y[c, s]
                out[0, s] += weight[q, s] * way * way
                out[1, s] -= weight[q, s] * way * residual
                out[2, s] += weight[q, s] * residual * residual
    out[2] /= total


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def normal_equations(views, chosen, seen, disparity, u, v, graded, rows, margin, tolerance, out):  # type: ignore[no-untyped-def]
    """Fill `out` (3, t, s) with curvature, slope and mean squared residual for the rows first..last − 1.

    Parameters
    ----------
    views
        (view, layer, t, s) padded by `margin`.
    chosen
        (q,) indices of the views to use, the central one among them.
    seen
        (q, t, s) bool.
    disparity
        (t, s); places that a shift moves out of the padding are read at its border.
    u, v
        (q,) float32 offsets.
    graded
        (q,) bool, whether a view counts for the derivatives of the mean; the central one should.
    rows
        (first, last).
    tolerance
        Squared residual, summed over the layers, at which a view counts a quarter.
    """
    count, layers = chosen.shape[0], views.shape[1]
    columns = disparity.shape[1]
    value = np.empty((count, layers, columns), dtype=np.float32)
    weight, there = np.empty((count, columns), dtype=np.float32), np.empty((count, columns), dtype=np.float32)
    mean, by_y = np.empty((layers, columns), dtype=np.float32), np.empty((layers, columns), dtype=np.float32)
    by_x, total, apart = np.empty_like(mean), np.empty(columns, dtype=np.float32), np.empty(columns, dtype=np.float32)
    for t in range(rows[0], rows[1]):
        there[:] = seen[:, t]
        _gather(views, chosen, there, disparity, t, u, v, graded, margin, value, by_y, by_x)
        weight[:] = there
        for _ in range(2):
            _average(value, weight, mean, total)
            _trust(value, there, mean, tolerance, apart, weight)
        _average(value, weight, mean, total)
        _sums(value, by_y, by_x, u, v, weight, total, mean, out[:, t])
