"""Where between the hypotheses the cost is smallest (METHOD 8.5)."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
CostInterpolation = Literal["none", "parabola", "equiangular", "spline"]
COST_INTERPOLATIONS: tuple[CostInterpolation, ...] = ("none", "parabola", "equiangular", "spline")


def minimum(
    cost: npt.NDArray[np.floating], hypotheses: npt.NDArray[np.floating], method: CostInterpolation = "parabola"
) -> tuple[FloatArray, FloatArray]:
    """Disparity and cost (t, s) of the smallest cost (hypothesis, t, s), refined between equally spaced hypotheses.

    NaN costs never win; a minimum on the border of the range or beside an undefined cost is not refined. Both results
    are NaN where no hypothesis has a cost. ``parabola`` passes through three costs (SSD), ``equiangular`` fits two
    lines of opposite slope (SAD), ``spline`` takes the minimum of the cubic convolution through four.
    """
    if method not in COST_INTERPOLATIONS:
        raise ValueError(f"cost interpolation {method!r} is none of {COST_INTERPOLATIONS}")
    count = cost.shape[0]
    whole = np.where(np.isfinite(cost), cost, np.inf).astype(np.float32)
    best = np.argmin(whole, axis=0)
    lowest = np.take_along_axis(whole, best[None], 0)[0]
    values = np.asarray(hypotheses, dtype=np.float64)
    place = values[best]
    if count >= 3 and method != "none":
        inner = np.clip(best, 1, count - 2)
        around = [np.take_along_axis(whole, (inner + k)[None], 0)[0].astype(np.float64) for k in (-1, 0, 1)]
        with np.errstate(invalid="ignore", divide="ignore"):
            shift = _SHIFT[method](whole, inner, *around)
        good = (best == inner) & np.isfinite(shift)
        place = place + np.where(good, np.clip(np.where(good, shift, 0), -0.5, 0.5), 0) * (values[1] - values[0])
    none = ~np.isfinite(lowest)
    return (
        np.where(none, np.nan, place).astype(np.float32),
        np.where(none, np.nan, lowest).astype(np.float32),
    )


def parabola_shift(low: npt.NDArray[np.float64], mid: npt.NDArray[np.float64], high: npt.NDArray[np.float64]
                   ) -> npt.NDArray[np.float64]:  # fmt: skip
    """Offset of the minimum from the middle of three equally spaced costs, in steps; NaN where they do not bend up."""
    bend = low - 2 * mid + high
    return np.where(bend > 0, 0.5 * (low - high) / np.where(bend > 0, bend, 1), np.nan)


def _parabola(_whole: object, _best: object, low: npt.NDArray[np.float64], mid: npt.NDArray[np.float64],
              high: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:  # fmt: skip
    return parabola_shift(low, mid, high)


def _equiangular(_whole: object, _best: object, low: npt.NDArray[np.float64], mid: npt.NDArray[np.float64],
                 high: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:  # fmt: skip
    rise = np.maximum(low, high) - mid
    return np.where(rise > 0, 0.5 * (low - high) / np.where(rise > 0, rise, 1), np.nan)


def _spline(whole: FloatArray, best: npt.NDArray[np.int64], low: npt.NDArray[np.float64],
            mid: npt.NDArray[np.float64], high: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:  # fmt: skip
    """Minimum of the cubic (Catmull–Rom) curve on the side of the lower neighbour; its slope there is quadratic."""
    right = high < low
    side = np.where(right, 1, -1)
    beyond_at = np.clip(best + 2 * side, 0, whole.shape[0] - 1)
    beyond = np.take_along_axis(whole, beyond_at[None], 0)[0].astype(np.float64)
    near, far = np.where(right, high, low), np.where(right, low, high)
    c1 = 0.5 * (near - far)
    c2 = far - 2.5 * mid + 2 * near - 0.5 * beyond
    c3 = 0.5 * (beyond - far) + 1.5 * (mid - near)
    under = c2 * c2 - 3 * c1 * c3
    # The stable form of the root that is a minimum.
    root = -c1 / (c2 + np.sqrt(np.where(under >= 0, under, np.nan)))
    usable = np.isfinite(root) & (root >= 0) & (root <= 1) & (beyond_at == best + 2 * side)
    return np.where(usable, side * root, parabola_shift(low, mid, high))


_SHIFT = {"parabola": _parabola, "equiangular": _equiangular, "spline": _spline}
