"""A `Lattice` in a dataset, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from lfflow.lattice import ARRANGEMENTS, Lattice

PARAMETERS = ("dh", "dv", "theta", "cx", "cy")


def lattice_variables(lattice: Lattice) -> dict[str, Any]:
    """Scalar variables dh, dv, theta, cx, cy (float64) and arrangement (uint8 flag) of a lattice."""
    values: dict[str, Any] = {name: np.float64(getattr(lattice, name)) for name in PARAMETERS}
    values["arrangement"] = np.uint8(ARRANGEMENTS.index(lattice.arrangement))
    return values


def lattice_of(ds: xr.Dataset | xr.DataArray) -> Lattice:
    """Lattice of one capture; its six scalars are computed when they are lazy."""
    numbers = {name: float(ds[name]) for name in PARAMETERS}
    return Lattice(**numbers, arrangement=ARRANGEMENTS[int(ds["arrangement"])])
