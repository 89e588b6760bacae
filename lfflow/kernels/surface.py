"""Variational surface: little curvature, through what each place tells and as well as it tells it.

Minimises Σ w (d − d*)² + Σ g (second difference of d along each axis of neighbours)². d* is what a place tells by
itself, w the inverse of its variance; g falls where the picture has an edge and where the present surface bends, so
that steps stay. What tells nothing (w ≈ 0) continues its surroundings. The axes are the rows of lenses of the brick
layout, or the rows, columns and diagonals of the square one, so that a plane has no curvature and nothing is resampled.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.coarser import levels, precondition

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

_FLAGS = {"nsz", "contract"}
_ANCHOR = np.float32(1e-3)
"""Information with which the start is held: what nothing else decides stays there."""
_ACROSS, _DOWN, _FALLING, _RISING = (0, -1, 0, 1), (-1, 0, 1, 0), (-1, -1, 1, 1), (-1, 1, 1, -1)
_OUTWARD = (-1, 0, 1, 1)
"""Axis of the rows of the brick layout that lie half a lens to the right."""


def square_axes(rows: int) -> IntArray:
    """Axes (t, axis, 4) of the square grid: its rows, columns and diagonals; see `lattice_axes`."""
    return np.tile(np.array([_ACROSS, _DOWN, _FALLING, _RISING]), (rows, 1, 1))


def lattice_axes(offset: FloatArray) -> IntArray:
    """Rows and columns, relative to a lens, of its neighbours on both sides along each row of lenses.

    Parameters
    ----------
    offset
        (t,) X of lens s=0 of each row, lens pitches.

    Returns
    -------
    (t, axis, 4): row and column of the one neighbour, row and column of the other; three axes of the brick layout, two
    of the square one.
    """
    if offset.max() == offset.min():
        return np.tile(np.array([_ACROSS, _DOWN]), (len(offset), 1, 1))
    inner, outer = (
        np.array([_ACROSS, (-1, -1, 1, 0), (-1, 0, 1, -1)]),
        np.array([_ACROSS, _OUTWARD, (-1, 1, 1, 0)]),
    )
    return np.where((offset == offset.max())[:, None, None], outer, inner)


def fit_surface(
    target: FloatArray,
    information: FloatArray,
    start: FloatArray,
    guide: FloatArray,
    axes: IntArray,
    *,
    stiffness: float,
    jump: float | FloatArray,
    edge: float,
    rounds: int = 1,
    iterations: int = 40,
) -> FloatArray:
    """Disparity (t, s) of the surface; NaN where `start` is.

    Parameters
    ----------
    target, information
        (t, s) disparity that each place tells by itself, and its 1/variance.
    start
        (t, s) first disparity.
    guide
        (t, s, channel) picture of the same view.
    axes
        `lattice_axes` or `square_axes`.
    stiffness
        1/variance of the second difference on a surface.
    jump
        Second difference at which the surface may break, for all or (t, s): what has no texture knows of no step.
    edge
        Mean change of the picture, over the channels, that loosens the surface to half.
    rounds, iterations
        How often the bonds follow the surface, and steps of conjugate gradients each time.
    """
    known = np.isfinite(start)
    if not known.any():
        return start
    d = np.where(known, start, np.median(start[known])).astype(np.float32)
    held = np.where(known, information, 0).astype(np.float32)
    told = held * np.where(known, target, 0).astype(np.float32)
    picture = np.ascontiguousarray(guide, dtype=np.float32)
    bends = np.broadcast_to(np.square(np.asarray(jump, dtype=np.float32)), d.shape)
    for _ in range(rounds):
        bonds = _bonds(d, picture, axes, np.float32(stiffness), bends, np.float32(edge))
        _solve(d, held + _ANCHOR, told + _ANCHOR * d, bonds, axes, iterations)
    return np.where(known, d, np.float32(np.nan))


@numba.njit(nogil=True, cache=True)
def _bonds(d, guide, axes, stiffness, bends, edge):  # type: ignore[no-untyped-def]
    rows, columns, channels = guide.shape
    out = np.zeros((axes.shape[1], rows, columns), dtype=np.float32)
    for axis in range(axes.shape[1]):
        for t in range(1, rows - 1):
            t0, s0, t1, s1 = axes[t, axis]
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
def _apply(d, held, bonds, axes, out):  # type: ignore[no-untyped-def]
    """Half the gradient of the energy, without the pull."""
    rows, columns = d.shape
    count = columns - 2
    force = np.empty(count, dtype=np.float32)
    out[:] = held * d
    for t in range(1, rows - 1):
        for axis in range(bonds.shape[0]):
            t0, s0, t1, s1 = axes[t, axis]
            before, here, after = d[t + t0, 1 + s0 :], d[t, 1:], d[t + t1, 1 + s1 :]
            bond = bonds[axis, t, 1:]
            for s in range(count):
                force[s] = bond[s] * (before[s] - 2 * here[s] + after[s])
            _add(force, np.float32(1), out[t + t0, 1 + s0 :])
            _add(force, np.float32(-2), out[t, 1:])
            _add(force, np.float32(1), out[t + t1, 1 + s1 :])


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _add(values, factor, out):  # type: ignore[no-untyped-def]
    for s in range(values.shape[0]):
        out[s] += factor * values[s]


@numba.njit(nogil=True, cache=True)
def _bending(bonds, axes):  # type: ignore[no-untyped-def]
    """Diagonal (t, s) of the second differences."""
    out = np.zeros(bonds.shape[1:], dtype=np.float32)
    rows, columns = out.shape
    for axis in range(bonds.shape[0]):
        for t in range(1, rows - 1):
            t0, s0, t1, s1 = axes[t, axis]
            for s in range(1, columns - 1):
                out[t, s] += 4 * bonds[axis, t, s]
                out[t + t0, s + s0] += bonds[axis, t, s]
                out[t + t1, s + s1] += bonds[axis, t, s]
    return out


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS | {"reassoc"})
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for t in range(a.shape[0]):
        row = np.float32(0)
        for s in range(a.shape[1]):
            row += a[t, s] * b[t, s]
        total += float(row)
    return total


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _go(length, way, product, d, rest):  # type: ignore[no-untyped-def]
    """Go along `way` in place, and take from `rest` what that does."""
    for t in range(d.shape[0]):
        for s in range(d.shape[1]):
            d[t, s] += length * way[t, s]
            rest[t, s] -= length * product[t, s]


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _turn(keep, fresh, way):  # type: ignore[no-untyped-def]
    for t in range(way.shape[0]):
        for s in range(way.shape[1]):
            way[t, s] = fresh[t, s] + keep * way[t, s]


def _solve(
    d: FloatArray, held: FloatArray, pull: FloatArray, bonds: FloatArray, axes: IntArray, iterations: int
) -> None:
    """Conjugate gradients with `precondition`, started from `d`, in place."""
    grids = levels(held, _bending(bonds, axes), _offset(axes))
    product = np.empty_like(d)
    _apply(d, held, bonds, axes, product)
    rest = pull - product
    way = precondition(grids, rest)
    energy = _dot(rest, way)
    for _ in range(iterations):
        _apply(way, held, bonds, axes, product)
        bend = _dot(way, product)
        if bend <= 0 or energy <= 0:
            return
        _go(np.float32(energy / bend), way, product, d, rest)
        fresh = precondition(grids, rest)
        before, energy = energy, _dot(rest, fresh)
        _turn(np.float32(energy / before), fresh, way)


def _offset(axes: IntArray) -> FloatArray:
    """X (t,) of place s = 0 of each row: half a pitch where a row's nearest places below are s and s + 1."""
    return np.where((axes[:, 1] == _OUTWARD).all(axis=-1), np.float32(0.5), np.float32(0))
