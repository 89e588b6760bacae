"""Samples of a mosaicked light field gathered along the disparity, colour by colour.

A sample of view q at lens k shows, in a target view p, the point ``X_k + d·(q + ρ_k − p)``, where d is the target's
disparity and ρ_k the rounding of the lens centre (the true place in the aperture is q + ρ_k). Around each target these
places are scattered. Two steps make a colour of them:

1. a plane through the samples of each colour, by weighted least squares, read at the target, so that an uneven scatter
   does not shift the picture;
2. what the nearest samples of all colours together lie above or below their planes, as a share of the colour: detail
   is common to the colours, so it can be taken from all of them, and more sharply than from one.

All lengths are lens pitches, all view offsets sensor pixels. The loops run over blocks of targets and contain no
branches, so that the compiler makes vector instructions of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_F = np.float32
_MOMENTS = 15
_BLOCK = 1024
_DARK = _F(0.02)
"""Colours below this radiance share the detail of the others as if they had it."""

_FAR = _F(0.5)
"""Disparity above which the rounding of the lens centres decides which lens's sample is the nearest."""

_FREE = _F(0.4)
"""Share of the samples that must be left after the three numbers of a plane, to tell how they scatter."""

_VECTOR: dict[str, Any] = {
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "nsz", "arcp"},
}


class Samples(NamedTuple):
    """What a mosaicked light field measured; Q views, T lens rows, S lens columns.

    Parameters
    ----------
    value, weight, disparity
        float32 (Q, T, S): radiance, confidence, and the disparity that each sample belongs to (NaN: unknown).
    colour
        uint8 (Q, T, S): 0 R, 1 G, 2 B, 255 no sample.
    residual
        float32 (2, T, S): rounding of each lens centre in u and v.
    aperture
        float32 (Q, 2): (u, v) of each view.
    used
        int64 (K,): the views that take part.
    geometry
        float32 (3,): distance of two lens rows; X of the first lens of every other row, and whether row 0 is such (1).
    """

    value: Array
    weight: Array
    disparity: Array
    colour: Array
    residual: Array
    aperture: Array
    used: Array
    geometry: Array


class Targets(NamedTuple):
    """Where colours are wanted, all float32 (N,).

    Parameters
    ----------
    x, y, u, v
        Position and view.
    disparity, doubt
        Disparity there (NaN: nothing is gathered) and its standard deviation.
    """

    x: Array
    y: Array
    u: Array
    v: Array
    disparity: Array
    doubt: Array


class Gathered(NamedTuple):
    """Colours at the targets and how well they are known, all float32.

    Parameters
    ----------
    planes
        (N, colour, 3): value, ∂/∂X, ∂/∂Y. The value is NaN where no sample of the colour agrees.
    weight
        (N, colour): sum of the samples' weights.
    variance
        (N, colour): of the value, as its samples scatter about their plane; NaN where they are too few to tell.
    """

    planes: Array
    weight: Array
    variance: Array


class Rule(NamedTuple):
    """How samples are weighed.

    Parameters
    ----------
    radius
        Samples farther than this from the target do not count for the planes.
    detail
        Nor those farther than this for the detail that all colours share.
    tolerance
        Disparity difference at which a sample counts a quarter where the disparity is certain.
    strictness
        Product of doubt² and baseline² (in lens pitches) at which a view counts half is the inverse of this.
    lift
        Factor on the detail; more than 1 makes up for the blur of the kernel.
    stiffness
        Weight of the prior that the fitted plane of green is level, relative to the samples' weight × radius².
    likeness
        The same of the prior that the planes of red and blue have the slope of green's, in shares of their values.
    """

    radius: float = 0.9
    detail: float = 0.5
    tolerance: float = 0.06
    strictness: float = 10.0
    lift: float = 1.4
    stiffness: float = 0.02
    likeness: float = 0.05


