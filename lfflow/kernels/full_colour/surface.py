"""Variational surface: little curvature, through what is known of each place and as well as it is known.

Minimises Σ w (d − d*)² + Σ g (second difference of d along each lattice axis)², where d* is a place's own disparity
with information w, and g falls with the guide's edges and with the present second difference (so that jumps stay).
Where nothing is known (w ≈ 0) the surface continues its surroundings.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

_FLAGS = {"nsz", "contract"}
# (t, s) of the neighbour before and of the one after, along each axis
_AXES = np.array([[0, -1, 0, 1], [-1, 0, 1, 0], [-1, -1, 1, 1], [-1, 1, 1, -1]])
_ANCHOR = np.float32(1e-3)
"""Information with which the start is held: what nothing else decides stays there."""


def fit_surface(
    target: FloatArray,
    information: FloatArray,
    start: FloatArray,
    guide: FloatArray,
    *,
    stiffness: float,
    jump: float = 0.08,
    edge: float = 0.05,
    rounds: int = 2,
    iterations: int = 60,
) -> FloatArray:
    """Disparity (t, s) of the surface.

    Parameters
    ----------
    target, information
        (t, s) disparity of each place by itself, and its 1/variance.
    start
        (t, s) first disparity.
    guide
        (t, s, channel) picture whose edges (in units of `edge`) loosen the surface.
    stiffness
        1/variance of the second difference on a surface.
    jump
        Second difference at which the surface may break.
    rounds, iterations
        How often the bonds follow the surface, and steps of conjugate gradients each time.
    """
    d = np.array(start, dtype=np.float32)
    picture = np.ascontiguousarray(guide, dtype=np.float32)
    held = np.asarray(information, dtype=np.float32) + _ANCHOR
    for _ in range(rounds):
        bond = _bonds(d, picture, _AXES, np.float32(stiffness), np.float32(jump), np.float32(edge))
        _solve(d, held, information * target + _ANCHOR * d, bond, _AXES, iterations)
    return d


@numba.njit(nogil=True, cache=True)
def _bonds(d, guide, axes, stiffness, jump, edge):  # type: ignore[no-untyped-def]
    rows, columns, channels = guide.shape
    count = axes.shape[0]
    bond = np.zeros((count, rows, columns), dtype=np.float32)
    for k in range(count):
        for t in range(1, rows - 1):
            t0, s0, t1, s1 = axes[k]
            for s in range(1, columns - 1):
                bend = d[t + t0, s + s0] - 2 * d[t, s] + d[t + t1, s + s1]
                change = np.float32(0)
                for c in range(channels):
                    here = guide[t, s, c]
                    change += max(abs(guide[t + t0, s + s0, c] - here), abs(guide[t + t1, s + s1, c] - here))
                change /= channels * edge
                robust = np.float32(1) + (bend / jump) ** 2
                bond[k, t, s] = stiffness / (robust * robust) / (np.float32(1) + change * change)
    return bond


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _apply(d, weight, bond, axes, out):  # type: ignore[no-untyped-def]
    rows, columns = d.shape
    for t in range(rows):
        for s in range(columns):
            out[t, s] = weight[t, s] * d[t, s]
    for k in range(axes.shape[0]):
        for t in range(1, rows - 1):
            t0, s0, t1, s1 = axes[k]
            before, here, after = d[t + t0], d[t], d[t + t1]
            to_before, to_here, to_after = out[t + t0], out[t], out[t + t1]
            for s in range(1, columns - 1):
                force = bond[k, t, s] * (before[s + s0] - 2 * here[s] + after[s + s1])
                to_before[s + s0] += force
                to_here[s] -= 2 * force
                to_after[s + s1] += force


@numba.njit(nogil=True, cache=True)
def _diagonal(weight, bond, axes):  # type: ignore[no-untyped-def]
    rows, columns = weight.shape
    diagonal = weight.copy()
    for k in range(axes.shape[0]):
        for t in range(1, rows - 1):
            t0, s0, t1, s1 = axes[k]
            for s in range(1, columns - 1):
                diagonal[t, s] += 4 * bond[k, t, s]
                diagonal[t + t0, s + s0] += bond[k, t, s]
                diagonal[t + t1, s + s1] += bond[k, t, s]
    return diagonal


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for t in range(a.shape[0]):
        for s in range(a.shape[1]):
            total += a[t, s] * b[t, s]
    return total


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _solve(d, weight, pull, bond, axes, iterations):  # type: ignore[no-untyped-def]
    """Conjugate gradients with the diagonal as preconditioner, started from `d`, in place."""
    rows, columns = d.shape
    diagonal = _diagonal(weight, bond, axes)
    product = np.empty_like(d)
    _apply(d, weight, bond, axes, product)
    rest = pull - product
    way = rest / diagonal
    energy = _dot(rest, way)
    for _ in range(iterations):
        _apply(way, weight, bond, axes, product)
        bend = _dot(way, product)
        if bend <= 0 or energy <= 0:
            return
        length = np.float32(energy / bend)
        fresh = 0.0
        for t in range(rows):
            for s in range(columns):
                d[t, s] += length * way[t, s]
                rest[t, s] -= length * product[t, s]
                fresh += rest[t, s] * rest[t, s] / diagonal[t, s]
        keep = np.float32(fresh / energy)
        energy = fresh
        for t in range(rows):
            for s in range(columns):
                way[t, s] = rest[t, s] / diagonal[t, s] + keep * way[t, s]
