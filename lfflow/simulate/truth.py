"""What the stages should find in a simulated capture: disparity and radiance of the views at the lenses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.cameras import CameraModel, view_radius
from lfflow.conventions import CHANNELS
from lfflow.lattice import Lattice
from lfflow.schema import lattice_variables
from lfflow.simulate import rays as kernels
from lfflow.simulate.optics import Optics, frame_of
from lfflow.simulate.render import THREADS
from lfflow.simulate.scene import Scene

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grid:
    """Lenses and views of the light field that a capture will become.

    Parameters
    ----------
    lattice
        Lattice, numbered for the grid.
    shape
        Rows and columns (t, s).
    radius
        Largest view offset, sensor pixels.
    height, width
        Sensor size, pixels.
    """

    lattice: Lattice
    shape: tuple[int, int]
    radius: int
    height: int
    width: int

    @classmethod
    def of(cls, lattice: Lattice, height: int, width: int, model: CameraModel | None = None) -> Grid:
        """Grid of a camera model where the sensor is that model's, else the smallest that covers the sensor."""
        shape, radius = lattice.grid_shape(height, width), view_radius(lattice.dh)
        if model is not None and (height, width) == (model.height, model.width):
            shape, radius = model.grid_shape, model.view_radius
        return cls(lattice.anchored(height, width, shape), shape, radius, height, width)

    def offsets(self, views: Sequence[int] | None) -> npt.NDArray[np.int64]:
        """View offsets: those asked for, or all."""
        return np.arange(-self.radius, self.radius + 1) if views is None else np.array(views, dtype=np.int64)

    def positions(self) -> tuple[FloatArray, FloatArray]:
        """Scene coordinates (X, Y) of the lenses, lens pitches, shape (t, s)."""
        frame = frame_of(self.lattice, self.height, self.width)
        t, s = np.meshgrid(np.arange(self.shape[0]), np.arange(self.shape[1]), indexing="ij")
        x = s + self.lattice.row_offset(t) - frame.origin_x
        return x, np.asarray(t * self.lattice.row_pitch - frame.origin_y, dtype=np.float64)

    def angle(self, v: int, u: int) -> tuple[float, float]:
        """Angular offset (a, b) of a view along the axes of the lattice, sensor pixels."""
        cos, sin = np.cos(self.lattice.theta), np.sin(self.lattice.theta)
        return float(cos * u + sin * v), float(cos * v - sin * u)

    def coords(self, offsets: npt.NDArray[np.int64]) -> dict[str, Any]:
        """Coordinates of views and lenses, and the scalars of the lattice."""
        return {
            "v": offsets,
            "u": offsets,
            "t": np.arange(self.shape[0]),
            "s": np.arange(self.shape[1]),
            **lattice_variables(self.lattice),
        }


def truth_disparity(grid: Grid, scene: Scene, views: Sequence[int] | None = None) -> xr.Dataset:
    """Disparity of what the chief ray of every lens meets.

    Parameters
    ----------
    views
        View offsets, the same in u and v; all by default.

    Returns
    -------
    Dataset
        disparity(v, u, t, s) float32, lens pitches per view step, NaN where a ray meets nothing.
    """
    offsets, (x, y), arrays = grid.offsets(views), grid.positions(), scene.arrays()
    disparity = np.empty((len(offsets), len(offsets), *grid.shape), dtype=np.float32)

    def fill(i: int, j: int) -> None:
        kernels.view_disparity(disparity[i, j], x, y, *grid.angle(offsets[i], offsets[j]), arrays)

    _over_views(len(offsets), fill)
    return xr.Dataset({"disparity": (("v", "u", "t", "s"), disparity)}, grid.coords(offsets))


def truth_views(grid: Grid, scene: Scene, optics: Optics, views: Sequence[int] | None = None) -> xr.Dataset:
    """Radiance of the views in all three channels, had the sensor no mosaic and no noise.

    It is averaged over the lens and the pixel just as a raw sample is.

    Returns
    -------
    Dataset
        rgb(v, u, t, s, channel) float32, linear camera colours, 1 is the white level at a subimage's peak.
    """
    offsets, (x, y), arrays, pencil = grid.offsets(views), grid.positions(), scene.arrays(), optics.ray_offsets()
    rgb = np.empty((len(offsets), len(offsets), *grid.shape, 3), dtype=np.float32)

    def fill(i: int, j: int) -> None:
        kernels.view_radiance(rgb[i, j], x, y, *grid.angle(offsets[i], offsets[j]), arrays, pencil)

    _over_views(len(offsets), fill)
    coords = {**grid.coords(offsets), "channel": list(CHANNELS)}
    return xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), rgb)}, coords)


def _over_views(count: int, work: Callable[[int, int], None]) -> None:
    """Call ``work(i, j)`` for every view, on a few threads."""
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(work, *np.indices((count, count)).reshape(2, -1).tolist()))
