"""The microlens lattice: where every lens centre lies on the sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

Arrangement = Literal["hexagonal", "square"]
ARRANGEMENTS: tuple[Arrangement, ...] = ("hexagonal", "square")

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Lattice:
    """Five numbers that place every microlens (`lfflow.conventions`, seed chapter 6.1).

    Parameters
    ----------
    dh, dv
        Horizontal and vertical pitch, sensor pixels.
    theta
        Rotation, radians.
    cx, cy
        Centre of lens (t=0, s=0), sensor pixels.
    arrangement
        "hexagonal" (brick layout) or "square".
    """

    dh: float
    dv: float
    theta: float
    cx: float
    cy: float
    arrangement: Arrangement = "hexagonal"

    @property
    def matrix(self) -> FloatArray:
        """T: lattice indices (k1, k2) to sensor pixels (x, y), shape (2, 2)."""
        basis = [[1.0, 0.5], [0.0, math.sqrt(3) / 2]] if self.arrangement == "hexagonal" else [[1.0, 0.0], [0.0, 1.0]]
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        rotation = np.array([[cos, -sin], [sin, cos]])
        matrix: FloatArray = rotation @ np.diag([self.dh, self.dv]) @ np.array(basis)
        return matrix

    @property
    def row_pitch(self) -> float:
        """Distance of two lens rows in units of dh: (√3/2)·dv/dh, or dv/dh when square."""
        return (math.sqrt(3) / 2 if self.arrangement == "hexagonal" else 1.0) * self.dv / self.dh

    def row_offset(self, t: npt.ArrayLike) -> FloatArray:
        """X of lens s=0 in row t, in lens pitches: ½ on the odd rows of the brick layout, else 0."""
        rows = np.asarray(t)
        return 0.5 * (rows % 2) if self.arrangement == "hexagonal" else np.zeros(rows.shape)

    def centres(self, t: npt.ArrayLike, s: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Centres (x, y) of the lenses (t, s) in sensor pixels; t and s broadcast."""
        t, s = np.asarray(t), np.asarray(s)
        k1 = s - t // 2 if self.arrangement == "hexagonal" else s
        (a, b), (c, d) = self.matrix
        return a * k1 + b * t + self.cx, c * k1 + d * t + self.cy

    def nearest(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[IntArray, IntArray]:
        """Lens (t, s) whose centre is nearest to the sensor point (x, y) in the metric of the lattice.

        The metric is that of the undistorted lattice, so that the cells are the Voronoi cells of equilateral
        triangles (or squares) whatever the pitches.
        """
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        px, py = x - self.cx, y - self.cy
        gx, gy = (cos * px + sin * py) / self.dh, (-sin * px + cos * py) / self.dv
        if self.arrangement == "square":
            return np.floor(gy + 0.5).astype(np.int64), np.floor(gx + 0.5).astype(np.int64)
        height = math.sqrt(3) / 2
        low = np.floor(gy / height).astype(np.int64)
        best_t = best_s = np.zeros(low.shape, dtype=np.int64)
        best = np.full(low.shape, np.inf)
        for t in (low, low + 1):
            s = np.floor(gx - 0.5 * (t % 2) + 0.5).astype(np.int64)
            distance = (gx - s - 0.5 * (t % 2)) ** 2 + (gy - height * t) ** 2
            closer = distance < best
            best = np.where(closer, distance, best)
            best_t, best_s = np.where(closer, t, best_t), np.where(closer, s, best_s)
        return best_t, best_s

    def grid_shape(self, height: int, width: int) -> tuple[int, int]:
        """Rows and columns (t, s) of the centred grid that holds the nearest lens of every pixel of a sensor.

        From the sensor's centre to its edge, the numbers of rows and columns grow by the distance of the middle lens
        from the centre and by that of the last lens from the edge: each up to half a lens, or two thirds of a row
        (the corner of a hexagonal cell), and by the half lens of the odd rows.
        """
        hexagonal = self.arrangement == "hexagonal"
        tilt = abs(math.tan(self.theta))
        row_step = self.dh * self.row_pitch
        above = math.floor((height + width * tilt) / (2 * row_step) + (4 / 3 if hexagonal else 1))
        left = math.floor((width + height * tilt) / (2 * self.dh) + (1.5 if hexagonal else 1))
        return 2 * above + 1, 2 * left + 1

    def anchored(self, height: int, width: int, shape: Sequence[int] | None = None) -> Lattice:
        """Same lattice, renumbered so that a grid of `shape` (rows, columns) lies centred on the sensor.

        Lens (rows // 2, columns // 2) becomes the one nearest to the sensor's centre. Without `shape` the grid is that
        of `grid_shape`. The result does not depend on how the lattice was numbered before.
        """
        rows, columns = self.grid_shape(height, width) if shape is None else (shape[0], shape[1])
        middle_x, middle_y = (width - 1) / 2, (height - 1) / 2
        t, s = self.nearest(middle_x, middle_y)
        centre_x, centre_y = self.centres(t, s)
        from_origin_x, from_origin_y = replace(self, cx=0.0, cy=0.0).centres(rows // 2, columns // 2)
        return replace(self, cx=float(centre_x - from_origin_x), cy=float(centre_y - from_origin_y))

    def distance_to(self, other: Lattice, height: int, width: int) -> float:
        """Root mean square distance of the lens centres over the sensor, up to whole lenses, in sensor pixels."""
        mine = self.anchored(height, width)
        rows, columns = mine.grid_shape(height, width)
        t, s = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
        x, y = mine.centres(t, s)
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        near_x, near_y = other.centres(*other.nearest(x[inside], y[inside]))
        return float(np.sqrt(np.mean((near_x - x[inside]) ** 2 + (near_y - y[inside]) ** 2)))
