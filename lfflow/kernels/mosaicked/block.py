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
def _add(out, part, w):  # type: ignore[no-untyped-def]
    for s in range(out.shape[0]):
        out[s] += w * part[s]


@numba.njit(nogil=True, cache=True)
def block_sum(image, offset, whole, between, down):  # type: ignore[no-untyped-def]
    """Block sums (t, s) of an image (t, s) whose row t starts at X = offset[t]; outside counts as 0."""
    rows, columns = image.shape
    reach = whole.shape[0] // 2
    margin = reach + 1
    here = np.zeros((rows, columns), dtype=np.float32)
    aside = np.zeros((rows, columns), dtype=np.float32)
    padded = np.zeros(columns + 2 * margin, dtype=np.float32)
    brick = between.shape[0] != whole.shape[0]
    for t in range(rows):
        padded[margin : margin + columns] = image[t]
        for k in range(whole.shape[0]):
            _add(here[t], padded[1 + k : 1 + k + columns], whole[k])
        if brick:
            start = 1 if offset[t] > 0 else 2
            for k in range(between.shape[0]):
                _add(aside[t], padded[start + k : start + k + columns], between[k])
    out = np.zeros((rows, columns), dtype=np.float32)
    deep = down.shape[0] // 2
    for t in range(rows):
        for other in range(max(0, t - deep), min(rows, t + deep + 1)):
            part = here[other] if offset[other] == offset[t] else aside[other]
            _add(out[t], part, down[other - t + deep])
    return out
