"""First disparity of a full-colour light field: bounded costs of all hypotheses, aggregated semi-globally."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from lfflow.kernels.aggregate import accumulate, winner
from lfflow.kernels.full_colour.cost import half_plane_volume, padded, sectors
from lfflow.kernels.full_colour.cost_filter import CostFilter
from lfflow.kernels.full_colour.field import ViewField
from lfflow.kernels.threads import bands, each

FloatArray = npt.NDArray[np.float32]

_SPLINE = np.array([1 / 6, 2 / 3, 1 / 6], dtype=np.float32)
_BEND = np.float32(4)
"""A cost is half of its bound at this many times the variance that remains at the right disparity."""
_GLOSS = np.float32(2 / 255)
"""Luminance difference of a place between views that may be gloss."""
_SHARE = np.float32(0.3)
"""Weight of the luminance against the detail: it sees edges that are too strong to be detail."""
_EDGE = 0.05
_FLAT = 1e-5
"""Variance of the luminance below which nothing is an edge."""


class Found(NamedTuple):
    """Disparity (t, s), whether (t, s) its cost tells it from others, and the variance of the detail there."""

    disparity: FloatArray
    sure: npt.NDArray[np.bool_]
    noise: float


def search(field: ViewField, hypotheses: FloatArray, small: float, large: float, threads: int) -> Found:
    """Disparity of the cheapest smooth surface.

    Parameters
    ----------
    hypotheses
        (hypothesis,) equally spaced disparities, ascending.
    small, large
        Penalties of the aggregation, `lfflow.kernels.aggregate.regularise`.
    """
    detail, noise = _boxed(field, 0, hypotheses, threads)
    luminance, rest = _boxed(field, 1, hypotheses, threads)
    bound = max(_BEND * np.float32(rest), _GLOSS * _GLOSS)

    along_edges = CostFilter(field.layers[field.centre, 1], max(_FLAT, noise))

    def bounded(h: int) -> None:
        detail[h] /= detail[h] + _BEND * np.float32(noise)
        detail[h] += _SHARE * luminance[h] / (luminance[h] + bound)
        detail[h] = along_edges(detail[h])

    each(bounded, range(len(hypotheses)), threads)
    total, unit = accumulate(detail, field.guide, small=small, large=large, edge=_EDGE)
    sure = detail.mean(axis=0) - detail.min(axis=0) > 0.5 * unit
    return Found(np.nan_to_num(winner(total, hypotheses)), sure, noise)


def _boxed(field: ViewField, layer: int, hypotheses: FloatArray, threads: int) -> tuple[FloatArray, float]:
    """Variance (hypothesis, t, s) of a layer over 3 × 3 places, and its median at the best hypothesis."""
    margin = field.margin(float(np.abs(hypotheses).max()))
    others = np.arange(len(field.u)) != field.centre
    u, v = field.u[others], field.v[others]
    views = padded(field.layers[others, layer, ..., None], margin)
    centre = cv2.sepFilter2D(field.layers[field.centre, layer], -1, _SPLINE, _SPLINE)[None].astype(np.float32)
    volume = np.empty((len(hypotheses), *field.shape), dtype=np.float32)
    sector = sectors(u, v)

    def band(span: tuple[int, int]) -> None:
        half_plane_volume(views, centre, u, v, sector, margin, hypotheses, span, volume)

    def box(h: int) -> None:
        volume[h] = cv2.blur(volume[h], (3, 3))

    each(band, bands(field.shape[0]), threads)
    each(box, range(len(hypotheses)), threads)
    return volume, max(float(np.median(np.maximum(volume.min(axis=0), 0))), 1e-9)
