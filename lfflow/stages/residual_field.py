"""Where and how far the measured subimage centres lie from their lattice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.errors import LfflowError
from lfflow.kernels.lattice import residual_field as kernel
from lfflow.kernels.lattice.centres import flatten_scene, measure_centres
from lfflow.kernels.lattice.fit import Fit
from lfflow.kernels.lattice.light_centres import measure_lenses
from lfflow.kernels.lattice.likelihood import refine
from lfflow.kernels.sensor.equalise import equalise
from lfflow.schema import distortion_of, lattice_of
from lfflow.schema.declarations import METHOD_FLAGS
from lfflow.stages.calibrate import site_indices

CELLS = ("cell_y", "cell_x")


def residual_field(raw: xr.Dataset, cal: xr.Dataset) -> xr.Dataset:
    """Mean residual of the centres in cells of the sensor, its noise, and the bend that the calibration corrects.

    Parameters
    ----------
    raw
        One raw frame (`lfflow.schema.RAW`); computed when it is lazy.
    cal
        Its calibration (`lfflow.schema.CALIBRATION`).

    Returns
    -------
    field
        ``x``, ``y`` (place), ``dx``, ``dy`` (mean of measured − lattice, right and down), ``std`` (of either mean, from
        the scatter within the cell), ``bend_x``, ``bend_y`` (the correction), all (cell_y, cell_x) float64 in sensor
        pixels, and ``count``. ``excess``: χ² per cell and direction of what the correction leaves, 1 for noise alone.

    Raises
    ------
    LfflowError
        The datasets hold several captures.
    """
    if "capture" in raw.dims or "capture" in cal.dims:
        raise LfflowError("the residual field is that of one capture: select it before")
    lattice, shape = lattice_of(cal), (raw.sizes["y"], raw.sizes["x"])
    field = kernel.residual_field(lattice, _measured(raw, cal), shape)
    bend = distortion_of(cal).displacement(field.x, field.y)
    parts = {"x": field.x, "y": field.y, "dx": field.dx, "dy": field.dy, "std": field.std}
    parts |= {"bend_x": bend[0], "bend_y": bend[1]}
    ds = xr.Dataset({name: (CELLS, values, {"units": "pixel"}) for name, values in parts.items()})
    ds["count"] = CELLS, field.count, {"long_name": "lenses of the cell", "units": "1"}
    left = (ds["dx"] - ds["bend_x"]) ** 2 + (ds["dy"] - ds["bend_y"]) ** 2
    return ds.assign(excess=(left / (2 * ds["std"] ** 2)).mean())


def _measured(raw: xr.Dataset, cal: xr.Dataset) -> npt.NDArray[np.float64]:
    """Centres (n, 2): by each lens's own light in a white image, by their peaks in a scene."""
    counts = np.ascontiguousarray(raw["raw"].transpose("y", "x").values)
    sites = site_indices(str(raw["cfa_pattern"].item()))
    black, white = (raw[name].values[sites].reshape(2, 2) for name in ("black_level", "white_level"))
    gray, _ = equalise(counts, np.asarray(black, dtype=np.float64))
    lattice = lattice_of(cal)
    if int(cal["method"]) == METHOD_FLAGS["self"]:
        return measure_centres(flatten_scene(gray, lattice.dh), lattice)
    levels = np.tile(white, (counts.shape[0] // 2 + 1, counts.shape[1] // 2 + 1))[: counts.shape[0], : counts.shape[1]]
    clipped = (counts >= levels).astype(np.uint8)
    first = Fit(lattice, cal["covariance"].values, float(cal["residual_rms"]), int(cal["lens_count"]))
    _, state = refine(gray, first, clipped)
    centres, _ = measure_lenses(gray, clipped, replace(state, lattice=lattice), distortion_of(cal))
    return np.asarray(centres[np.isfinite(centres[:, 0])], dtype=np.float64)
