"""The views of a full-colour light field as layers (detail and luminance), for the kernels that match them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from lfflow.kernels.full_colour.layers import detail_and_base
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ViewField:
    """Views with the central one among them.

    Parameters
    ----------
    layers
        (view, layer, t, s): detail, luminance.
    u, v
        (view,) offsets from the central view.
    guide
        (t, s, channel) picture of the central view.
    """

    layers: FloatArray
    u: IntArray
    v: IntArray
    guide: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """Rows t and columns s."""
        return self.guide.shape[0], self.guide.shape[1]

    @property
    def centre(self) -> int:
        """Index of the central view."""
        return int(np.flatnonzero((self.u == 0) & (self.v == 0))[0])

    def cross(self) -> ViewField:
        """The views of the central row and column; all of them where there are fewer than four."""
        chosen = (self.u == 0) | (self.v == 0)
        return self if chosen.sum() < 5 else ViewField(self.layers[chosen], self.u[chosen], self.v[chosen], self.guide)

    def star(self) -> ViewField:
        """The views of the central row and column and of both diagonals."""
        chosen = (self.u == 0) | (self.v == 0) | (np.abs(self.u) == np.abs(self.v))
        return ViewField(self.layers[chosen], self.u[chosen], self.v[chosen], self.guide)

    def halved(self) -> ViewField:
        """Half the size, so half the disparity."""
        rows, columns = (max(length // 2, 1) for length in self.shape)

        def smaller(picture: FloatArray) -> FloatArray:
            return np.asarray(cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32)

        layers = np.stack([[smaller(layer) for layer in view] for view in self.layers])
        return ViewField(layers, self.u, self.v, smaller(self.guide).reshape(rows, columns, -1))

    def margin(self, largest: float) -> int:
        """Padding that keeps shifts by `largest` times the farthest offset inside."""
        return math.ceil(largest * float(max(np.abs(self.u).max(), np.abs(self.v).max()))) + 4


def view_field(rgb: FloatArray, u: IntArray, v: IntArray, threads: int) -> ViewField:
    """Layers of the views (v, u, t, s, channel) that are there; the others hold NaN.

    Raises
    ------
    ValueError
        Without the central view, or without any other.
    """
    down, right = np.meshgrid(v, u, indexing="ij")
    there = np.isfinite(rgb[:, :, 0, 0, 0])
    central = (down == 0) & (right == 0)
    if not (there & central).any():
        raise ValueError("the central view (v=0, u=0) is missing")
    if not (there & ~central).any():
        raise ValueError("there is no second view to match with")
    places = np.argwhere(there)
    layers = np.empty((len(places), 2, *rgb.shape[2:4]), dtype=np.float32)

    def split(q: int) -> None:
        j, i = places[q]
        detail_and_base(np.ascontiguousarray(rgb[j, i]), layers[q])

    each(split, range(len(places)), threads)
    guide = np.ascontiguousarray(rgb[there & central][0])
    return ViewField(layers, right[there].astype(np.int64), down[there].astype(np.int64), guide)
