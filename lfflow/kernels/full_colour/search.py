"""First disparity of a full-colour light field: bounded costs of all hypotheses, aggregated semi-globally."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lfflow.kernels.aggregate import accumulate, winner
from lfflow.kernels.full_colour.cost import disagreement, padded, sectors
from lfflow.kernels.full_colour.cost_filter import CostFilter
from lfflow.kernels.full_colour.field import ViewField
from lfflow.kernels.full_colour.spline import smoothed
from lfflow.kernels.threads import bands, each

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

_GLOSS = 1 / 255
"""Luminance difference of a place between views that may be gloss."""
_SHARE = 0.3
"""Weight of the luminance against the detail: it sees edges that are too strong to be detail."""
_SAMPLED, _EVERY = 4, 32
"""Rows of each band that the noise is measured on."""
_OPEN = 1e6
"""Tolerance at which nothing is bounded."""
_EDGE = 0.05
_FLAT = 1e-5
"""Variance of the luminance below which nothing is an edge."""
_NOISY, _MUCH, _MOST = 0.2, 0.4, 0.8
"""Noise, in units of the texture, from which on the diagonals are matched too; that doubles the penalty of a jump; and
the most that is made of it."""


class Found(NamedTuple):
    """First disparity of a field.

    Parameters
    ----------
    disparity, sure
        (t, s), and whether its cost tells it from others.
    scale
        (layer,) factors after which a layer differs between views by about 1 at the right disparity.
    edge
        Variance of the luminance that is no edge.
    noisy
        Variance of the noise of the detail, in units of that of the texture; limited.
    """

    disparity: FloatArray
    sure: npt.NDArray[np.bool_]
    scale: FloatArray
    edge: float
    noisy: float


@dataclass(frozen=True, slots=True)
class _Matching:
    """Views around the centre, ready to be compared with it."""

    views: FloatArray
    centre: FloatArray
    u: IntArray
    v: IntArray
    margin: int

    def volume(
        self, hypotheses: FloatArray, spans: list[tuple[int, int]], tolerance: float, threads: int
    ) -> FloatArray:
        """Cost (hypothesis, t, s) of the rows of the spans; the others are not written."""
        out = np.empty((len(hypotheses), *self.centre.shape[1:]), dtype=np.float32)
        sector = sectors(self.u, self.v)

        def fill(span: tuple[int, int]) -> None:
            disagreement(self.views, self.centre, self.u, self.v, sector, self.margin, hypotheses, span,
                         np.float32(tolerance), out)  # fmt: skip

        each(fill, spans, threads)
        return out


def _matching(field: ViewField, layers: FloatArray, largest: float) -> _Matching:
    """Matching of `layers` (view, layer, t, s) of a field."""
    margin = field.margin(largest)
    others = np.arange(len(field.u)) != field.centre
    centre = smoothed(layers[field.centre])
    return _Matching(padded(layers[others], margin), centre, field.u[others], field.v[others], margin)


def search(field: ViewField, hypotheses: FloatArray, small: float, large: float, threads: int) -> Found:
    """Disparity of the cheapest smooth surface through the costs of the central row and column of views.

    The more noise, the less a cost says of jumps, and the more they cost.

    Parameters
    ----------
    hypotheses
        (hypothesis,) equally spaced disparities, ascending.
    small, large
        Penalties of the aggregation, `lfflow.kernels.aggregate.regularise`.
    """
    largest = float(np.abs(hypotheses).max())
    cross = field.cross()
    detail, luminance = (_noise(cross, layer, hypotheses, threads) for layer in (0, 1))
    scale = np.sqrt(np.array([1 / detail, _SHARE / max(luminance, _GLOSS**2)], dtype=np.float32))
    noisy = min(detail / _texture(field), _MOST)
    chosen = field.star() if noisy > _NOISY else cross
    matching = _matching(chosen, chosen.layers * scale[:, None, None], largest)
    cost = matching.volume(hypotheses, bands(field.shape[0]), 1.0, threads)
    flat = max(_FLAT, detail)
    along_edges = CostFilter(field.layers[field.centre, 1], flat)

    def smooth(h: int) -> None:
        cost[h] = along_edges(cost[h])

    each(smooth, range(len(hypotheses)), threads)
    total, unit = accumulate(cost, field.guide, small=small, large=large * (1 + (noisy / _MUCH) ** 2), edge=_EDGE,
                             threads=threads)  # fmt: skip
    sure = cost.mean(axis=0) - cost.min(axis=0) > 0.5 * unit
    return Found(np.nan_to_num(winner(total, hypotheses)), sure, scale, flat, noisy)


def _texture(field: ViewField) -> float:
    """Variance of the detail of the central view, from its median square: edges are few."""
    detail = smoothed(field.layers[field.centre, :1])
    return max(float(np.median(detail * detail)) / 0.455, 1e-9)


def _noise(field: ViewField, layer: int, hypotheses: FloatArray, threads: int) -> float:
    """Median squared difference of a layer to the centre at the best hypothesis, on a sample of the rows."""
    rows = field.shape[0]
    spans = [(first, min(first + _SAMPLED, rows)) for first in range(min(_EVERY, rows) // 2, rows, _EVERY)]
    matching = _matching(field, field.layers[:, layer : layer + 1], float(np.abs(hypotheses).max()))
    cost = matching.volume(hypotheses, spans, _OPEN, threads)
    best = np.concatenate([cost[:, first:last].min(axis=0).ravel() for first, last in spans])
    return max(_OPEN * float(np.median(best)), 1e-9)
