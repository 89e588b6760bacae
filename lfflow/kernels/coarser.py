"""Smooth functions on ever coarser grids, so that a solver moves whole regions at once and not only neighbours.

With its diagonal as preconditioner a linear system spreads by a place or two a step. The diagonals of the same energy
for quadratic B-splines of twice, four times … the pitch, added to it, spread what is told at once (Bramble, Pasciak &
Xu 1990); the splines have no kinks, so that their second differences stay small on every grid.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

_FLAGS = {"nsz", "contract"}
_SMALLEST = 8
"""Rows and columns that are not halved any more."""
_SHARE = np.float32(0.25)
"""Weight of the coarser grids, which overlap each other, against the finest."""
_STIFFER = np.float32(1 / 16)
"""Square of the second difference of a function over its square at twice the pitch."""


class Level(NamedTuple):
    """One grid: the inverse of its diagonal (t, s), and the weights (t, 2, 4) that read the next coarser one."""

    inverse: FloatArray
    along: FloatArray


def levels(held: FloatArray, bending: FloatArray, offset: FloatArray) -> list[Level]:
    """Grids from the finest on.

    Parameters
    ----------
    held, bending
        (t, s) diagonal of the system: information of the place itself, and of the second differences.
    offset
        (t,) X of place s = 0 of each row, pitches.
    """
    out = [Level(np.float32(1) / (held + bending), _weights(offset))]
    while min(held.shape) > _SMALLEST:
        held, bending = _sums(held), _STIFFER * _sums(bending)
        out.append(Level(_SHARE / (held + bending), _weights(np.zeros(len(held), dtype=np.float32))))
    return out


def precondition(grids: list[Level], rest: FloatArray) -> FloatArray:
    """Approximate solution (t, s) for a right side, symmetric and positive as a map."""
    sides = [rest]
    for fine, coarse in pairwise(grids):
        side = np.zeros_like(coarse.inverse)
        _gather(sides[-1], fine.along, side)
        sides.append(side)
    found = sides[-1] * grids[-1].inverse
    for grid, side in zip(grids[-2::-1], sides[-2::-1], strict=True):
        finer = side * grid.inverse
        _spread(found, grid.along, finer)
        found = finer
    return found


def _sums(values: FloatArray) -> FloatArray:
    """Sums over 2 × 2 places."""
    rows, columns = values.shape
    even = np.pad(values, ((0, rows % 2), (0, columns % 2)))
    return np.asarray(even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2], dtype=np.float32)


def _weights(offset: FloatArray) -> FloatArray:
    """Weights (t, 2, 4) of the splines i − 1 … i + 2 at the places 2i and 2i + 1 of each row."""
    places = (np.asarray(offset)[:, None] + np.array([0, 1]) - 0.5) / 2
    apart = np.abs(places[..., None] - np.arange(-1, 3))
    inner, outer = 0.75 - apart**2, 0.5 * np.maximum(1.5 - apart, 0) ** 2
    return np.asarray(np.where(apart < 0.5, inner, outer), dtype=np.float32)


_DOWN = _weights(np.zeros(1, dtype=np.float32))[0]


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _spread(coarse, along, fine):  # type: ignore[no-untyped-def]
    """Add the splines with coefficients `coarse` to `fine`; beyond its border the outermost coefficient goes on."""
    last, width = coarse.shape[0] - 1, coarse.shape[1]
    row = np.empty(width + 3, dtype=np.float32)
    for t in range(fine.shape[0]):
        a, b, c, d = _DOWN[t % 2]
        i = t // 2
        r0, r1, r2, r3 = coarse[max(i - 1, 0)], coarse[i], coarse[min(i + 1, last)], coarse[min(i + 2, last)]
        for s in range(width):
            row[s + 1] = a * r0[s] + b * r1[s] + c * r2[s] + d * r3[s]
        row[0], row[width + 1], row[width + 2] = row[1], row[width], row[width]
        for odd in range(2):
            a, b, c, d = along[t, odd]
            out = fine[t, odd::2]
            for s in range(out.shape[0]):
                out[s] += a * row[s] + b * row[s + 1] + c * row[s + 2] + d * row[s + 3]


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _gather(fine, along, coarse):  # type: ignore[no-untyped-def]
    """Transpose of `_spread`: add to `coarse`."""
    last, width = coarse.shape[0] - 1, coarse.shape[1]
    row = np.empty(width + 3, dtype=np.float32)
    part = np.zeros(width, dtype=np.float32)
    for t in range(fine.shape[0]):
        row[:] = 0
        for odd in range(2):
            values = fine[t, odd::2]
            part[-1] = 0
            for s in range(values.shape[0]):
                part[s] = values[s]
            for k in range(4):
                weight = along[t, odd, k]
                if weight != 0:
                    to = row[k : k + width]
                    for s in range(width):
                        to[s] += weight * part[s]
        row[1] += row[0]
        row[width] += row[width + 1] + row[width + 2]
        i = t // 2
        for k in range(4):
            weight = _DOWN[t % 2, k]
            if weight != 0:
                to = coarse[min(max(i + k - 1, 0), last)]
                for s in range(width):
                    to[s] += weight * row[s + 1]
