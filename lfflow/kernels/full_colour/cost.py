"""Cost volume of the central view against full-colour views around it: the share of views that show something else.

The squared difference of a view to the central one is bounded before the views are put together, so that a view where
something hides the place costs no more than one, however much it differs; behind a grid there are such views in every
direction. Half of the cost asks all views about the place alone, for the sake of thin things; the other half asks about
3 × 3 places at once, which tell hypotheses apart where one place cannot, over the half plane of views that agrees best:
what hides such a patch mostly hides it on one side.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.full_colour.spline import weights

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

_FLAGS = {"nsz", "contract", "reassoc", "arcp"}


def padded(views: FloatArray, margin: int) -> FloatArray:
    """Views (view, layer, t, s) with their borders repeated by `margin`."""
    return np.ascontiguousarray(np.pad(views, ((0, 0), (0, 0), (margin, margin), (margin, margin)), mode="edge"))


def sectors(u: IntArray, v: IntArray) -> IntArray:
    """Sector 0..7 (by 45°, sector 0 around +u) of each view offset."""
    return np.round(np.arctan2(v, u) / (np.pi / 4)).astype(np.int64) % 8


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _sample(plane, top, left, fy, fx, blend, out):  # type: ignore[no-untyped-def]
    """Row of a plane at a fractional position; (top, left) is the second of the four cubic samples."""
    columns = out.shape[0]
    a, b, c, d = weights(fy)
    r0 = plane[top - 1, left - 1 : left + columns + 2]
    r1 = plane[top, left - 1 : left + columns + 2]
    r2 = plane[top + 1, left - 1 : left + columns + 2]
    r3 = plane[top + 2, left - 1 : left + columns + 2]
    for s in range(columns + 3):
        blend[s] = a * r0[s] + b * r1[s] + c * r2[s] + d * r3[s]
    a, b, c, d = weights(fx)
    b0 = blend[0:columns]
    b1 = blend[1 : columns + 1]
    b2 = blend[2 : columns + 2]
    b3 = blend[3 : columns + 3]
    for s in range(columns):
        out[s] = a * b0[s] + b * b1[s] + c * b2[s] + d * b3[s]


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _differ(view, t, shift_y, shift_x, margin, centre, blend, sample, out):  # type: ignore[no-untyped-def]
    """Squared difference (s,) of row t of a shifted view to the centre, summed over the layers."""
    x, y = shift_x, t + shift_y
    left, top = int(np.floor(x)), int(np.floor(y))
    out[:] = 0
    for c in range(centre.shape[0]):
        _sample(view[c], top + margin, left + margin, y - top, x - left, blend, sample)
        reference = centre[c, t]
        for s in range(out.shape[0]):
            apart = sample[s] - reference[s]
            out[s] += apart * apart


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _add_bounded(square, tolerance, out):  # type: ignore[no-untyped-def]
    for s in range(out.shape[0]):
        out[s] += square[s] / (square[s] + tolerance)


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _patch(above, here, below, column, out):  # type: ignore[no-untyped-def]
    """Mean of 3 × 3 entries about each of a row; `column` has one entry more on both sides."""
    count = out.shape[0]
    for s in range(count):
        column[s + 1] = above[s] + here[s] + below[s]
    column[0], column[count + 1] = column[1], column[count]
    for s in range(count):
        out[s] = (column[s] + column[s + 1] + column[s + 2]) * np.float32(1 / 9)


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _best_half(sums, share, out):  # type: ignore[no-untyped-def]
    """Smallest mean over the eight half planes of four neighbouring sectors."""
    out[:] = np.float32(1e30)
    for k in range(8):
        k1, k2, k3 = (k + 1) % 8, (k + 2) % 8, (k + 3) % 8
        views = share[k] + share[k1] + share[k2] + share[k3]
        if views > 0:
            inverse = np.float32(1) / views
            for s in range(out.shape[0]):
                out[s] = min(out[s], (sums[k, s] + sums[k1, s] + sums[k2, s] + sums[k3, s]) * inverse)


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def disagreement(views, centre, u, v, sector, margin, hypotheses, rows, tolerance, out):  # type: ignore[no-untyped-def]
    """Fill `out` (hypothesis, t, s) with the cost, 0..1, for the rows first..last − 1.

    Parameters
    ----------
    views
        (view, layer, t, s) padded by `margin` > max |d·u| + 2.
    centre
        (layer, t, s), not padded, smoothed by the same spline.
    u, v, sector
        (view,) offsets and sectors.
    hypotheses
        (hypothesis,) disparities.
    rows
        (first, last).
    tolerance
        Squared difference, summed over the layers, that costs a half.
    """
    count, columns = views.shape[0], centre.shape[2]
    first, last = max(rows[0] - 1, 0), min(rows[1] + 1, centre.shape[1])
    blend, sample = np.empty(columns + 3, dtype=np.float32), np.empty(columns, dtype=np.float32)
    square = np.empty((count, last - first, columns), dtype=np.float32)
    column, patch = np.empty(columns + 2, dtype=np.float32), np.empty(columns, dtype=np.float32)
    each, half = np.empty(columns, dtype=np.float32), np.empty(columns, dtype=np.float32)
    sums = np.empty((8, columns), dtype=np.float32)
    share = np.zeros(8, dtype=np.float32)
    for q in range(count):
        share[sector[q]] += 1
    for h in range(hypotheses.shape[0]):
        for q in range(count):
            for t in range(first, last):
                _differ(views[q], t, -hypotheses[h] * v[q], -hypotheses[h] * u[q], margin, centre, blend, sample,
                        square[q, t - first])  # fmt: skip
        for t in range(rows[0], rows[1]):
            here = t - first
            above, below = max(here - 1, 0), min(here + 1, last - first - 1)
            sums[:] = 0
            each[:] = 0
            for q in range(count):
                _add_bounded(square[q, here], tolerance, each)
                _patch(square[q, above], square[q, here], square[q, below], column, patch)
                _add_bounded(patch, tolerance, sums[sector[q]])
            _best_half(sums, share, half)
            for s in range(columns):
                out[h, t, s] = np.float32(0.5) * (each[s] / count + half[s])
