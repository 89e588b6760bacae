"""Same-colour block cost of one pair of mosaicked views (METHOD 8.2), on the lattice as it is.

A lens of the reference view is compared with the place X − d·a of the other view, a = (pair_u, pair_v). Values between
lenses are interpolated inside a row from samples of one colour only; a place between two rows needs that colour in
both. What has no sample of the reference's colour does not count, and a block with too little support has no cost.
"""

from __future__ import annotations

from typing import Literal

import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.kernels.mosaicked.block import block_sum, block_weights
from lfflow.kernels.mosaicked.mosaic_field import MosaicField

FloatArray = npt.NDArray[np.float32]
Interpolation = Literal["nearest", "linear", "cubic", "bandlimited"]
INTERPOLATIONS: tuple[Interpolation, ...] = ("nearest", "linear", "cubic", "bandlimited")
ROW_SLACK = 0.2
"""Fraction of a row by which a place may miss a row and still take its value from that row alone."""


def tap_weights(fraction: float, interpolation: Interpolation) -> FloatArray:
    """Weights of six taps at −2 … 3 for the value at `fraction` in [0, 1); taps that the method does not use are 0."""
    f = fraction
    w = np.zeros(6)
    if interpolation == "nearest":
        w[2 if f < 0.5 else 3] = 1
    elif interpolation == "linear":
        w[2:4] = 1 - f, f
    elif interpolation == "cubic":
        w[1:5] = (
            ((-0.5 * f + 1) * f - 0.5) * f,
            (1.5 * f - 2.5) * f * f + 1,
            ((-1.5 * f + 2) * f + 0.5) * f,
            (0.5 * f - 0.5) * f * f,
        )
    elif interpolation == "bandlimited":
        distance = np.arange(-2, 4) - f
        w = np.sinc(distance) * np.sinc(distance / 3)
        w /= w.sum()
    else:
        raise ValueError(f"interpolation {interpolation!r} is none of {INTERPOLATIONS}")
    if f == 0:
        w[:] = 0
        w[2] = 1
    return w.astype(np.float32)


def pair_cost(
    field: MosaicField,
    pair: tuple[int, int],
    hypotheses: npt.NDArray[np.floating],
    *,
    reference: tuple[int, int] = (0, 0),
    sigma: float = 1.5,
    min_support: float = 0.2,
    interpolation: Interpolation = "cubic",
    rest: float = 0.5,
) -> FloatArray:
    """Mean squared same-colour difference (hypothesis, t, s) between the view `reference` and `reference + pair`.

    Parameters
    ----------
    pair
        Baseline (pair_u, pair_v), view steps.
    hypotheses
        (hypothesis,) disparities, lens pitches per view step.
    sigma
        Standard deviation of the Gaussian block, lens pitches.
    min_support
        Smallest share of the block that must have been compared; below it the cost is NaN.
    interpolation
        How a place between the lenses of a row is read.
    rest
        Largest difference of the rounding residuals rho of two compared lenses, sensor pixels; more means that the
        rounding has wrapped between them and that their baseline is off by a whole pixel.
    """
    mine = field.view(*reference)
    other = field.view(reference[0] + pair[0], reference[1] + pair[1])
    blocks = block_weights(sigma, field.row_pitch, brick=field.brick)
    out = np.empty((len(hypotheses), *mine[0].shape), dtype=np.float32)
    for h, d in enumerate(np.asarray(hypotheses, dtype=np.float64)):
        error, support = squared_error(field, mine, other, pair, float(d), interpolation, rest)
        weight = block_sum(support, field.offset, *blocks)
        total = block_sum(error, field.offset, *blocks)
        out[h] = np.where(weight >= min_support, total / np.maximum(weight, 1e-6), np.float32(np.nan))
    return out


def pair_support(field: MosaicField, pair: tuple[int, int], shifts: tuple[float, ...] = (0.0, 0.5, 1.0)) -> float:
    """Share of the lenses of view (0, 0) that meet their own colour in view `pair`, mean over shifts in lenses."""
    mine = field.view(0, 0)
    other = field.view(*pair)
    there = max(int((mine[1] != CFA_NONE).sum()), 1)
    found = 0.0
    for shift in shifts:
        d = shift / max(abs(pair[0]), abs(pair[1]))
        _, support = squared_error(field, mine, other, pair, d, "linear", 0.5)
        found += float((support > 0).sum()) / there
    return found / len(shifts)


