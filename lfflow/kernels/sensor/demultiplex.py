"""Every sensor pixel to its view and lens: exact integer sampling, no colour mixed (METHOD 7.a, 7.1).

A pixel belongs to the lens whose centre is nearest (`Lattice.nearest`) and, there, to the view that is its offset from
the rounded centre, so that each has one place at most. The loop runs over the places, view by view along a row of
lenses: all that it reads lies in a few sensor rows, all that it writes in one line. Only near the border of a lens's
cell must the owner of the pixel be looked up.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.distortion import STRAIGHT, Distortion
from lfflow.kernels.sensor.radiometry import colour_tile, level_tiles
from lfflow.lattice import Lattice

MIN_VIGNETTING = 0.1
"""Below this share of the peak illumination a sample is left out: division would only amplify its noise."""

SATURATED_WEIGHT = 1.0 / 64.0
"""Factor on the weight of a clipped sample; it brings every such weight below `MIN_VIGNETTING`, and so marks it."""

Float32Array = npt.NDArray[np.float32]


class FieldArrays(NamedTuple):
    """Arrays (v, u, t, s) of a light field: radiance, colour code, weight."""

    mosaic: Float32Array
    cfa: npt.NDArray[np.uint8]
    weight: Float32Array


def round_to_pixel(position: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Sensor pixel of a sensor position: halves go up (right and down). The one rounding rule of lfflow."""
    return np.floor(np.asarray(position, dtype=np.float64) + 0.5).astype(np.int64)


