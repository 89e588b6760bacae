"""Cost volume of the central view against full-colour views around it, with occlusion chosen out by half planes."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.full_colour.spline import weights

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

_FLAGS = {"nsz", "contract", "reassoc", "arcp"}


def padded(views: FloatArray, margin: int) -> FloatArray:
    """Views (view, t, s, channel) as (view, channel, t + 2·margin, s + 2·margin) with repeated borders."""
    planes = np.moveaxis(views, -1, 1)
    return np.ascontiguousarray(np.pad(planes, ((0, 0), (0, 0), (margin, margin), (margin, margin)), mode="edge"))


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
def _half_planes(mean, square, share, centre, own, out):  # type: ignore[no-untyped-def]
    """Smallest variance over the eight half planes of four neighbouring sectors, the centre counted `own` times."""
    channels, columns = centre.shape
    for s in range(columns):
        out[s] = np.float32(1e30)
    for k in range(8):
        k1, k2, k3 = (k + 1) % 8, (k + 2) % 8, (k + 3) % 8
        n = share[k] + share[k1] + share[k2] + share[k3]
        if n == 0:
            continue
        inverse = np.float32(1) / (n + own)
        spread = np.float32(1) / (n + own - np.float32(1))
        for s in range(columns):
            value = square[k, s] + square[k1, s] + square[k2, s] + square[k3, s]
            for c in range(channels):
                first = mean[k, c, s] + mean[k1, c, s] + mean[k2, c, s] + mean[k3, c, s]
                value -= first * first * inverse
            out[s] = min(out[s], value * spread)


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _collect(views, q, t, d, u, v, margin, centre, blend, sample):  # type: ignore[no-untyped-def]
    """Differences (channel, s) of row t of view q, seen at disparity d, to the centre."""
    x, y = -d * u, t - d * v
    left, top = int(np.floor(x)), int(np.floor(y))
    for c in range(centre.shape[0]):
        _sample(views[q, c], top + margin, left + margin, y - top, x - left, blend, sample[c])
        row, reference = sample[c], centre[c, t]
        for s in range(row.shape[0]):
            row[s] -= reference[s]


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def half_plane_volume(views, centre, u, v, sector, margin, hypotheses, span, out):  # type: ignore[no-untyped-def]
    """Fill `out` (hypothesis, t, s) with the variance of the best half plane of views, summed over the channels.

    Parameters
    ----------
    views
        (view, channel, t, s) padded by `margin` > max |d·u| + 2.
    centre
        (channel, t, s), not padded, read by the same spline.
    u, v, sector
        (view,) offsets and sectors.
    hypotheses
        (hypothesis,) disparities.
    span
        First row and the one after the last.
    """
    count, channels = views.shape[0], views.shape[1]
    columns = centre.shape[2]
    blend = np.empty(columns + 3, dtype=np.float32)
    sample = np.empty((channels, columns), dtype=np.float32)
    mean = np.empty((8, channels, columns), dtype=np.float32)
    square = np.empty((8, columns), dtype=np.float32)
    share = np.zeros(8, dtype=np.float32)
    for q in range(count):
        share[sector[q]] += 1
    for t in range(span[0], span[1]):
        for h in range(hypotheses.shape[0]):
            mean[:] = 0
            square[:] = 0
            for q in range(count):
                _collect(views, q, t, hypotheses[h], u[q], v[q], margin, centre, blend, sample)
                second = square[sector[q]]
                for c in range(channels):
                    first, row = mean[sector[q], c], sample[c]
                    for s in range(columns):
                        first[s] += row[s]
                        second[s] += row[s] * row[s]
            _half_planes(mean, square, share, centre[:, t], np.float32(1), out[h, t])
