"""The side of a jump of the disparity that a lens belongs to, by all views that would see it there.

Matching looks at blocks and cannot know what hides a lens from whom. Once there is a map, the nearest and the farthest
surface beside a lens can be tried in its stead, over that lens alone: along the right one the samples of each colour
agree, in all views in which nothing on the map stands before it. Lenses that hold both surfaces may come out on either
side: those are told by their colour (`lfflow.kernels.mosaicked.edge_place`).
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, minimum_filter

from lfflow.kernels.mosaicked.between import read_between
from lfflow.kernels.mosaicked.mosaic_field import MosaicField, shown_by
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]

_JUMP = 0.08
"""Smallest difference of the disparities around a lens that is asked about."""
_HIDES = 0.1
"""By how much nearer a surface must come to hide a lens."""
_LIMIT, _LEAST_LIMIT = 3.0, 0.02
"""Scatter of the samples of a colour that counts as half of disagreement: in units of the noise, and at least."""
_BETTER = 0.06
"""By how much less another side's samples must disagree."""
_UNSEEN, _FEW = 0.2, 2.0
"""Disagreement, and weight in samples, of what is taken for granted: what hardly any view would see is no side."""
_EVERY = 2
"""Half of the views, spread over all of the aperture, tell as much of a side as all."""
_TURNS = 4
"""Parts of the views that are summed by themselves, whatever the number of threads."""
_NOTHING = np.float32(-1e30)


def choose_sides(
    disparity: FloatArray, picture: FloatArray, field: MosaicField, noise: float, threads: int = 1
) -> FloatArray:
    """Disparity (t, s) in which lenses beside jumps have moved to the side that the views agree on.

    Parameters
    ----------
    disparity
        (t, s) of view (0, 0), NaN where unknown.
    picture
        (3, t, s) of that view. Samples lie up to half a lens beside the lens: what it changes by in between is taken
        off them.
    noise
        Standard deviation of a sample, in units of the mosaic.
    """
    known = np.isfinite(disparity)
    near = maximum_filter(np.where(known, disparity, -np.inf), 3)
    far = minimum_filter(np.where(known, disparity, np.inf), 3)
    asked = np.argwhere(known & (near - far > _JUMP))
    if not len(asked):
        return disparity
    places = tuple(asked.T)
    hiding = np.argwhere(_may_hide(disparity, known, field))
    sides = np.stack([disparity[places], near[places], far[places]], axis=-1).astype(np.float32)
    samples = field.mosaic, field.cfa, field.weight
    axes = field.u.astype(np.float32), field.v.astype(np.float32)
    pitch, reach = np.float32(field.row_pitch), np.float32(_farthest(field))
    colours = np.ascontiguousarray(np.moveaxis(picture, 0, -1), dtype=np.float32)
    views = np.array(field.views()[::_EVERY], dtype=np.int64).reshape(-1, 2)

    def turn(k: int) -> FloatArray:
        sums = np.zeros((*sides.shape, 3, 3), dtype=np.float32)
        _add(samples, views[k::_TURNS], axes, field.rho, field.offset, pitch, reach, colours, disparity, hiding, asked,
             sides, sums)  # fmt: skip
        return sums

    total = np.sum(each(turn, range(_TURNS), threads), axis=0)
    cost = _disagreement(total, max(_LIMIT * noise, _LEAST_LIMIT))
    cost[:, 0] -= _BETTER
    out = disparity.copy()
    out[places] = np.take_along_axis(sides, cost.argmin(axis=1)[:, None], axis=1)[:, 0]
    return out


def _may_hide(disparity: FloatArray, known: npt.NDArray[np.bool_], field: MosaicField) -> npt.NDArray[np.bool_]:
    """Lenses (t, s) that some view shows before what lies farther: those with something farther around."""
    span = float(disparity[known].max() - disparity[known].min())
    away = 2 + math.ceil(span * math.hypot(np.abs(field.u).max(), np.abs(field.v).max()) / min(field.row_pitch, 1))
    farthest = minimum_filter(np.where(known, disparity, np.inf), 2 * away + 1)
    return np.asarray(known & (disparity - farthest > _HIDES))


