"""Scores of a disparity map against ground truth, as the HCI 4D Light Field Benchmark counts them."""

from __future__ import annotations

import numpy as np
import xarray as xr

THRESHOLDS = (0.07, 0.03, 0.01)
BORDER = 15


def scores(disparity: xr.DataArray, truth: xr.DataArray, *, border: int = BORDER) -> dict[str, float]:
    """BadPix (percent of errors above 0.07, 0.03, 0.01), mean squared error × 100 and Q25 of disparity (t, s).

    Parameters
    ----------
    disparity, truth
        (t, s), pixels per view step. Places without truth are left out; places without disparity count as wrong, with
        an error of the truth's whole range.
    border
        Pixels left out at each side.

    Returns
    -------
    ``badpix_007``, ``badpix_003``, ``badpix_001`` (percent), ``mse_100``, and ``q25``: 100 × the largest error of the
    best quarter of the pixels. NaN where no place is left to be scored.
    """
    expected = truth.transpose("t", "s").to_numpy()
    error = np.abs(disparity.transpose("t", "s").to_numpy().astype(np.float64) - expected)
    error = error[border : error.shape[0] - border, border : error.shape[1] - border]
    expected = expected[border : expected.shape[0] - border, border : expected.shape[1] - border]
    known = np.isfinite(expected)
    if not known.any():
        return dict.fromkeys((*(_name(limit) for limit in THRESHOLDS), "mse_100", "q25"), float("nan"))
    missing = float(np.ptp(expected[known])) or 1.0
    values = np.where(np.isfinite(error), error, missing)[known]
    result = {_name(limit): 100 * float(np.mean(values > limit)) for limit in THRESHOLDS}
    result["mse_100"] = 100 * float(np.mean(values**2))
    result["q25"] = 100 * float(np.percentile(values, 25))
    return result


def _name(limit: float) -> str:
    return f"badpix_{round(100 * limit):03d}"
