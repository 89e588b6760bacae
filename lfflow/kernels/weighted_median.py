"""The weighted median of a few values, inside of other kernels."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(nogil=True, cache=True)
def weighted_median(value, weight):  # type: ignore[no-untyped-def]
    """Smallest of the values (n,) up to which half of the weights (n,) lie."""
    half, so_far = weight.sum() / 2, 0.0
    for k in np.argsort(value):
        so_far += weight[k]
        if so_far >= half:
            return value[k]
    return value[0]
