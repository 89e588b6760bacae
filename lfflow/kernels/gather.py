"""Samples of a mosaicked light field gathered along the disparity, colour by colour.

A sample of view q at lens k shows, in a target view p, the point ``X_k + d·(q + ρ_k − p)``, where d is the target's
disparity and ρ_k the rounding of the lens centre (the true place in the aperture is q + ρ_k). Around each target these
places are scattered; a plane is fitted to the samples of each colour by weighted least squares and read at the target,
so that an uneven scatter does not shift the picture.

All lengths are lens pitches, all view offsets sensor pixels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_MOMENTS = 9
_PAD = 1 << 12


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
    geometry
        float32 (3,): distance of two lens rows; X of the first lens of every other row, and whether row 0 is such (1).
    """

    value: Array
    weight: Array
    disparity: Array
    colour: Array
    residual: Array
    aperture: Array
    geometry: Array


class Targets(NamedTuple):
    """Where colours are wanted: I rows of J places.

    Parameters
    ----------
    x, y, u, v
        float32 (I, J): position and view.
    disparity, spread
        float32 (I, J): disparity there (NaN: nothing is gathered) and its standard deviation.
    """

    x: Array
    y: Array
    u: Array
    v: Array
    disparity: Array
    spread: Array


class Rule(NamedTuple):
    """How samples are weighed.

    Parameters
    ----------
    radius
        Samples farther than this from the target do not count.
    tolerance
        Disparity difference at which a sample counts half.
    stiffness
        Weight of the prior that the fitted plane is level, relative to the samples' weight × radius².
    reach
        Views farther than this from the target's, in u or v, are left out.
    neighbours
        Lenses looked at per view, along a row and across: 1, or 2 for targets off the lattice.
    """

    radius: float = 0.6
    tolerance: float = 0.06
    stiffness: float = 0.02
    reach: float = 99.0
    neighbours: int = 1


@numba.njit(nogil=True, cache=True, inline="always")
def _add(acc: Array, place: int, colour: int, dx: float, dy: float, weight: float, value: float) -> None:
    wx, wy = weight * dx, weight * dy
    acc[place, colour, 0] += weight
    acc[place, colour, 1] += wx
    acc[place, colour, 2] += wy
    acc[place, colour, 3] += wx * dx
    acc[place, colour, 4] += wx * dy
    acc[place, colour, 5] += wy * dy
    acc[place, colour, 6] += weight * value
    acc[place, colour, 7] += wx * value
    acc[place, colour, 8] += wy * value


@numba.njit(nogil=True, cache=True)
def _gather_view(acc: Array, samples: Any, q: int, targets: Any, i: int, rule: Any) -> None:
    value, weights, disparity, colours = samples.value, samples.weight, samples.disparity, samples.colour
    rows, columns = value.shape[1], value.shape[2]
    pitch, half, odd, one = samples.geometry[0], samples.geometry[1], int(samples.geometry[2]), np.float32(1.0)
    per_row = one / pitch
    square, narrow = np.float32(1.0 / rule.radius**2), np.float32(1.0 / rule.tolerance**2)
    shift = np.float32((0.5 if rule.neighbours == 1 else 0.0) + _PAD)
    qu, qv = samples.aperture[q, 0], samples.aperture[q, 1]
    for j in range(targets.x.shape[1]):
        d, x, y = targets.disparity[i, j], targets.x[i, j], targets.y[i, j]
        a, b = qu - targets.u[i, j], qv - targets.v[i, j]
        if np.isnan(d) or abs(a) > rule.reach or abs(b) > rule.reach:
            continue
        loose = np.float32(4.0) * targets.spread[i, j] * targets.spread[i, j] * (a * a + b * b)
        first = int((y - d * b) * per_row + shift) - _PAD
        for r in range(max(first, 0), min(first + rule.neighbours, rows)):
            offset = half * np.float32((r + odd) & 1)
            left = int(x - d * a - offset + shift) - _PAD
            for c in range(max(left, 0), min(left + rule.neighbours, columns)):
                colour = colours[q, r, c]
                if colour > 2:
                    continue
                dx = np.float32(c) + offset + d * (a + samples.residual[0, r, c]) - x
                dy = np.float32(r) * pitch + d * (b + samples.residual[1, r, c]) - y
                near = one - (dx * dx + dy * dy) * square
                if near <= 0:
                    continue
                apart = disparity[q, r, c] - d
                unlike = one + apart * apart * narrow
                weight = near * near * weights[q, r, c] / (unlike * unlike * (one + loose * square))
                if weight > 0:
                    _add(acc, j, colour, dx, dy, weight, value[q, r, c])


@numba.njit(nogil=True, cache=True)
def _level(m: Array, ridge: float) -> float:
    """Height at the origin of the plane fitted to nine moments, slopes held by `ridge`."""
    s0 = m[0]
    mx, my, mean = m[1] / s0, m[2] / s0, m[6] / s0
    xx, xy, yy = m[3] / s0 - mx * mx + ridge, m[4] / s0 - mx * my, m[5] / s0 - my * my + ridge
    px, py = m[7] / s0 - mx * mean, m[8] / s0 - my * mean
    determinant = xx * yy - xy * xy
    return float(mean - (mx * (px * yy - py * xy) + my * (py * xx - px * xy)) / determinant)


@numba.njit(nogil=True, cache=True)
def gather(samples: Any, targets: Any, rule: Any) -> tuple[Array, Array]:
    """Colours at the targets, and the weight that each rests on.

    Parameters
    ----------
    samples, targets, rule
        `Samples`, `Targets` and `Rule`.

    Returns
    -------
    rgb, support
        float32 (I, J, 3); NaN and 0 where no sample of the colour agrees.
    """
    height, width = targets.x.shape
    rgb = np.full((height, width, 3), np.nan, dtype=np.float32)
    support = np.zeros((height, width, 3), dtype=np.float32)
    acc = np.empty((width, 3, _MOMENTS), dtype=np.float32)
    ridge = rule.stiffness * rule.radius * rule.radius
    for i in range(height):
        acc[:] = 0
        for q in range(samples.value.shape[0]):
            _gather_view(acc, samples, q, targets, i, rule)
        for j in range(width):
            for colour in range(3):
                if acc[j, colour, 0] > 0:
                    rgb[i, j, colour] = _level(acc[j, colour], ridge)
                    support[i, j, colour] = acc[j, colour, 0]
    return rgb, support
