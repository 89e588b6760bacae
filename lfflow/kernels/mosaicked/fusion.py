"""One disparity from many pairs (METHOD 8.2)."""

from __future__ import annotations

from typing import Literal

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.mosaicked.subpixel import minimum

FloatArray = npt.NDArray[np.float32]
Fusion = Literal["trimmed", "mean", "opposite", "median", "inverse_variance"]
FUSIONS: tuple[Fusion, ...] = ("trimmed", "mean", "opposite", "median", "inverse_variance")
STRETCH = 512
"""Places that are sorted side by side."""


def weighted_median(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Lower weighted median (t, s) of values (pair, t, s); NaN values and weights of 0 do not count, NaN if none does.

    The result is always one of the values, never the mean of two that an occlusion separates (METHOD pitfall 11).
    """
    use = np.isfinite(values) & (weights > 0)
    key = np.where(use, values, np.inf)
    order = np.argsort(key, axis=0, kind="stable")
    ordered = np.take_along_axis(key, order, 0)
    share = np.cumsum(np.take_along_axis(np.where(use, weights, 0), order, 0), axis=0, dtype=np.float64)
    at = np.argmax(share >= 0.5 * share[-1], axis=0)
    found = np.take_along_axis(ordered, at[None], 0)[0]
    return np.where(share[-1] > 0, found, np.nan).astype(np.float32)


def spread(values: FloatArray, weights: FloatArray, middle: FloatArray) -> FloatArray:
    """Weighted standard deviation (t, s) of values (pair, t, s) about `middle`; NaN where fewer than two count."""
    use = np.isfinite(values) & (weights > 0) & np.isfinite(middle)
    w = np.where(use, weights, 0).astype(np.float64)
    square = np.where(use, (values - np.where(np.isfinite(middle), middle, 0)) ** 2, 0)
    total = w.sum(axis=0)
    several = use.sum(axis=0) >= 2
    return np.where(several, np.sqrt((w * square).sum(axis=0) / np.where(total > 0, total, 1)), np.nan).astype(
        np.float32
    )


def trimmed_sum(costs: FloatArray, keep: float = 0.75) -> FloatArray:
    """Mean (hypothesis, t, s) of the smallest share `keep` of the costs (pair, hypothesis, t, s); NaN where none."""
    flat = np.ascontiguousarray(costs.reshape(costs.shape[0], -1), dtype=np.float32)
    out: FloatArray = np.empty(flat.shape[1], dtype=np.float32)
    _trim(flat, keep, out)
    shaped: FloatArray = out.reshape(costs.shape[1:])
    return shaped


@numba.njit(nogil=True, cache=True)
def _trim(costs: FloatArray, keep: float, out: FloatArray) -> None:
    pairs, places = costs.shape
    ordered = np.empty((pairs, STRETCH), dtype=np.float32)
    shares = np.array([max(1.0, np.ceil(keep * count)) for count in range(pairs + 1)], dtype=np.float32)
    for start in range(0, places, STRETCH):
        width = min(STRETCH, places - start)
        for k in range(pairs):
            for n in range(width):
                value = costs[k, start + n]
                ordered[k, n] = value if np.isfinite(value) else np.float32(np.inf)
        for last in range(pairs - 1, 0, -1):
            for k in range(last):
                _order(ordered[k, :width], ordered[k + 1, :width])
        for n in range(width):
            count = 0
            for k in range(pairs):
                count += ordered[k, n] < np.inf
            kept = shares[count]
            total = np.float32(0)
            for k in range(min(int(kept), count)):
                total += ordered[k, n]
            out[start + n] = total / kept if count > 0 else np.nan


@numba.njit(nogil=True, cache=True)
def _order(lower, upper):  # type: ignore[no-untyped-def]
    """Exchange the numbers of both rows where the first is the larger."""
    for n in range(lower.shape[0]):
        a, b = lower[n], upper[n]
        lower[n], upper[n] = min(a, b), max(a, b)


def fuse_costs(costs: FloatArray, hypotheses: npt.NDArray[np.floating], fusion: Fusion) -> FloatArray:
    """One cost (hypothesis, t, s) of the costs (pair, hypothesis, t, s) of pairs or of sides of the aperture.

    ``trimmed`` leaves out the worst quarter, ``mean`` none, ``opposite`` the worse half (an edge hides a point from one
    side), ``inverse_variance`` weighs each pair by the bend of its cost at its minimum over that minimum, which is the
    inverse of the variance of its place. ``median`` takes the distance from the middle of the places of the single
    minima, and their spread about it: a disparity, where the others are squared differences.
    """
    if fusion == "median":
        each = np.stack([minimum(cost, hypotheses)[0] for cost in costs])
        known = np.isfinite(each).astype(np.float32)
        middle = weighted_median(each, known)
        labels = np.asarray(hypotheses, dtype=np.float32)[:, None, None]
        away: FloatArray = np.abs(labels - middle) + np.nan_to_num(spread(each, known, middle))
        return away
    if fusion == "inverse_variance":
        return _weighted(costs)
    if fusion not in FUSIONS:
        raise ValueError(f"fusion {fusion!r} is none of {FUSIONS}")
    return trimmed_sum(costs, {"trimmed": 0.75, "mean": 1.0, "opposite": 0.5}[fusion])


def _weighted(costs: FloatArray) -> FloatArray:
    whole = np.where(np.isfinite(costs), costs, np.inf)
    inner = np.clip(np.argmin(whole, axis=1), 1, costs.shape[1] - 2)[:, None]
    low, mid, high = (np.take_along_axis(whole, inner + k, 1) for k in (-1, 0, 1))
    with np.errstate(invalid="ignore"):
        bend = low - 2 * mid + high
        weight = np.where(np.isfinite(bend) & (bend > 0), bend / (mid + 1e-6), 0)
    use = np.isfinite(costs) & (weight > 0)
    total = (use * weight).sum(axis=0)
    value = np.where(use, costs * weight, 0).sum(axis=0)
    return np.where(total > 0, value / np.where(total > 0, total, 1), np.nan).astype(np.float32)
