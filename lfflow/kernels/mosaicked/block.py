"""Gaussian block sums on the brick layout: isotropic in lens pitches, whatever the half-lens offset of the rows."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]


def block_weights(sigma: float, row_pitch: float, *, brick: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights of a Gaussian block of `sigma` lens pitches cut at 3 sigma.

    Returns the in-row weights at whole offsets, the in-row weights at half offsets (−n+½ … n−½; equal to the whole ones
    on a square lattice) and the weights of the rows; the block sums to 1.
    """
    half = max(1, math.ceil(2.5 * sigma))
    rows = max(1, math.ceil(2.5 * sigma / row_pitch))
    whole = np.exp(-0.5 * (np.arange(-half, half + 1) / sigma) ** 2)
    between = np.exp(-0.5 * ((np.arange(-half, half) + 0.5) / sigma) ** 2) if brick else whole
    down = np.exp(-0.5 * (np.arange(-rows, rows + 1) * row_pitch / sigma) ** 2)
    return _unit(whole), _unit(between), _unit(down)


def _unit(weights: npt.NDArray[np.float64]) -> FloatArray:
    unit: FloatArray = (weights / weights.sum()).astype(np.float32)
    return unit


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _along(padded, start, weights, out):  # type: ignore[no-untyped-def]
    """Row of the weighted sums from `start` on, four weights at a time: what is read and written counts most."""
    columns, taps = out.shape[0], weights.shape[0]
    out[:] = 0
    for k in range(0, taps - 3, 4):
        a, b, c, d = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
        part = padded[start + k : start + k + columns + 3]
        for s in range(columns):
            out[s] += a * part[s] + b * part[s + 1] + c * part[s + 2] + d * part[s + 3]
    for k in range(taps - taps % 4, taps):
        part = padded[start + k : start + k + columns]
        for s in range(columns):
            out[s] += weights[k] * part[s]


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _add(out, part, w, other, v):  # type: ignore[no-untyped-def]
    for s in range(out.shape[0]):
        out[s] += w * part[s] + v * other[s]


@numba.njit(nogil=True, cache=True)
def block_sum(image, offset, whole, between, down):  # type: ignore[no-untyped-def]
    """Block sums (t, s) of an image (t, s) whose row t starts at X = offset[t]; outside counts as 0."""
    rows, columns = image.shape
    margin = whole.shape[0] // 2 + 1
    deep = down.shape[0] // 2
    brick = between.shape[0] != whole.shape[0]
    # Rows of the sums along the row: at the lenses of the row itself, and at those of the rows half a lens aside.
    lines = np.zeros((2, rows + 2 * deep + 1, columns), dtype=np.float32)
    padded = np.zeros(columns + 2 * margin, dtype=np.float32)
    for t in range(rows):
        padded[margin : margin + columns] = image[t]
        _along(padded, 1, whole, lines[0, t + deep])
        if brick:
            _along(padded, 1 if offset[t] > 0 else 2, between, lines[1, t + deep])
    out = np.zeros((rows, columns), dtype=np.float32)
    for t in range(rows):
        for k in range(0, 2 * deep + 1, 2):
            first, after = t + k, t + k + 1
            v = down[k + 1] if k < 2 * deep else np.float32(0)
            _add(out[t], lines[_aside(offset, t, first - deep), first], down[k],
                 lines[_aside(offset, t, after - deep), after], v)  # fmt: skip
    return out


@numba.njit(nogil=True, cache=True, inline="always")
def _aside(offset, t, other):  # type: ignore[no-untyped-def]
    """1 where the lenses of row `other` lie half a lens aside of those of row t; rows outside are empty."""
    return 1 if 0 <= other < offset.shape[0] and offset[other] != offset[t] else 0
