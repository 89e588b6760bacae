"""A raw capture out of somebody else's light field with ground truth (METHOD 10.5)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.kernels.sensor.demultiplex import round_to_pixel
from lfflow.kernels.transpose import SourceMap, transpose_maps
from lfflow.lattice import Lattice
from lfflow.schema import lattice_variables
from lfflow.simulate.body import BODIES, Body, Setting
from lfflow.simulate.metadata import raw_dataset
from lfflow.simulate.optics import Optics
from lfflow.simulate.render import illumination
from lfflow.simulate.truth import Grid

FloatArray = npt.NDArray[np.floating]


def simulate_from_views(
    views: xr.Dataset,
    disparity: xr.DataArray | None = None,
    *,
    seed: int = 0,
    camera: str | Body = "f01",
    noise: bool = True,
    capture: str = "VIEWS_0001",
) -> tuple[xr.Dataset, xr.Dataset]:
    """Resample a folder-of-views light field through the mosaic of a plenoptic camera.

    One pixel of the views becomes one lens pitch. The sensor pixel at the integer offset (u, v) from the rounded lens
    centre looks through aperture (u, v) + ρ with the residual ρ of the rounding. There a point of disparity d has moved
    on by d·ρ, so its colour is read in view (u, v) that much aside (cubic spline), with the d of the surface that this
    view sees at the lens. Pixels beyond the views are dark.

    Parameters
    ----------
    views
        rgb(v, u, t, s, channel) on the square grid, linear radiance in camera colours.
    disparity
        Ground truth (t, s) of the central view, pixels per view step. Without it all is taken to lie where the views
        agree (d = 0).
    seed, camera, noise, capture
        As for `simulate_capture`.

    Returns
    -------
    raw : Dataset
        As the engine "lfp" gives it.
    truth : Dataset
        The lattice's scalars; disparity(t, s) at the lenses when ground truth is given (nearest pixel, NaN beyond).
    """
    body = BODIES[camera] if isinstance(camera, str) else camera
    setting = Setting()
    rgb = views["rgb"].transpose("v", "u", "t", "s", "channel")
    own = body.lattice(setting, 400, 400)
    lattice = Lattice(own.dh, own.dv, own.theta, own.dh / 2, own.dv / 2)
    height, width = (2 * int(rgb.sizes[dim] * own.dh / 2) for dim in ("t", "s"))
    levels = _levels(rgb, _surfaces(rgb, disparity), lattice, body, height, width) * illumination(
        lattice, Optics(), height, width
    )
    generator = np.random.default_rng([seed, 5]) if noise else None
    samples = body.sensor_at(setting).digitise(levels.astype(np.float32), generator)
    time = np.datetime64("2012-08-15T04:47:08.000")
    raw = raw_dataset(samples, body, setting, capture=capture, kind="scene", time=time)
    grid = Grid.of(lattice, height, width)
    truth = xr.Dataset(coords={"capture": capture, **lattice_variables(grid.lattice)})
    if disparity is not None:
        truth["disparity"] = (("t", "s"), _at_lenses(disparity.transpose("t", "s").values, lattice, grid))
    return raw, truth


def _surfaces(rgb: xr.DataArray, disparity: xr.DataArray | None) -> npt.NDArray[np.float32]:
    """Disparity (v, u, t, s) of what every view sees, the nearest surface first."""
    shape = tuple(rgb.sizes[dim] for dim in ("t", "s"))
    centre = np.zeros(shape, np.float32) if disparity is None else disparity.transpose("t", "s").values
    blank = np.zeros(shape, np.float32)
    views = (np.asarray(rgb["v"]), np.asarray(rgb["u"]))
    source = SourceMap(centre, blank, blank.astype(np.uint8), 0, 0)
    seen, _, _ = transpose_maps([source], views, blank[:, 0], 1.0)
    return np.nan_to_num(seen)


def _levels(
    rgb: xr.DataArray, surfaces: npt.NDArray[np.float32], lattice: Lattice, body: Body, height: int, width: int
) -> FloatArray:
    """Radiance (y, x) in the colour of every sensor pixel, from its own place in the aperture."""
    from scipy.ndimage import map_coordinates

    y, x = np.mgrid[:height, :width]
    t, s = lattice.nearest(x, y)
    cx, cy = lattice.centres(t, s)
    pixel_x, pixel_y = round_to_pixel(cx), round_to_pixel(cy)
    v, u, rho_y, rho_x = y - pixel_y, x - pixel_x, pixel_y - cy, pixel_x - cx
    channel = body.sensor.cfa[y % 2, x % 2]
    row, column = t * lattice.row_pitch, s + lattice.row_offset(t)
    levels = np.zeros((height, width))
    for i, view_v in enumerate(rgb["v"].values):
        for j, view_u in enumerate(rgb["u"].values):
            here = (v == view_v) & (u == view_u)
            d = map_coordinates(surfaces[i, j], (row[here], column[here]), order=0, mode="nearest")
            place = np.array([row[here] + d * rho_y[here], column[here] + d * rho_x[here]])
            view, colour, value = rgb[i, j].values, channel[here], np.empty(d.shape)
            for c in range(3):
                mine = colour == c
                value[mine] = map_coordinates(view[..., c], place[:, mine], order=3, mode="nearest")
            levels[here] = np.maximum(value, 0)
    return levels


def _at_lenses(values: FloatArray, lattice: Lattice, grid: Grid) -> npt.NDArray[np.float32]:
    """Values (t, s) of the views' pixels at the lenses of a grid, NaN beyond the picture."""
    t, s = np.meshgrid(np.arange(grid.shape[0]), np.arange(grid.shape[1]), indexing="ij")
    own_t, own_s = lattice.nearest(*grid.lattice.centres(t, s))
    row = np.rint(own_t * lattice.row_pitch).astype(np.int64)
    column = np.rint(own_s + lattice.row_offset(own_t)).astype(np.int64)
    inside = (row >= 0) & (row < values.shape[0]) & (column >= 0) & (column < values.shape[1])
    found = np.full(grid.shape, np.nan, dtype=np.float32)
    found[inside] = values[row[inside], column[inside]]
    return found
