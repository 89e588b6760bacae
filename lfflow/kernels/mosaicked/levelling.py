"""Views brought to the brightness of the central one, where gloss and soft shading move with the viewpoint.

What a view differs by from the completed picture, along a first disparity and smoothed over several lenses, is no
texture: it is light that changes with the direction. Left in, it pulls the matching of weak texture to wherever the
picture's own slopes make up for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.kernels.mosaicked.between import read_between
from lfflow.kernels.mosaicked.mosaic_field import MosaicField, shown_by
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]

DARKEST, LIGHTEST = 0.5, 2.0
"""Middle samples of a view as a share of those of the central one, beyond which the view is no picture of the scene."""


def without_strangers(field: MosaicField) -> MosaicField:
    """Field without the views that are far darker or lighter than the central one: black, where others see.

    Colours are compared each with itself: a view may hold more of one than another view does.
    """
    mosaic, cfa, _ = field.view(0, 0)
    middle = _middles(mosaic, cfa)
    strangers = []
    for at in field.views():
        own = _middles(field.mosaic[at], field.cfa[at])
        both = np.isfinite(own) & np.isfinite(middle)
        if both.any() and not DARKEST * middle[both].sum() <= own[both].sum() <= LIGHTEST * middle[both].sum():
            strangers.append(at)
    if not strangers:
        return field
    cfas, weights, mosaics = field.cfa.copy(), field.weight.copy(), field.mosaic.copy()
    for at in strangers:
        cfas[at], weights[at], mosaics[at] = CFA_NONE, 0, 0
    return field._replace(cfa=cfas, weight=weights, mosaic=mosaics)


def _middles(mosaic: FloatArray, cfa: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Median (colour,) of the samples of each colour in every third row, or in all where those have none; NaN."""
    out = np.full(3, np.nan)
    for colour in range(3):
        some = mosaic[::3][cfa[::3] == colour]
        some = some if some.size else mosaic[cfa == colour]
        if some.size:
            out[colour] = np.median(some)
    return out


def levelled(
    field: MosaicField,
    picture: FloatArray,
    disparity: FloatArray,
    *,
    views: Sequence[tuple[int, int]],
    limit: float,
    least: float,
    sigma: float = 3.0,
    threads: int = 1,
) -> MosaicField:
    """Field whose samples have lost their view's smooth difference to `picture` (3, t, s) along `disparity` (t, s).

    Parameters
    ----------
    views
        Places (v, u) in the arrays of the views that are levelled; the others stay as they are.
    limit
        Difference, in units of the mosaic, beyond which a sample hardly counts: it may show another surface.
    least
        Smooth difference that is taken off by half; less may be what noise and texture make.
    sigma
        Gaussian over which the difference is smoothed, lens pitches.
    """
    colours = np.ascontiguousarray(np.moveaxis(picture, 0, -1), dtype=np.float32)
    start = np.ascontiguousarray(disparity, dtype=np.float32)
    mosaic = field.mosaic.copy()

    def one_view(at: tuple[int, int]) -> None:
        j, i = at
        total = np.zeros((2, *disparity.shape), dtype=np.float32)
        place = np.float32(field.u[i]), np.float32(field.v[j])
        view = field.mosaic[j, i], field.cfa[j, i], field.weight[j, i]
        _differences(view, place, field.rho, field.offset, np.float32(field.row_pitch), colours, start,
                     np.float32(limit), total)  # fmt: skip
        for part in total:
            cv2.GaussianBlur(part, (0, 0), sigma, dst=part, sigmaY=sigma / field.row_pitch)
        _take_off(total, field.cfa[j, i], np.float32(least**2), mosaic[j, i])

    each(one_view, views, threads)
    return field._replace(mosaic=mosaic)


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _differences(view, place, rho, offset, pitch, picture, disparity, limit, total):  # type: ignore[no-untyped-def]
    """Add to (2, t, s), at the places of the view's own samples, their differences and weights."""
    mosaic, cfa, confidence = view
    u, v = place
    rows, columns = disparity.shape
    one = np.float32(1)
    narrow, rows_per_lens = one / (limit * limit), one / pitch
    for t in range(rows):
        for s in range(columns):
            d = disparity[t, s]
            if np.isnan(d):
                continue
            row, column = shown_by(t, s, d, u, v, offset, pitch)
            if row < 1 or row >= rows - 1 or column < 1 or column >= columns - 2 or cfa[row, column] > 2:
                continue
            x = np.float32(column) + offset[row] + d * (u + rho[0, row, column])
            y = np.float32(row) + d * (v + rho[1, row, column]) * rows_per_lens
            r = mosaic[row, column] - read_between(picture, offset, x, y, cfa[row, column])
            robust = one / (one + r * r * narrow)
            w = confidence[row, column] * robust * robust
            total[0, row, column] += w * r
            total[1, row, column] += w


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _take_off(total, cfa, least, mosaic):  # type: ignore[no-untyped-def]
    """Take the smooth difference (its sum and weight: `total`) off the samples, less of it where it is small."""
    for t in range(cfa.shape[0]):
        for s in range(cfa.shape[1]):
            smooth = total[0, t, s] / max(total[1, t, s], np.float32(1e-4))
            square = smooth * smooth
            changed = mosaic[t, s] - smooth * (square / (square + least))
            mosaic[t, s] = np.float32(0) if cfa[t, s] == CFA_NONE else changed