def squared_error(
    field: MosaicField,
    mine: tuple[npt.NDArray[np.generic], ...],
    other: tuple[npt.NDArray[np.generic], ...],
    pair: tuple[int, int],
    d: float,
    interpolation: Interpolation,
    rest: float,
) -> tuple[FloatArray, FloatArray]:
    """Weighted squared differences and their weights (t, s) of one hypothesis, before the block."""
    down = -d * pair[1] / field.row_pitch
    first = int(np.floor(down))
    fraction = down - first
    if fraction < ROW_SLACK:
        share = 0.0
    elif fraction > 1 - ROW_SLACK:
        first, share = first + 1, 0.0
    else:
        share = fraction
    rows = len(field.offset)
    columns: list[npt.NDArray[np.int64]] = []
    weights: list[FloatArray] = []
    for lower in (0, 1):
        target = np.clip(np.arange(rows) + first + lower, 0, rows - 1)
        across = -d * pair[0] + field.offset - field.offset[target]
        across = np.where(np.abs(across - np.rint(across)) < 1e-6, np.rint(across), across)
        start = np.floor(across).astype(np.int64)
        columns.append(start)
        fractions, of_row = np.unique(across - start, return_inverse=True)  # two at most: rows lie at 0 or ½
        weights.append(np.stack([tap_weights(float(f), interpolation) for f in fractions])[of_row])
    error = np.zeros(mine[0].shape, dtype=np.float32)
    support = np.zeros(mine[0].shape, dtype=np.float32)
    _compare(mine, other, field.rho, first, np.float32(share), np.stack(columns), np.stack(weights), np.float32(rest),
             error, support)  # fmt: skip
    return error, support


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _tap(value, colour, weight, rho_x, rho_y, mine, wanted, here_x, here_y, share, rest, total, confidence):  # type: ignore[no-untyped-def]
    """Add one tap of each place of a row, less the place's own value `mine` (exactly 0 where they are equal).

    The confidence becomes 0 where the tap is missing, of another colour, or beyond a wrap of the rounding.
    """
    for s in range(mine.shape[0]):
        total[s] += share * (value[s] - mine[s])
        other = abs(rho_x[s] - here_x[s]) > rest or abs(rho_y[s] - here_y[s]) > rest or colour[s] != wanted[s]
        confidence[s] = np.float32(0) if other else min(confidence[s], weight[s])


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _compare(mine, other, rho, first, share, starts, taps, rest, error, support):  # type: ignore[no-untyped-def]
    value_a, colour_a, weight_a = mine
    value_b, colour_b, weight_b = other
    rows, columns = value_a.shape
    level = starts.shape[0] if share > 0 else 1
    for t in range(rows):
        if t + first < 0 or t + first + level > rows:
            continue
        # Rows differ in rho by design of the lattice; only inside one row does a jump mean a wrap.
        limit = rest if first == 0 and level == 1 else np.float32(2)
        total, confidence = error[t], support[t]
        confidence[:] = weight_a[t]
        for lower in range(level):
            row = t + first + lower
            part = share if lower else np.float32(1) - share
            for k in range(taps.shape[2]):
                if taps[lower, t, k] == 0:
                    continue
                shift = starts[lower, t] + k - 2
                low, high = min(max(0, -shift), columns), max(min(columns, columns - shift), 0)
                confidence[:low] = 0
                confidence[high:] = 0
                if low >= high:
                    continue
                there = slice(low + shift, high + shift)
                _tap(value_b[row, there], colour_b[row, there], weight_b[row, there], rho[0, row, there],
                     rho[1, row, there], value_a[t, low:high], colour_a[t, low:high], rho[0, t, low:high],
                     rho[1, t, low:high], part * taps[lower, t, k], limit, total[low:high],
                     confidence[low:high])  # fmt: skip
        for s in range(columns):
            total[s] *= total[s] * confidence[s]