def _farthest(field: MosaicField) -> float:
    """Distance, lens pitches, within which any place has a lens; a little more, for surfaces that are stretched."""
    pitch = field.row_pitch
    return 1.05 * ((pitch**2 + 0.25) / (2 * pitch) if field.brick else math.hypot(0.5, pitch / 2))


def _disagreement(total: FloatArray, limit: float) -> FloatArray:
    """Share (place, side) of disagreement, from the sums (…, colour, 3) of w, w·x and w·x² over the samples x."""
    weight, first, second = np.moveaxis(total, -1, 0)
    squares = np.maximum(second - first**2 / np.maximum(weight, 1e-6), 0).sum(axis=-1)
    count = weight.sum(axis=-1)
    scatter = squares / np.maximum(count - 3, 1)
    return np.asarray((scatter / (scatter + limit**2) * count + _UNSEEN * _FEW) / (count + _FEW), dtype=np.float32)


@numba.njit(nogil=True, cache=True)
def _project(disparity, hiding, offset, pitch, reach, u, v, nearest):  # type: ignore[no-untyped-def]
    """Fill `nearest` (t, s) with the largest disparity of the lenses `hiding` that lands on each lens of the view."""
    rows, columns = disparity.shape
    nearest[:] = _NOTHING
    for k in range(hiding.shape[0]):
        t, s = hiding[k]
        d = disparity[t, s]
        y, place = np.float32(t) - d * (v / pitch), np.float32(s) + offset[t] - d * u
        top = int(np.floor(y))
        for row in range(max(top, 0), min(top + 2, rows)):
            x, down = place - offset[row], (np.float32(row) - y) * pitch
            left = int(np.floor(x))
            for column in range(max(left, 0), min(left + 2, columns)):
                right = np.float32(column) - x
                if right * right + down * down < reach * reach and nearest[row, column] < d:
                    nearest[row, column] = d


@numba.njit(nogil=True, cache=True)
def _add(samples, views, axes, rho, offset, pitch, reach, picture, disparity, hiding, asked, sides, sums):  # type: ignore[no-untyped-def]
    """Add to the sums (place, side, colour, 3) of w, w·x and w·x² the samples that show the places and are not hidden.

    `asked` (place, 2) are rows and columns, `sides` (place, side) the own, the nearest and the farthest disparity.
    Views in which those part by less than half a lens see the place as the central one does: nothing hides it there.
    """
    mosaics, colours, confidences = samples
    half = np.float32(0.5)
    nearest = np.empty_like(disparity)
    for n in range(views.shape[0]):
        j, i = views[n]
        u, v = axes[0][i], axes[1][j]
        _project(disparity, hiding, offset, pitch, reach, u, v, nearest)
        for k in range(asked.shape[0]):
            t, s = asked[k]
            moves = (u * u + v * v) * (sides[k, 1] - sides[k, 2]) ** 2
            for side in range(sides.shape[1]):
                d = sides[k, side]
                row, column = shown_by(t, s, d, u, v, offset, pitch)
                if column < 0 or column >= disparity.shape[1] or colours[j, i, row, column] > 2:
                    continue
                if nearest[row, column] > d + np.float32(_HIDES) and moves > half * half:
                    continue
                c = colours[j, i, row, column]
                right = np.float32(column) + offset[row] + d * (u + rho[0, row, column])
                down = np.float32(row) + d * (v + rho[1, row, column]) / pitch
                aside = read_between(picture, offset, right, down, c) - picture[t, s, c]
                w, x = confidences[j, i, row, column], mosaics[j, i, row, column] - aside
                one = sums[k, side, c]
                one[0] += w
                one[1] += w * x
                one[2] += w * x * x
