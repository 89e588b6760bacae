"""Disparity maps of a few views carried to every view: depth test, fusion, hole filling, consistency (METHOD 8.6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.mosaicked.mosaic_field import shown_by
from lfflow.kernels.weighted_median import weighted_median

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]
NO_DATA, OCCLUDED, FILLED = 1, 8, 16
ALIKE = 1 / 8
"""Largest difference, lens pitches per view step, of two estimates of one point; smaller ones weigh alike."""


class SourceMap(NamedTuple):
    """Disparity, std and flags (t, s) that were estimated at view (u, v)."""

    disparity: FloatArray
    std: FloatArray
    flags: ByteArray
    u: int
    v: int


def transpose_maps(
    sources: Sequence[SourceMap],
    views: tuple[npt.NDArray[np.integer], npt.NDArray[np.integer]],
    offset: FloatArray,
    row_pitch: float,
) -> tuple[FloatArray, FloatArray, ByteArray]:
    """Disparity, std and flags (v, u, t, s) of the views `views` = (v, u) from the maps of a few views.

    The point of lens X of view p goes to X − d·(q − p) of view q; where several of one map meet, the nearest (largest
    d) wins. What arrives is carried on to the other maps and dropped where more of them see past it, to what is farther
    by 1/8, than agree. Of what remains the mean of those within 1/8 of the weighted median is taken; maps of near views
    weigh more, and places where fewer than half agree are flagged occluded. A lens that nothing reaches lies in a crack
    of one surface if what bounds it differs by less than one lens of motion, or if four of its six neighbours are
    known, and takes their median; else it was hidden, takes the smallest disparity that bounds it (the background) and
    the flags occluded and filled. A filled value that the maps see past is replaced by what the nearest of them shows
    there, with the same flags.
    """
    v, u = views
    shape = (len(v), len(u), *sources[0].disparity.shape)
    out_d, out_std = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    out_flags = np.empty(shape, dtype=np.uint8)
    disparity, std = (np.stack([one[k] for one in sources]).astype(np.float32) for k in (0, 1))
    flags = np.stack([one.flags for one in sources]).astype(np.uint8)
    places = np.array([(one.u, one.v) for one in sources], dtype=np.float32)
    geometry = offset.astype(np.float32), np.float32(row_pitch)
    for j, i in np.ndindex(*shape[:2]):
        away = np.array((u[i], v[j]), dtype=np.float32) - places
        if len(sources) == 1 and not away.any():
            out_d[j, i], out_std[j, i], out_flags[j, i] = disparity[0], std[0], flags[0]
            continue
        d, error, bits = out_d[j, i], out_std[j, i], out_flags[j, i]
        landed, landed_std, landed_flags = _splat(disparity, std, flags, away, *geometry)
        _drop_contradicted(disparity, away, *geometry, landed)
        distance = (away**2).sum(axis=1)
        _fuse(landed, landed_std, landed_flags, distance, d, error, bits)
        holes = np.isnan(d)
        _fill_holes(d, error, bits, geometry[0], np.abs(away).max(axis=1).min())
        _settle_filled(disparity, away, distance.argmin(), *geometry, holes, d, bits)
    return out_d, out_std, out_flags


@numba.njit(nogil=True, cache=True)
def _splat(disparity, std, flags, away, offset, pitch):  # type: ignore[no-untyped-def]
    """The maps (source, t, s) as the view that lies `away` (source, (u, v)) from theirs shows them, with holes."""
    out_d, out_std = np.full_like(disparity, np.nan), np.full_like(std, np.nan)
    out_flags = np.full_like(flags, NO_DATA)
    sources, rows, columns = disparity.shape
    for k in range(sources):
        for t in range(rows):
            for s in range(columns):
                d = disparity[k, t, s]
                if np.isnan(d):
                    continue
                row, column = shown_by(t, s, d, away[k, 0], away[k, 1], offset, pitch)
                if column < 0 or column >= columns or out_d[k, row, column] >= d:
                    continue
                out_d[k, row, column] = d
                out_std[k, row, column] = std[k, t, s]
                out_flags[k, row, column] = flags[k, t, s]
    return out_d, out_std, out_flags


@numba.njit(nogil=True, cache=True)
def _balance(sources, away, t, s, d, own, offset, pitch):  # type: ignore[no-untyped-def]
    """Count of the sources but `own` that agree with disparity `d` of a lens of the view, less those that see past it.

    A source that shows something nearer there does not see the point.
    """
    columns = sources.shape[2]
    balance = 0
    for k in range(sources.shape[0]):
        if k == own:
            continue
        row, column = shown_by(t, s, d, -away[k, 0], -away[k, 1], offset, pitch)
        if column < 0 or column >= columns:
            continue
        if abs(sources[k, row, column] - d) <= ALIKE:
            balance += 1
        elif sources[k, row, column] < d:
            balance -= 1
    return balance


@numba.njit(nogil=True, cache=True)
def _drop_contradicted(sources, away, offset, pitch, landed):  # type: ignore[no-untyped-def]
    """Clear the values (source, t, s) of a view that more of the other sources see past than agree with."""
    for k in range(landed.shape[0] if landed.shape[0] > 1 else 0):
        for t in range(landed.shape[1]):
            for s in range(landed.shape[2]):
                d = landed[k, t, s]
                if not np.isnan(d) and _balance(sources, away, t, s, d, k, offset, pitch) < 0:
                    landed[k, t, s] = np.nan


@numba.njit(nogil=True, cache=True)
def _settle_filled(sources, away, nearest, offset, pitch, holes, d, flags):  # type: ignore[no-untyped-def]
    """Give the filled lenses of a view that the sources see past what the `nearest` of them shows there, flagged."""
    for t, s in np.argwhere(holes):
        if np.isnan(d[t, s]) or _balance(sources, away, t, s, d[t, s], -1, offset, pitch) >= 0:
            continue
        flags[t, s] |= OCCLUDED | FILLED
        row, column = shown_by(t, s, d[t, s], -away[nearest, 0], -away[nearest, 1], offset, pitch)
        if 0 <= column < d.shape[1] and sources[nearest, row, column] < d[t, s]:
            d[t, s] = sources[nearest, row, column]


@numba.njit(nogil=True, cache=True)
def _fuse(disparity, std, flags, distance, out_d, out_std, out_flags):  # type: ignore[no-untyped-def]
    """One value (t, s) of those of the sources (source, t, s) that are known; `distance` (source,) is squared."""
    sources, rows, columns = disparity.shape
    value, weight = np.empty(sources, dtype=np.float32), np.empty(sources, dtype=np.float32)
    alike = np.float32(ALIKE)
    for t in range(rows):
        for s in range(columns):
            known, last = 0, 0
            for k in range(sources):
                if not np.isnan(disparity[k, t, s]):
                    last = k
                    value[known] = disparity[k, t, s]
                    weight[known] = 1 / ((std[k, t, s] ** 2 + alike**2) * (1 + distance[k]))
                    known += 1
            if known < 2:
                out_d[t, s], out_std[t, s] = disparity[last, t, s], std[last, t, s]
                out_flags[t, s] = flags[last, t, s]
                continue
            middle = weighted_median(value[:known], weight[:known])
            total, mean, variance = np.float32(0), np.float32(0), np.float32(0)
            agreeing, bits = 0, 255
            for k in range(sources):
                if not abs(disparity[k, t, s] - middle) <= alike:
                    continue
                w = 1 / ((std[k, t, s] ** 2 + alike**2) * (1 + distance[k]))
                total += w
                mean += w * (disparity[k, t, s] - middle)
                variance += w * std[k, t, s] ** 2
                agreeing += 1
                bits &= flags[k, t, s]
            out_d[t, s] = middle + mean / total
            out_std[t, s] = np.sqrt(variance / total)
            out_flags[t, s] = bits if 2 * agreeing >= known else bits | OCCLUDED


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
