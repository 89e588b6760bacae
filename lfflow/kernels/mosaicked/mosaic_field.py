"""One mosaicked light field as plain arrays, with the true place of every sample."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.distortion import STRAIGHT, Distortion
from lfflow.kernels.sensor.demultiplex import residuals
from lfflow.lattice import Lattice

FloatArray = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]


class MosaicField(NamedTuple):
    """Samples (v, u, t, s) and the geometry they lie on.

    Parameters
    ----------
    mosaic, cfa, weight
        (v, u, t, s): radiance (0 where there is none), colour (255 none), confidence (0 where there is none).
    u, v
        (u,), (v,): view offsets, sensor pixels.
    offset
        (t,): X of lens s=0 of each row, in lens pitches: 0 or ½.
    row_pitch
        Distance of two rows, in lens pitches.
    rho
        (2, t, s): residual (x, y) of the rounded lens centre, sensor pixels: a sample of view (u, v) was taken at
        (u, v) + rho.
    """

    mosaic: FloatArray
    cfa: ByteArray
    weight: FloatArray
    u: npt.NDArray[np.int64]
    v: npt.NDArray[np.int64]
    offset: FloatArray
    row_pitch: float
    rho: FloatArray

    def view(self, u: int, v: int) -> tuple[FloatArray, ByteArray, FloatArray]:
        """Mosaic, cfa and weight (t, s) of one view; ValueError when the field has no such view."""
        columns, rows = np.flatnonzero(self.u == u), np.flatnonzero(self.v == v)
        if not columns.size or not rows.size:
            raise ValueError(f"no view u={u}, v={v}: the field has u {self.u.tolist()}, v {self.v.tolist()}")
        at = (rows[0], columns[0])
        return self.mosaic[at], self.cfa[at], self.weight[at]

    def views(self, nearest: float = 0, farthest: float = math.inf) -> list[tuple[int, int]]:
        """Places (v, u) in the arrays of the views with a sample, `nearest` ≤ distance from the centre < `farthest`."""
        away = np.hypot(*np.meshgrid(self.v, self.u, indexing="ij"))
        wanted = (self.cfa != CFA_NONE).any(axis=(2, 3)) & (away >= nearest) & (away < farthest)
        return [(int(j), int(i)) for j, i in np.argwhere(wanted)]

    def aperture(self) -> float:
        """Radius of the aperture, sensor pixels: that of the even disc with the second moment of the views' weight."""
        light = self.weight.sum(axis=(2, 3), dtype=np.float64)
        square = np.add.outer(self.v**2, self.u**2)
        return float(np.sqrt(2 * (light * square).sum() / max(light.sum(), 1e-12)))

    @property
    def brick(self) -> bool:
        """Whether every other row lies half a lens aside."""
        return bool(self.offset.max() > 0)

    def has(self, u: int, v: int) -> bool:
        """Whether the field holds this view."""
        return bool((self.u == u).any() and (self.v == v).any())


def mosaic_field(
    mosaic: npt.NDArray[Any],
    cfa: npt.NDArray[Any],
    weight: npt.NDArray[Any],
    axes: tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]],
    lattice: Lattice,
    distortion: Distortion = STRAIGHT,
) -> MosaicField:
    """Field of the samples (v, u, t, s) with the coordinates `axes` = (v, u, t, s); places without sample are cleared.

    The inputs are not changed. A sample is missing where its cfa is 255, its radiance is not finite or its weight
    is not positive.
    """
    v, u, t, s = axes
    with np.errstate(invalid="ignore"):
        present = (cfa != CFA_NONE) & np.isfinite(mosaic) & (weight > 0)
    rho = np.stack(residuals(lattice, t, s, distortion)).astype(np.float32)
    return MosaicField(
        np.where(present, mosaic, 0).astype(np.float32, copy=False),
        np.where(present, cfa, CFA_NONE).astype(np.uint8, copy=False),
        np.where(present, weight, 0).astype(np.float32, copy=False),
        np.asarray(u, dtype=np.int64),
        np.asarray(v, dtype=np.int64),
        lattice.row_offset(t).astype(np.float32),
        lattice.row_pitch,
        rho,
    )


@numba.njit(nogil=True, cache=True, inline="always")
def shown_by(t, s, d, u, v, offset, pitch):  # type: ignore[no-untyped-def]
    """Row and column of the lens at which view (u, v) shows what the central view shows at lens (t, s), disparity `d`.

    They may lie outside of the field, the column is -1 where the row does, and `d` must not be NaN.
    """
    half = np.float32(0.5)
    row = int(np.floor(np.float32(t) - d * (v / pitch) + half))
    if row < 0 or row >= offset.shape[0]:
        return row, -1
    return row, int(np.floor(np.float32(s) + offset[t] - d * u - offset[row] + half))