@numba.njit(**_VECTOR)
def _locate(targets: Any, first: int, count: int, q: Array, samples: Any, place: Array, at: Array) -> None:
    """Lens of a view that is nearest to each target's ray: its index, the way to it, and the baseline."""
    rows, columns = np.int32(samples.colour.shape[1]), np.int32(samples.colour.shape[2])
    pitch, half, odd = samples.geometry[0], samples.geometry[1], np.int32(samples.geometry[2])
    x, y, d = targets.x, targets.y, targets.disparity
    to_x, to_y, a, b = place[0], place[1], place[2], place[3]
    per_row = _F(1) / pitch
    for j in range(count):
        n = first + j
        a[j], b[j] = q[0] - targets.u[n], q[1] - targets.v[n]
        row = np.int32(np.floor((y[n] - d[n] * b[j]) * per_row + _F(0.5)))
        shift = half * _F((row + odd) & np.int32(1))
        column = np.int32(np.floor(x[n] - d[n] * a[j] - shift + _F(0.5)))
        to_x[j], to_y[j] = _F(column) + shift - x[n], _F(row) * pitch - y[n]
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        at[j] = row * columns + column if inside else np.int32(-1)


@numba.njit(**_VECTOR)
def _relocate(targets: Any, first: int, count: int, samples: Any, place: Array, at: Array, rounding: Array) -> None:
    """Lens of the same view whose sample comes nearest, now that the rounding of the lenses about it is known."""
    rows, columns = np.int32(samples.colour.shape[1]), np.int32(samples.colour.shape[2])
    pitch, half, odd = samples.geometry[0], samples.geometry[1], np.int32(samples.geometry[2])
    x, y, d = targets.x, targets.y, targets.disparity
    to_x, to_y, a, b = place[0], place[1], place[2], place[3]
    residual_u, residual_v = samples.residual[0].ravel(), samples.residual[1].ravel()
    for j in range(count):
        k = np.uint32(max(at[j], 0))
        rounding[0, j], rounding[1, j] = residual_u[k], residual_v[k]
    per_row = _F(1) / pitch
    for j in range(count):
        n = first + j
        known = _F(1) if abs(d[n]) > _FAR else _F(0)
        down = (y[n] - d[n] * (b[j] + known * rounding[1, j])) * per_row
        row = np.int32(np.floor(down + _F(0.5)))
        shift = half * _F((row + odd) & np.int32(1))
        column = np.int32(np.floor(x[n] - d[n] * (a[j] + known * rounding[0, j]) - shift + _F(0.5)))
        to_x[j], to_y[j] = _F(column) + shift - x[n], _F(row) * pitch - y[n]
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        at[j] = row * columns + column if inside else np.int32(-1)


@numba.njit(**_VECTOR)
def _fetch(samples: Any, q: int, at: Array, count: int, place: Array, found: Array, colour: Array) -> int:
    """Samples at `at`, with no weight where there is none; their colours, and the bits of those that were met."""
    value, weight = samples.value[q].ravel(), samples.weight[q].ravel()
    disparity, colours = samples.disparity[q].ravel(), samples.colour[q].ravel()
    residual_u, residual_v = samples.residual[0].ravel(), samples.residual[1].ravel()
    for j in range(count):
        k = np.uint32(max(at[j], 0))
        found[0, j], found[1, j], found[2, j] = value[k], weight[k], disparity[k]
        place[2, j] += residual_u[k]
        place[3, j] += residual_v[k]
        colour[j] = colours[k]
    for j in range(count):
        good = (at[j] >= 0) & (found[0, j] == found[0, j]) & (found[2, j] == found[2, j])
        for n in range(3):
            found[n, j] = found[n, j] if good else _F(0)
    red, green, blue = np.uint8(0), np.uint8(0), np.uint8(0)
    for j in range(count):
        red |= np.uint8(colour[j] == 0)
        green |= np.uint8(colour[j] == 1)
        blue |= np.uint8(colour[j] == 2)
    return int(red) + 2 * int(green) + 4 * int(blue)


