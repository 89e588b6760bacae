"""A disparity map carried from the central view to every other view, with depth test and hole filling (METHOD 8.6)."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]
NO_DATA, OCCLUDED, FILLED = 1, 8, 16


def transpose_map(
    disparity: FloatArray,
    std: FloatArray,
    flags: ByteArray,
    views: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]],
    offset: FloatArray,
    row_pitch: float,
) -> tuple[FloatArray, FloatArray, ByteArray]:
    """Disparity, std and flags (v, u, t, s) of the views `views` = (v, u) from those (t, s) of view (0, 0).

    The point of lens X goes to X − d·(u, v); where several meet, the nearest (largest d) wins. A lens that nothing
    reaches lies in a crack of one surface if what bounds it differs by less than one lens of motion, or if four of its
    six neighbours are known, and takes their median; else it was hidden, takes the smallest disparity that bounds it
    (the background) and the flags occluded and filled.
    """
    v, u = views
    shape = (len(v), len(u), *disparity.shape)
    out_d, out_std = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    out_flags = np.empty(shape, dtype=np.uint8)
    source = np.ascontiguousarray(disparity, "float32"), np.ascontiguousarray(std, "float32")
    _transpose(*source, np.ascontiguousarray(flags, "uint8"), v.astype(np.int64), u.astype(np.int64),
               offset.astype(np.float32), np.float32(row_pitch), out_d, out_std, out_flags)  # fmt: skip
    return out_d, out_std, out_flags


@numba.njit(nogil=True, cache=True)
def _transpose(disparity, std, flags, v, u, offset, pitch, out_d, out_std, out_flags):  # type: ignore[no-untyped-def]
    for j in range(v.shape[0]):
        for i in range(u.shape[0]):
            if u[i] == 0 and v[j] == 0:
                out_d[j, i], out_std[j, i], out_flags[j, i] = disparity, std, flags
                continue
            _splat(disparity, std, flags, v[j], u[i], offset, pitch, out_d[j, i], out_std[j, i], out_flags[j, i])
            _fill_holes(out_d[j, i], out_std[j, i], out_flags[j, i], offset, max(abs(u[i]), abs(v[j])))


@numba.njit(nogil=True, cache=True)
def _splat(disparity, std, flags, v, u, offset, pitch, out_d, out_std, out_flags):  # type: ignore[no-untyped-def]
    rows, columns = disparity.shape
    out_d[:] = np.nan
    out_std[:] = np.nan
    out_flags[:] = NO_DATA
    for t in range(rows):
        for s in range(columns):
            d = disparity[t, s]
            if np.isnan(d):
                continue
            row = int(np.floor(t - d * v / pitch + np.float32(0.5)))
            if row < 0 or row >= rows:
                continue
            column = int(np.floor(s + offset[t] - d * u - offset[row] + np.float32(0.5)))
            if column < 0 or column >= columns:
                continue
            if not (out_d[row, column] >= d):
                out_d[row, column] = d
                out_std[row, column] = std[t, s]
                out_flags[row, column] = flags[t, s]


@numba.njit(nogil=True, cache=True)
def _fill_holes(d, std, flags, offset, baseline):  # type: ignore[no-untyped-def]
    holes_t, holes_s = np.nonzero(np.isnan(d))
    count = holes_t.shape[0]
    value = np.full(count, np.nan, dtype=np.float32)
    error = np.full(count, np.nan, dtype=np.float32)
    mark = np.zeros(count, dtype=np.uint8)
    near = np.empty(6, dtype=np.float32)
    for n in range(count):
        found, low, high, error[n] = _bounds(d, std, offset, holes_t[n], holes_s[n], near)
        if found >= 4 or (found >= 1 and (high - low) * baseline < 1):
            value[n] = np.sort(near[:found])[(found - 1) // 2]
        elif low < np.inf:
            value[n], mark[n] = low, OCCLUDED | FILLED
        else:
            mark[n] = NO_DATA
    for n in range(count):
        d[holes_t[n], holes_s[n]] = value[n]
        std[holes_t[n], holes_s[n]] = error[n]
        flags[holes_t[n], holes_s[n]] = mark[n]


@numba.njit(nogil=True, cache=True)
def _bounds(d, std, offset, hole_t, hole_s, near):  # type: ignore[no-untyped-def]
    """Bounds of a hole: count of known neighbours (written to `near`), smallest and largest d, std of the smallest."""
    found = 0
    low, high, error = np.float32(np.inf), np.float32(-np.inf), np.float32(np.nan)
    nearest = 1 << 30
    for way in range(6):
        t, s = _neighbour(hole_t, hole_s, way, offset)
        length = 1
        while 0 <= t < d.shape[0] and 0 <= s < d.shape[1] and np.isnan(d[t, s]):
            t, s = _neighbour(t, s, way, offset)
            length += 1
        if t < 0 or s < 0 or t >= d.shape[0] or s >= d.shape[1]:
            continue
        if length == 1:
            near[found] = d[t, s]
            found += 1
        high = max(high, d[t, s])
        if d[t, s] < low - np.float32(1e-6) or (d[t, s] <= low and length < nearest):
            low, nearest, error = d[t, s], length, std[t, s]
    return found, low, high, error


@numba.njit(nogil=True, cache=True)
def _neighbour(t, s, way, offset):  # type: ignore[no-untyped-def]
    """The next lens left, right, up-left, up-right, down-left, down-right (square lattice: straight up and down)."""
    if way < 2:
        return t, s + 2 * way - 1
    row = t - 1 if way < 4 else t + 1
    if row < 0 or row >= offset.shape[0] or offset[row] == offset[t]:
        return row, s
    right = way % 2
    return row, s + right - (1 if offset[t] == 0 else 0)
