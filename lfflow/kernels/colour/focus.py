"""Views sheared and summed: a picture focused on a plane, or on a surface (seed eq. 4.6).

Pictures are float32 (T, S, 4): colour × presence, presence; so a place outside a view takes no part. `geometry` is
(row pitch, column pitch, X of the first place of every other row, whether row 0 is such), lens pitches.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_TAPS = 8


@numba.njit(nogil=True, cache=True)
def _lanczos(fraction: float) -> Array:
    """Eight taps, places −3…4, of the windowed sinc that reads at `fraction` in 0…1; they sum to 1."""
    taps = np.empty(_TAPS, dtype=np.float32)
    for k in range(_TAPS):
        x = fraction - (k - 3)
        taps[k] = np.sinc(x) * np.sinc(x / 4.0) if abs(x) < 4 else 0.0
    taps /= taps.sum()
    return taps


@numba.njit(nogil=True, cache=True)
def _table() -> Array:
    """The taps of 513 fractions from 0 to 1."""
    table = np.empty((513, _TAPS), dtype=np.float32)
    for k in range(513):
        table[k] = _lanczos(k / 512)
    return table


@numba.njit(nogil=True, cache=True)
def _along_row(row: Array, out: Array, shift: float) -> None:
    """Row (S, 4) read at s + shift, zero outside."""
    whole = int(np.floor(shift))
    taps = _lanczos(shift - whole)
    out[:] = 0
    for k in range(_TAPS):
        step = whole + k - 3
        low, high = max(0, -step), min(row.shape[0], row.shape[0] - step)
        for s in range(low, high):
            for c in range(4):
                out[s, c] += taps[k] * row[s + step, c]


@numba.njit(nogil=True, cache=True)
def add_shifted(total: Array, view: Array, dx: float, dy: float, gain: float, geometry: Array) -> None:
    """Add ``gain × view`` read at (X + dx, Y + dy), lens pitches, to `total`; both (T, S, 4)."""
    rows, columns = view.shape[0], view.shape[1]
    half, odd = geometry[2] / geometry[1], int(geometry[3])
    whole = int(np.floor(dy / geometry[0]))
    taps = _lanczos(dy / geometry[0] - whole) * np.float32(gain)
    read = np.empty((2, rows, columns, 4), dtype=np.float32)
    for r in range(rows):
        _along_row(view[r], read[0, r], dx / geometry[1])
        if half != 0:
            _along_row(view[r], read[1, r], dx / geometry[1] + (-half if (r + odd) & 1 else half))
    for t in range(rows):
        for k in range(_TAPS):
            r = t + whole + k - 3
            if r < 0 or r >= rows:
                continue
            other = 1 if half != 0 and (r - t) & 1 else 0
            for s in range(columns):
                for c in range(4):
                    total[t, s, c] += taps[k] * read[other, r, s, c]


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _read(view: Array, x: float, y: float, geometry: Array, table: Array, out: Array) -> None:
    """Value (4,) of `view` at (x, y), lens pitches, by the taps of `table` (fraction, tap)."""
    steps, taps = table.shape[0] - 1, table.shape[1]
    before = taps // 2 - 1
    upper = int(np.floor(y / geometry[0]))
    down = table[int((y / geometry[0] - upper) * steps + 0.5)]
    out[:] = 0
    for k in range(taps):
        row = upper + k - before
        if row < 0 or row >= view.shape[0]:
            continue
        place = x / geometry[1] - geometry[2] / geometry[1] * ((row + int(geometry[3])) & 1)
        left = int(np.floor(place))
        along = table[int((place - left) * steps + 0.5)]
        left -= before
        for m in range(max(0, -left), min(taps, view.shape[1] - left)):
            share = down[k] * along[m]
            for c in range(4):
                out[c] += share * view[row, left + m, c]


@numba.njit(nogil=True, cache=True)
def add_on_surface(
    total: Array,
    view: Array,
    disparity: Array,
    surface: Array,
    places: Array,
    a: float,
    b: float,
    gain: float,
    tolerance: float,
    geometry: Array,
) -> None:
    """Add ``gain × view`` read where a surface is seen from it, for every place of the surface.

    Parameters
    ----------
    total, view
        float32 (T, S, 4).
    disparity
        float32 (T, S) of the view; what differs from the surface by `tolerance` counts a quarter. `tolerance` 0: all.
    surface, places
        float32 (T, S), (2, T, S): disparity to focus on, and X, Y.
    a, b
        u and v of the view relative to the wanted viewpoint.
    """
    value, table = np.empty(4, dtype=np.float32), _table()
    rows, columns = surface.shape
    for t in range(rows):
        for s in range(columns):
            d = surface[t, s]
            if np.isnan(d):
                continue
            x, y = places[0, t, s] - d * a, places[1, t, s] - d * b
            _read(view, x, y, geometry, table, value)
            weight = gain
            if tolerance > 0:
                row = min(max(int(np.floor(y / geometry[0] + 0.5)), 0), rows - 1)
                shift = geometry[2] * ((row + int(geometry[3])) & 1)
                column = min(max(int(np.floor((x - shift) / geometry[1] + 0.5)), 0), columns - 1)
                apart = (disparity[row, column] - d) / tolerance
                weight = gain / (1.0 + apart * apart) ** 2 if not np.isnan(apart) else 0.0
            for c in range(4):
                total[t, s, c] += weight * value[c]