@numba.njit(**_VECTOR)
def _weigh(targets: Any, first: int, count: int, place: Array, found: Array, rule: Any) -> None:
    """Ways from targets to samples into ``place[0:2]``; weights for planes and detail into ``found[1:3]``."""
    dx, dy, a, b = place[0], place[1], place[2], place[3]
    weight, disparity = found[1], found[2]
    wide, close = _F(1 / rule.radius**2), _F(1 / rule.detail**2)
    tolerance, strictness = _F(rule.tolerance**2), _F(rule.strictness)
    for j in range(count):
        d, doubt = targets.disparity[first + j], targets.doubt[first + j]
        doubt *= doubt
        dx[j] += d * a[j]
        dy[j] += d * b[j]
        off = dx[j] * dx[j] + dy[j] * dy[j]
        near, nearest = _F(1) - off * wide, _F(1) - off * close
        near, nearest = near if near > 0 else _F(0), nearest if nearest > 0 else _F(0)
        apart = disparity[j] - d
        scale = tolerance + doubt
        loose = _F(1) + strictness * doubt * (a[j] * a[j] + b[j] * b[j])
        trust = scale / ((scale + apart * apart) * loose)
        trust *= trust * weight[j]
        weight[j] = near * near * trust * loose
        disparity[j] = nearest * nearest * trust


@numba.njit(**_VECTOR)
def _add(moments: Array, colour: int, colours: Array, place: Array, found: Array, count: int) -> None:
    """Add the samples of one colour to its moments (15, block)."""
    m0, m1, m2, m3, m4, m5 = moments[0], moments[1], moments[2], moments[3], moments[4], moments[5]
    m6, m7, m8, m9, m10, m11 = moments[6], moments[7], moments[8], moments[9], moments[10], moments[11]
    m12, m13, m14 = moments[12], moments[13], moments[14]
    dx, dy, value, wide, close = place[0], place[1], found[0], found[1], found[2]
    for j in range(count):
        w = wide[j] if colours[j] == colour else _F(0)
        wx, wy = w * dx[j], w * dy[j]
        m0[j] += w
        m1[j] += wx
        m2[j] += wy
        m3[j] += wx * dx[j]
        m4[j] += wx * dy[j]
        m5[j] += wy * dy[j]
        m6[j] += w * value[j]
        m7[j] += wx * value[j]
        m8[j] += wy * value[j]
        m13[j] += w * w
        m14[j] += w * value[j] * value[j]
    for j in range(count):
        w = close[j] if colours[j] == colour else _F(0)
        m9[j] += w
        m10[j] += w * dx[j]
        m11[j] += w * dy[j]
        m12[j] += w * value[j]


@numba.njit(**_VECTOR)
def _fit(m: Array, count: int, ridge: float, guide: Array, planes: Array, variance: Array) -> None:
    """Planes (block, 3): value and slopes at the origin from moments (15, block), and the variance of the value.

    `ridge` holds the slopes to those of the `guide` (block, 3), which is scaled to the colour's mean.
    """
    for j in range(count):
        per = _F(1) / m[0, j]
        mx, my, mean = m[1, j] * per, m[2, j] * per, m[6, j] * per
        there = guide[j, 0] + guide[j, 1] * mx + guide[j, 2] * my
        ratio = mean / there if there > _DARK else _F(0)
        prior_x, prior_y = ratio * guide[j, 1], ratio * guide[j, 2]
        xx, xy, yy = m[3, j] * per - mx * mx, m[4, j] * per - mx * my, m[5, j] * per - my * my
        cx, cy = m[7, j] * per - mx * mean, m[8, j] * per - my * mean
        px, py = cx - xx * prior_x - xy * prior_y, cy - xy * prior_x - yy * prior_y
        hard_x, hard_y = xx + ridge, yy + ridge
        scale = _F(1) / (hard_x * hard_y - xy * xy)
        slope_x, slope_y = prior_x + (px * hard_y - py * xy) * scale, prior_y + (py * hard_x - px * xy) * scale
        scatter = m[14, j] * per - mean * mean - _F(2) * (slope_x * cx + slope_y * cy)
        scatter += slope_x * slope_x * xx + _F(2) * slope_x * slope_y * xy + slope_y * slope_y * yy
        share = m[13, j] * per * per
        known = m[0, j] > 0
        planes[j, 0] = mean - mx * slope_x - my * slope_y if known else np.nan
        planes[j, 1] = slope_x if known else _F(0)
        planes[j, 2] = slope_y if known else _F(0)
        free = _F(1) - _F(3) * share
        variance[j] = max(scatter, _F(0)) * share / free if free > _FREE else np.nan


