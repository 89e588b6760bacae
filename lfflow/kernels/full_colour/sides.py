"""The side of a jump of depth that a place belongs to, by all views that would see it there.

The search cannot know what hides a place from whom. Once there is a map, the nearest and the farthest surface around a
place can be tried in its stead, each only against the views in which nothing on the map stands before it.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.full_colour.cost_filter import CostFilter
from lfflow.kernels.full_colour.field import ViewField
from lfflow.kernels.full_colour.lines import Lines
from lfflow.kernels.full_colour.reading import locate, read
from lfflow.kernels.full_colour.visibility import nearest_surface
from lfflow.kernels.threads import bands, each

FloatArray = npt.NDArray[np.float32]

_REACH = 2
_JUMP = 0.25
_BETTER = np.float32(0.04)
"""By how much another side must cost less."""
_UNSEEN = np.float32(0.2)
"""Weight of a view that disagrees with everything: what hardly any view would see is no side."""
_HIDES = np.float32(0.1)
_FILTERED = 4
"""Reach of `CostFilter`."""
_FLAGS = {"nsz", "contract", "reassoc", "arcp"}


def choose_sides(lines: Lines, field: ViewField, disparity: FloatArray, noise: float) -> FloatArray:
    """Disparity (t, s) in which places near jumps have moved to the side that the views agree on.

    Parameters
    ----------
    disparity
        (t, s) of the central view.
    noise
        Variance of the luminance that is no edge.
    """
    window = np.ones((2 * _REACH + 1, 2 * _REACH + 1), dtype=np.uint8)
    near = np.asarray(cv2.dilate(disparity, window), dtype=np.float32)
    far = np.asarray(cv2.erode(disparity, window), dtype=np.float32)
    jump = near - far > _JUMP
    if not jump.any():
        return disparity
    wide = np.ones((2 * _FILTERED + 1, 2 * _FILTERED + 1), dtype=np.uint8)
    asked = cv2.dilate(jump.astype(np.uint8), wide).astype(np.bool_)
    nearest = np.stack(
        each(lambda q: nearest_surface(disparity, lines.u[q], lines.v[q]), range(len(lines.u)), lines.threads)
    )
    along_edges = CostFilter(field.layers[field.centre, 1], noise)

    def cost(candidate: FloatArray) -> FloatArray:
        out = np.zeros_like(disparity)

        def band(rows: tuple[int, int]) -> None:
            _disagreement(lines.views, lines.centre, nearest, candidate, asked, lines.u, lines.v, rows, lines.margin,
                          out)  # fmt: skip

        each(band, bands(len(disparity)), lines.threads)
        return along_edges(out)

    costs = [cost(candidate) for candidate in (disparity, near, far)]
    best = np.argmin([costs[0] - _BETTER, *costs[1:]], axis=0)
    return np.where(jump, np.choose(best, [disparity, near, far]), disparity).astype(np.float32)


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _disagreement(views, centre, nearest, candidate, asked, u, v, rows, margin, out):  # type: ignore[no-untyped-def]
    """Fill `out` (t, s) with the share of the views that would see a place and show something else, where `asked`."""
    layers, shape = views.shape[1], views.shape[2:]
    for t in range(rows[0], rows[1]):
        places = np.flatnonzero(asked[t])
        count = places.shape[0]
        d = candidate[t][places]
        base, one = np.empty(count, dtype=np.uintp), np.empty(count, dtype=np.float32)
        along, change = np.empty((2, 4, count), dtype=np.float32), np.empty((2, 4, count), dtype=np.float32)
        square = np.empty(count, dtype=np.float32)
        cost, number = np.full(count, _UNSEEN), np.full(count, _UNSEEN)
        for q in range(views.shape[0]):
            if u[q] == 0 and v[q] == 0:
                continue
            locate(d, places, t, u[q], v[q], margin, shape, base, along, change)
            square[:] = 0
            for c in range(layers):
                read(views[q, c], base, along[0], along[1], one)
                for k in range(count):
                    square[k] += (one[k] - centre[c, t, places[k]]) ** 2
            _add_seen(square, nearest[q], d, places, t, u[q], v[q], cost, number)
        for k in range(count):
            out[t, places[k]] = cost[k] / number[k]


@numba.njit(nogil=True, cache=True, fastmath=_FLAGS)
def _add_seen(square, nearest, d, places, t, u, v, cost, number):  # type: ignore[no-untyped-def]
    """Add a view to the cost and number of those that would see each place."""
    rows, columns = nearest.shape
    for k in range(places.shape[0]):
        row, column = int(np.floor(t - d[k] * v + 0.5)), int(np.floor(places[k] - d[k] * u + 0.5))
        if 0 <= row < rows and 0 <= column < columns and nearest[row, column] <= d[k] + _HIDES:
            cost[k] += square[k] / (square[k] + np.float32(1))
            number[k] += np.float32(1)
