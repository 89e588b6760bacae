"""Variational surface on the lattice: little curvature, through what each lens tells and as well as it tells it.

Minimises Σ w (d − d*)² + Σ g (second difference of d along each row of lenses)². d* is what a lens tells by itself, w
the inverse of its variance; g falls where the picture has an edge and where the present surface bends, so that steps
stay. What tells nothing (w ≈ 0) continues its surroundings. The rows of lenses are the three of the brick layout or the
two of the square one, so that a plane has no curvature and nothing is resampled.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

_FLAGS = {"nsz", "contract"}
_ANCHOR = np.float32(1e-3)
"""Information with which the start is held: what nothing else decides stays there."""


def lattice_surface(
    target: FloatArray,
    information: FloatArray,
    start: FloatArray,
    guide: FloatArray,
    offset: FloatArray,
    *,
    doubt: FloatArray,
    edge: float,
    stiffness: float = 2e4,
    jump: float = 0.03,
    iterations: int = 60,
) -> FloatArray:
    """Disparity (t, s) of the surface; NaN where `start` is.

    Parameters
    ----------
    target, information
        (t, s) disparity that each lens tells by itself, and its 1/variance.
    start
        (t, s) first disparity.
    guide
        (t, s, channel) picture of the same view.
    offset
        (t,) X of lens s=0 of each row, lens pitches.
    doubt
        (t, s) by how much more it may bend without breaking: what has no texture knows of no step.
    edge
        Mean change of the picture, over the channels, that loosens the surface to half.
    stiffness
        1/variance of the second difference on a surface.
    jump
        Second difference at which the surface may break.
    iterations
        Steps of conjugate gradients.
    """
    known = np.isfinite(start)
    if not known.any():
        return start
    first = np.where(known, start, np.median(start[known])).astype(np.float32)
    held = np.where(known, information, 0).astype(np.float32)
    pull = held * np.where(known, target, 0).astype(np.float32) + _ANCHOR * first
    place = np.ascontiguousarray(offset, dtype=np.float32)
    bends = (np.float32(jump**2) + np.asarray(doubt, dtype=np.float32) ** 2).astype(np.float32)
    bonds = _bonds(first, np.ascontiguousarray(guide, dtype=np.float32), place, np.float32(stiffness), bends,
                   np.float32(edge))  # fmt: skip
    _solve(first, held + _ANCHOR, pull, bonds, place, iterations)
    return np.where(known, first, np.float32(np.nan))


@numba.njit(nogil=True, cache=True, inline="always")
def _sides(axis, t, offset):  # type: ignore[no-untyped-def]
    """Rows and columns, relative to a lens of row t, of its neighbours on both sides along an axis."""
    if axis == 0:
        return 0, -1, 0, 1
    if offset[t] == offset[t - 1]:
        return -1, 0, 1, 0
    left = -1 if offset[t] < offset[t - 1] else 0
    return (-1, left, 1, left + 1) if axis == 1 else (-1, left + 1, 1, left)


@numba.njit(nogil=True, cache=True)
def _bonds(d, guide, offset, stiffness, bends, edge):  # type: ignore[no-untyped-def]
    rows, columns, channels = guide.shape
    axes = 3 if offset.max() > offset.min() else 2
    out = np.zeros((axes, rows, columns), dtype=np.float32)
    for axis in range(axes):
        for t in range(1, rows - 1):
            t0, s0, t1, s1 = _sides(axis, t, offset)
            for s in range(1, columns - 1):
                bend = d[t + t0, s + s0] - 2 * d[t, s] + d[t + t1, s + s1]
                change = np.float32(0)
                for c in range(channels):
                    here = guide[t, s, c]
                    change += max(abs(guide[t + t0, s + s0, c] - here), abs(guide[t + t1, s + s1, c] - here))
                change /= channels * edge
                robust = np.float32(1) + bend * bend / bends[t, s]
                out[axis, t, s] = stiffness / (robust * robust) / (np.float32(1) + change * change)
    return out


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _apply(d, held, bonds, offset, out):  # type: ignore[no-untyped-def]
    """Half the gradient of the energy, without the pull."""
    rows, columns = d.shape
    out[:] = held * d
    for axis in range(bonds.shape[0]):
        for t in range(1, rows - 1):
            t0, s0, t1, s1 = _sides(axis, t, offset)
            before, here, after = d[t + t0], d[t], d[t + t1]
            to_before, to_here, to_after = out[t + t0], out[t], out[t + t1]
            for s in range(1, columns - 1):
                force = bonds[axis, t, s] * (before[s + s0] - 2 * here[s] + after[s + s1])
                to_before[s + s0] += force
                to_here[s] -= 2 * force
                to_after[s + s1] += force


@numba.njit(nogil=True, cache=True)
def _diagonal(held, bonds, offset):  # type: ignore[no-untyped-def]
    rows, columns = held.shape
    out = held.copy()
    for axis in range(bonds.shape[0]):
        for t in range(1, rows - 1):
            t0, s0, t1, s1 = _sides(axis, t, offset)
            for s in range(1, columns - 1):
                out[t, s] += 4 * bonds[axis, t, s]
                out[t + t0, s + s0] += bonds[axis, t, s]
                out[t + t1, s + s1] += bonds[axis, t, s]
    return out


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for t in range(a.shape[0]):
        row = np.float32(0)
        for s in range(a.shape[1]):
            row += a[t, s] * b[t, s]
        total += float(row)
    return total


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _solve(d, held, pull, bonds, offset, iterations):  # type: ignore[no-untyped-def]
    """Conjugate gradients with the diagonal as preconditioner, started from `d`, in place."""
    rows, columns = d.shape
    inverse = np.float32(1) / _diagonal(held, bonds, offset)
    product = np.empty_like(d)
    _apply(d, held, bonds, offset, product)
    rest = pull - product
    way = rest * inverse
    energy = _dot(rest, way)
    for _ in range(iterations):
        _apply(way, held, bonds, offset, product)
        bend = _dot(way, product)
        if bend <= 0 or energy <= 0:
            return
        length = np.float32(energy / bend)
        for t in range(rows):
            for s in range(columns):
                d[t, s] += length * way[t, s]
                rest[t, s] -= length * product[t, s]
        fresh = _dot(rest, rest * inverse)
        keep = np.float32(fresh / energy)
        energy = fresh
        for t in range(rows):
            for s in range(columns):
                way[t, s] = rest[t, s] * inverse[t, s] + keep * way[t, s]