@numba.njit(**_VECTOR)
def _sharpen(moments: Array, count: int, lift: Any, planes: Array) -> None:
    """Raise every colour by `lift` times the share that the nearest samples of all colours lie above their planes."""
    for j in range(count):
        above, weight = _F(0), _F(0)
        for c in range(3):
            level = planes[j, c, 0]
            if moments[c, 9, j] > 0:
                planned = level * moments[c, 9, j] + planes[j, c, 1] * moments[c, 10, j]
                planned += planes[j, c, 2] * moments[c, 11, j]
                above += (moments[c, 12, j] - planned) / max(level, _DARK)
                weight += moments[c, 9, j]
        if weight > 0:
            for c in range(3):
                planes[j, c, 0] += lift * above / weight * max(planes[j, c, 0], _DARK)


@numba.njit(**_VECTOR)
def _gather(samples: Any, targets: Any, rule: Any, planes: Array, weight: Array, variance: Array) -> None:
    moments = np.empty((3, _MOMENTS, _BLOCK), dtype=np.float32)
    place, found = np.empty((4, _BLOCK), dtype=np.float32), np.empty((3, _BLOCK), dtype=np.float32)
    at, colours = np.empty(_BLOCK, dtype=np.int32), np.empty(_BLOCK, dtype=np.uint8)
    rounding = np.empty((2, _BLOCK), dtype=np.float32)
    level, ridge = _F(rule.stiffness * rule.radius**2), _F(rule.likeness * rule.radius**2)
    flat = np.zeros((_BLOCK, 3), dtype=np.float32)
    for first in range(0, targets.x.shape[0], _BLOCK):
        count = min(_BLOCK, targets.x.shape[0] - first)
        moments[:] = 0
        far = np.abs(targets.disparity[first : first + count]).max() > _FAR
        for q in samples.used:
            _locate(targets, first, count, samples.aperture[q], samples, place, at)
            if far:
                _relocate(targets, first, count, samples, place, at, rounding)
            seen = _fetch(samples, q, at, count, place, found, colours)
            if seen:
                _weigh(targets, first, count, place, found, rule)
            for c in range(3):
                if seen >> c & 1:
                    _add(moments[c], np.uint8(c), colours, place, found, count)
        block, scatter = planes[first : first + count], variance[first : first + count]
        _fit(moments[1], count, level, flat, block[:, 1], scatter[:, 1])
        for c in (0, 2):
            _fit(moments[c], count, ridge, block[:, 1], block[:, c], scatter[:, c])
        _sharpen(moments, count, _F(rule.lift), block)
        for c in range(3):
            weight[first : first + count, c] = moments[c, 0, :count]


def gather(samples: Samples, targets: Targets, rule: Rule) -> Gathered:
    """Colours at the targets, and how well they are known.

    What the sums are does not depend on how the targets are cut into calls, but for rounding.
    """
    known, count = np.isfinite(targets.disparity), targets.x.shape[0]
    found = Gathered(np.empty((count, 3, 3), np.float32), *np.empty((2, count, 3), np.float32))
    _gather(samples, targets._replace(disparity=np.where(known, targets.disparity, _F(0))), rule, *found)
    found.planes[~known] = np.nan, 0, 0
    found.weight[~known] = 0
    return found
