"""A picture between four lenses, linearly: enough for what is averaged afterwards."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(nogil=True, cache=True, inline="always")
def read_between(picture, offset, x, y, c):  # type: ignore[no-untyped-def]
    """Colour c of a picture (t, s, channel) at X = x, row y; `offset` (t,) is X of lens s=0 of each row."""
    rows, columns = picture.shape[0], picture.shape[1]
    none, right, one = np.float32(0), np.float32(columns - 1.001), np.uint32(1)
    y = min(max(y, none), np.float32(rows - 1.001))
    top = np.uint32(y)
    upper = min(max(x - offset[top], none), right)
    lower = min(max(x - offset[top + one], none), right)
    m, n = np.uint32(upper), np.uint32(lower)
    first, second = picture[top, m, c], picture[top + one, n, c]
    first += (upper - np.float32(m)) * (picture[top, m + one, c] - first)
    second += (lower - np.float32(n)) * (picture[top + one, n + one, c] - second)
    return first + (y - np.float32(top)) * (second - first)