def lencolumn_ofs(
    lattice: Lattice, t: npt.ArrayLike, s: npt.ArrayLike, distortion: Distortion = STRAIGHT
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Centres (x, y) of the lenses of rows `t` and columns `s`, sensor pixels, each (t, s)."""
    return distortion.moved(lattice.centres(np.asarray(t)[:, np.newaxis], np.asarray(s)))


def residuals(
    lattice: Lattice, t: npt.ArrayLike, s: npt.ArrayLike, distortion: Distortion = STRAIGHT
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """ρ = rounded centre − centre in x and y, pixels, each (t, s): sample (u, v) was taken at aperture (u, v) + ρ."""
    x, y = lencolumn_ofs(lattice, t, s, distortion)
    return round_to_pixel(x) - x, round_to_pixel(y) - y


def demultiplex_frame(
    raw: npt.NDArray[Any],
    vignetting: Float32Array,
    pixel_flags: npt.NDArray[np.uint8],
    lattice: Lattice,
    *,
    black: npt.NDArray[np.float64],
    white: npt.NDArray[np.float64],
    pattern: str,
    out: FieldArrays,
    distortion: Distortion = STRAIGHT,
    interpolated: bool = False,
) -> npt.NDArray[np.bool_]:
    """Write the samples of one frame (y, x) into `out` (v, u, t, s); NaN, 255 and 0 where there is none.

    Parameters
    ----------
    raw, vignetting, pixel_flags
        Counts; relative illumination, 1 at its peak; pixels with any flag are left out, and so are those with a
        vignetting below `MIN_VIGNETTING`.
    lattice, distortion
        Lattice, numbered for the grid of `out`, and its bend.
    black, white
        Counts (4,) at the sites (r, gr, gb, b).
    pattern
        Colours of the top-left 2×2 pixels, row by row.
    out
        Radiance (raw − black)/(white − black)/vignetting, colour, and weight: the vignetting.
    interpolated
        Move each radiance to the exact place of its view in the aperture by the slopes between the pixels of its
        colour in the same subimage.

    Returns
    -------
    usable
        Whether a view (v, u) has a sample at half of the lenses on the sensor at least: a median vignetting of
        `MIN_VIGNETTING` or more.
    """
    rows, columns = out.mosaic.shape[2:]
    x, y = lencolumn_ofs(lattice, np.arange(rows), np.arange(columns), distortion)
    bend = np.zeros((2, 0, 0))
    if not distortion.straight:
        straight_x, straight_y = lencolumn_ofs(lattice, np.arange(rows), np.arange(columns))
        bend = np.stack([x - straight_x, y - straight_y])
    frame = _Frame(
        np.ascontiguousarray(raw),
        np.ascontiguousarray(vignetting, dtype=np.float32),
        np.ascontiguousarray(pixel_flags, dtype=np.uint8),
        level_tiles(black, white, pattern),
        colour_tile(pattern),
    )
    turn = math.cos(lattice.theta), math.sin(lattice.theta), lattice.dh, lattice.dv, lattice.cx, lattice.cy
    cells = _Cells(x, y, bend, turn, lattice.arrangement == "hexagonal")
    column_of, row_of = round_to_pixel(x).astype(np.int32), round_to_pixel(y).astype(np.int32)
    counts = np.zeros(out.mosaic.shape[:2], np.int64)
    _gather(frame, cells, column_of, row_of, interpolated, out, counts)
    inside = (column_of >= 0) & (column_of < raw.shape[1]) & (row_of >= 0) & (row_of < raw.shape[0])
    usable: npt.NDArray[np.bool_] = (counts > 0) & (2 * counts >= inside.sum())
    return usable


class _Frame(NamedTuple):
    """A sensor frame as the kernels want it: counts, vignetting, flags (y, x); tiles of levels and colours (2, 2)."""

    raw: npt.NDArray[Any]
    vignetting: Float32Array
    flags: npt.NDArray[np.uint8]
    levels: tuple[Float32Array, Float32Array, Float32Array]
    colours: npt.NDArray[np.uint8]


class _Cells(NamedTuple):
    """Lens centres x, y (t, s), how far they are bent (2, t, s) or (2, 0, 0), and the straight lattice."""

    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    bend: npt.NDArray[np.float64]
    turn: tuple[float, float, float, float, float, float]
    hexagonal: bool


_HALF_HEIGHT = math.sqrt(3) / 2


@numba.njit(nogil=True, cache=True, forceinline=True)
def owner(gx: float, gy: float, hexagonal: bool) -> tuple[int, int]:  # pragma: no cover - compiled
    """Lens (t, s) nearest to a point in lens pitches: `Lattice.nearest`, operation by operation."""
    if not hexagonal:
        return math.floor(gy + 0.5), math.floor(gx + 0.5)
    t = math.floor(gy / _HALF_HEIGHT)
    shift = 0.5 * (t & 1)
    s = math.floor(gx - shift + 0.5)
    distance = (gx - s - shift) ** 2 + (gy - _HALF_HEIGHT * t) ** 2
    below = t + 1
    below_shift = 0.5 - shift
    below_s = math.floor(gx - below_shift + 0.5)
    if (gx - below_s - below_shift) ** 2 + (gy - _HALF_HEIGHT * below) ** 2 < distance:
        return below, below_s
    return t, s


@numba.njit(nogil=True, cache=True, forceinline=True)
def _owner_of_pixel(x, y, cells):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Lens (t, s) of a sensor pixel; on a bent lattice, of where the pixel would be were it straight."""
    cos, sin, dh, dv, cx, cy = cells.turn
    px, py = x - cx, y - cy
    t, s = owner((cos * px + sin * py) / dh, (-sin * px + cos * py) / dv, cells.hexagonal)
    if cells.bend.size:
        near_t, near_s = min(max(t, 0), cells.x.shape[0] - 1), min(max(s, 0), cells.x.shape[1] - 1)
        px, py = px - cells.bend[0, near_t, near_s], py - cells.bend[1, near_t, near_s]
        t, s = owner((cos * px + sin * py) / dh, (-sin * px + cos * py) / dv, cells.hexagonal)
    return t, s


@numba.njit(nogil=True, cache=True, forceinline=True)
def _is_owned(x, y, t, s, cells):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Whether a sensor pixel is in the cell of a lens; only within `tie` of the border the owner is looked up."""
    cos, sin, dh, dv, _, _ = cells.turn
    px, py = x - cells.x[t, s], y - cells.y[t, s]
    gx, gy = (cos * px + sin * py) / dh, (-sin * px + cos * py) / dv
    tie = 0.02 if cells.bend.size else 1e-6
    if cells.hexagonal:
        inside = 0.5 - max(abs(gx), 0.5 * abs(gx) + _HALF_HEIGHT * abs(gy))
    else:
        inside = 0.5 - max(abs(gx), abs(gy))
    if abs(inside) > tie:
        return inside > 0
    owner_t, owner_s = _owner_of_pixel(x, y, cells)
    return owner_t == t and owner_s == s


@numba.njit(nogil=True, cache=True, forceinline=True)
def _reach(u, v, cells):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """1 where a view lies in the cells of all lenses whatever the rounding of their centres, −1 in none, else 0."""
    _, _, dh, dv, _, _ = cells.turn
    distance = math.sqrt(u * u + v * v)
    if (distance + 0.72) / min(dh, dv) < 0.48:
        return 1
    return -1 if (distance - 0.72) / max(dh, dv) > (0.6 if cells.hexagonal else 0.73) else 0


@numba.njit(nogil=True, cache=True, forceinline=True)
def _radiance(x, y, frame):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    black, gain, _ = frame.levels
    i, j = y & 1, x & 1
    return (np.float32(frame.raw[y, x]) - black[i, j]) * gain[i, j] / frame.vignetting[y, x]


@numba.njit(nogil=True, cache=True, forceinline=True)
def _neighbour(x, y, t, s, frame, cells):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Radiance of a pixel of the same subimage, NaN where it cannot be used."""
    if y < 0 or x < 0 or y >= frame.raw.shape[0] or x >= frame.raw.shape[1]:
        return np.float32(np.nan)
    if frame.flags[y, x] != 0 or not frame.vignetting[y, x] >= np.float32(MIN_VIGNETTING):
        return np.float32(np.nan)
    return _radiance(x, y, frame) if _is_owned(x, y, t, s, cells) else np.float32(np.nan)


@numba.njit(nogil=True, cache=True, forceinline=True)
def _slope(before, here, after):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Slope a pixel from three values two pixels apart, where the outer ones may be NaN."""
    if not math.isnan(before) and not math.isnan(after):
        return np.float32(0.25) * (after - before)
    if not math.isnan(after):
        return np.float32(0.5) * (after - here)
    return np.float32(0) if math.isnan(before) else np.float32(0.5) * (here - before)


@numba.njit(nogil=True, cache=True, forceinline=True)
def _at_the_view(x, y, t, s, value, centre_x, centre_y, frame, cells):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Radiance moved from the pixel to where the view is: back by the rounding of the lens centre."""
    left, right = _neighbour(x - 2, y, t, s, frame, cells), _neighbour(x + 2, y, t, s, frame, cells)
    above, below = _neighbour(x, y - 2, t, s, frame, cells), _neighbour(x, y + 2, t, s, frame, cells)
    across, down = cells.x[t, s] - centre_x, cells.y[t, s] - centre_y
    return value + np.float32(across) * _slope(left, value, right) + np.float32(down) * _slope(above, value, below)


@numba.njit(nogil=True, cache=True)
def _gather(frame, cells, centre_x, centre_y, interpolated, out, counts):  # type: ignore[no-untyped-def]  # pragma: no cover
    mosaic, cfa, weight = out
    raw, vignetting, flags = frame.raw, frame.vignetting, frame.flags
    black, gain, white = frame.levels
    views_v, views_u, rows, columns = mosaic.shape
    height, width = raw.shape
    least, clipped = np.float32(MIN_VIGNETTING), np.float32(SATURATED_WEIGHT)
    for t in range(rows):
        for v in range(views_v):
            for u in range(views_u):
                reach = _reach(u - views_u // 2, v - views_v // 2, cells)
                values, colours, weights = mosaic[v, u, t], cfa[v, u, t], weight[v, u, t]
                number = 0
                for s in range(columns):
                    x, y = centre_x[t, s] + (u - views_u // 2), centre_y[t, s] + (v - views_v // 2)
                    values[s], colours[s], weights[s] = np.float32(np.nan), CFA_NONE, np.float32(0)
                    if reach < 0 or y < 0 or x < 0 or y >= height or x >= width:
                        continue
                    shade = vignetting[y, x]
                    if flags[y, x] != 0 or not shade >= least:
                        continue
                    if reach == 0 and not _is_owned(x, y, t, s, cells):
                        continue
                    i, j = y & 1, x & 1
                    count = np.float32(raw[y, x])
                    value = (count - black[i, j]) * gain[i, j] / shade
                    if interpolated:
                        value = _at_the_view(x, y, t, s, value, centre_x[t, s], centre_y[t, s], frame, cells)
                    values[s], colours[s] = value, frame.colours[i, j]
                    weights[s] = shade if count < white[i, j] else shade * clipped
                    number += 1
                counts[v, u] += number
