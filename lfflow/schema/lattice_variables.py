"""A `Lattice` in a dataset, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from lfflow.distortion import STRAIGHT, Distortion
from lfflow.lattice import ARRANGEMENTS, Lattice

PARAMETERS = ("dh", "dv", "theta", "cx", "cy")


def lattice_variables(lattice: Lattice) -> dict[str, Any]:
    """Scalar variables dh, dv, theta, cx, cy (float64) and arrangement (uint8 flag) of a lattice."""
    values: dict[str, Any] = {name: np.float64(getattr(lattice, name)) for name in PARAMETERS}
    values["arrangement"] = np.uint8(ARRANGEMENTS.index(lattice.arrangement))
    return values


def distortion_numbers(ds: xr.Dataset | xr.DataArray) -> xr.DataArray:
    """Numbers (axis, term) of the bend of a lattice, with the ``capture`` dim that they have; 0 where none is told."""
    if "distortion" not in ds.coords and (isinstance(ds, xr.DataArray) or "distortion" not in ds.variables):
        return xr.DataArray(STRAIGHT.numbers, dims=("axis", "term"))
    return ds["distortion"].reset_coords(drop=True).drop_vars(("axis", "term"), errors="ignore").fillna(0.0)


def distortion_of(ds: xr.Dataset | xr.DataArray) -> Distortion:
    """Bend of the lattice of one capture; computed when it is lazy."""
    return Distortion(distortion_numbers(ds).transpose("axis", "term").values)


def lattice_of(ds: xr.Dataset | xr.DataArray) -> Lattice:
    """Lattice of one capture; its six scalars are computed when they are lazy."""
    numbers = {name: float(ds[name]) for name in PARAMETERS}
    return Lattice(**numbers, arrangement=ARRANGEMENTS[int(ds["arrangement"])])
