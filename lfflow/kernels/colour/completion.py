"""Every colour of the central view from the same-colour samples of all views along a disparity (METHOD 9)."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.kernels.mosaicked.mosaic_field import MosaicField, shown_by
from lfflow.kernels.threads import bands, each

FloatArray = npt.NDArray[np.float32]


def complete_centre(
    field: MosaicField,
    disparity: FloatArray,
    std: FloatArray,
    *,
    within: float = math.inf,
    reach: float = 0.45,
    threads: int = 1,
) -> tuple[FloatArray, FloatArray]:
    """Picture and its weight (3, t, s) of the view at aperture point (0, 0).

    Sample k of view q was taken at aperture q + rho; with disparity d it lies at k + d·(q + rho) of the central view
    and counts there by a Gaussian of `reach` lens pitches, its confidence, and less where d is uncertain (`std`) and
    the view far. The samples of a colour do not lie evenly about the lens, and how they lie changes from row to row; so
    their mean is moved to the lens along the picture's slope. Where no sample of a colour falls, the weighted mean of
    the neighbours that have one is taken.
    Views farther than `within` from the centre (sensor pixels) are left out.
    """
    rows, columns = disparity.shape
    picture = np.zeros((3, rows, columns), dtype=np.float32)
    weight = np.zeros((3, rows, columns), dtype=np.float32)
    aside = np.zeros((2, 3, rows, columns), dtype=np.float32)
    known = np.isfinite(disparity)
    d = np.where(known, disparity, 0).astype(np.float32)
    doubt = np.where(known, std, 1).astype(np.float32) ** 2
    pitch = np.float32(field.row_pitch)

    views = field.views(0, within)

    def band(span: tuple[int, int]) -> None:
        for j, i in views:
            view = field.mosaic[j, i], field.cfa[j, i], field.weight[j, i]
            place = np.float32(field.u[i]), np.float32(field.v[j])
            _gather(view, place, field.rho, field.offset, pitch, d, doubt, np.float32(reach), span, picture, weight,
                    aside)  # fmt: skip

    each(band, bands(rows), threads)
    total = np.maximum(weight, np.float32(1e-12))
    picture /= total
    aside /= total
    _spread(picture, weight)
    _centre(picture.copy(), aside, field.offset, pitch, picture)
    return picture, weight


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _gather(view, place, rho, offset, pitch, disparity, doubt, reach, span, picture, weight, aside):  # type: ignore[no-untyped-def]
    """Add the samples of one view, in the rows of `span`, to the sums of the colours and of their weights."""
    mosaic, cfa, confidence = view
    u, v = place
    columns = disparity.shape[1]
    narrow = np.float32(-0.5) / (reach * reach)
    spread = np.float32(4) * (u * u + v * v)
    for t in range(span[0], span[1]):
        for s in range(columns):
            d = disparity[t, s]
            row, column = shown_by(t, s, d, u, v, offset, pitch)
            if column < 0 or column >= columns or cfa[row, column] == CFA_NONE:
                continue
            c = cfa[row, column]
            off_y = np.float32(row - t) * pitch + d * (v + rho[1, row, column])
            off_x = np.float32(column - s) + offset[row] - offset[t] + d * (u + rho[0, row, column])
            far = off_x * off_x + off_y * off_y + spread * doubt[t, s]
            w = confidence[row, column] * np.exp(narrow * far)
            picture[c, t, s] += w * mosaic[row, column]
            weight[c, t, s] += w
            aside[0, c, t, s] += w * off_x
            aside[1, c, t, s] += w * off_y


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _centre(start, aside, offset, pitch, picture):  # type: ignore[no-untyped-def]
    """Take from each value the slope of the picture `start` times how far aside its samples lie on the mean."""
    colours, rows, columns = start.shape
    half = np.float32(0.5)
    for c in range(colours):
        for t in range(1, rows - 1):
            up, down = int(offset[t] > offset[t - 1]), int(offset[t] > offset[t + 1])
            brick = np.int64(offset[t] != offset[t - 1])
            for s in range(1, columns - 1):
                left, right = s + up - brick, s + up
                above = half * (start[c, t - 1, left] + start[c, t - 1, right])
                left, right = s + down - brick, s + down
                below = half * (start[c, t + 1, left] + start[c, t + 1, right])
                across = half * (start[c, t, s + 1] - start[c, t, s - 1])
                slope = half * (below - above) / pitch
                picture[c, t, s] -= aside[0, c, t, s] * across + aside[1, c, t, s] * slope


@numba.njit(nogil=True, cache=True)
def _spread(picture, weight):  # type: ignore[no-untyped-def]
    """Give the places with (almost) no sample the weighted mean of their surroundings, wider until one is found."""
    least = np.float32(0.05)
    sparse = np.argwhere(weight < least)
    mean = np.zeros(sparse.shape[0], dtype=np.float32)
    for n in range(sparse.shape[0]):
        c, t, s = sparse[n]
        total = np.float32(0)
        radius = 0
        while total == 0 and radius < 6:
            radius += 1
            top, left = max(0, t - radius), max(0, s - radius)
            near = weight[c, top : t + radius + 1, left : s + radius + 1]
            total, value = _mean(picture[c, top : t + radius + 1, left : s + radius + 1], near, least)
            mean[n] = value
        w = weight[c, t, s]
        mean[n] = (w * picture[c, t, s] + (least - w) * mean[n]) / least if total > 0 else picture[c, t, s]
    for n in range(sparse.shape[0]):
        c, t, s = sparse[n]
        picture[c, t, s] = mean[n]


@numba.njit(nogil=True, cache=True)
def _mean(values, weights, least):  # type: ignore[no-untyped-def]
    total, value = np.float32(0), np.float32(0)
    for t in range(values.shape[0]):
        for s in range(values.shape[1]):
            if weights[t, s] >= least:
                total += 1
                value += values[t, s]
    return total, value / max(total, np.float32(1))
