"""What the samples of a light field tell about themselves: clipped, off by the rounding, usable, renamed."""

from __future__ import annotations

import numpy as np
import xarray as xr

from lfflow.conventions import CFA_NONE, FROM_LFTOOLBOX, LENS_DIMS, TO_LFTOOLBOX
from lfflow.distortion import Distortion
from lfflow.kernels.demultiplex import MIN_VIGNETTING, residuals
from lfflow.schema import PARAMETERS, distortion_numbers
from lfflow.stages.demultiplex import lattices_from

USABLE_WEIGHT = 0.1
"""A view is usable when the mean weight of its lenses on the sensor is at least this."""


def saturated(lf: xr.Dataset) -> xr.DataArray:
    """True where a sample was clipped by the sensor, dims of ``weight``."""
    return ((lf["weight"] > 0) & (lf["weight"] < MIN_VIGNETTING)).rename("saturated")


def residual(lf: xr.Dataset) -> xr.Dataset:
    """Residual ρ = rounded centre − centre of every lens: ``rho_x``, ``rho_y`` (t, s), sensor pixels (METHOD 7).

    Sample (u, v) of a lens was taken at the place (u, v) + ρ of the aperture. Lazy where the lattice is.
    """
    shape = (lf.sizes["t"], lf.sizes["s"])
    rho = xr.apply_ufunc(
        _residual_block,
        distortion_numbers(lf),
        *(lf[name].reset_coords(drop=True) for name in (*PARAMETERS, "arrangement")),
        kwargs={"t": lf["t"].values, "s": lf["s"].values},
        input_core_dims=[("axis", "term"), *[()] * 6],
        output_core_dims=[LENS_DIMS, LENS_DIMS],
        dask="parallelized",
        output_dtypes=[np.float64, np.float64],
        dask_gufunc_kwargs={"output_sizes": dict(zip(LENS_DIMS, shape, strict=True))},
    )
    ds = xr.Dataset(dict(zip(("rho_x", "rho_y"), rho, strict=True))).assign_coords(t=lf["t"], s=lf["s"])
    for name, axis in (("rho_x", "right"), ("rho_y", "down")):
        ds[name].attrs = {"long_name": f"rounding of the lens centre, {axis}", "units": "pixel"}
    return ds


def usable_views(lf: xr.Dataset, least: float = USABLE_WEIGHT) -> xr.DataArray:
    """True for the views (v, u) whose mean weight, over the lenses that lie on the sensor, is at least `least`."""
    on_sensor = (lf["cfa"] != CFA_NONE).any(("v", "u"))
    usable: xr.DataArray = (lf["weight"].where(on_sensor).mean(LENS_DIMS) >= least).rename("usable_view")
    return usable.assign_attrs(long_name="view with enough light", units="1")


def to_lftoolbox(lf: xr.Dataset) -> xr.Dataset:
    """Same data under the letters of LFToolbox: views (t, s), lenses (v, u), in this order."""
    return lf.rename(TO_LFTOOLBOX).transpose(..., "t", "s", "v", "u", "channel", "channel_in", missing_dims="ignore")


def from_lftoolbox(lf: xr.Dataset) -> xr.Dataset:
    """Data under the letters of LFToolbox back to lfflow's: views (v, u), lenses (t, s)."""
    return lf.rename(FROM_LFTOOLBOX).transpose(..., "v", "u", "t", "s", "channel", "channel_in", missing_dims="ignore")


def _residual_block(distortion, *numbers, t, s):  # type: ignore[no-untyped-def]
    outer = np.broadcast_shapes(distortion.shape[:-2], *(np.shape(number) for number in numbers))
    bends = np.broadcast_to(distortion, outer + distortion.shape[-2:]).reshape(-1, *distortion.shape[-2:])
    lattices = lattices_from([np.broadcast_to(number, outer) for number in numbers])
    found = [residuals(lattice, t, s, Distortion(bend)) for lattice, bend in zip(lattices, bends, strict=True)]
    return tuple(np.array([pair[axis] for pair in found]).reshape((*outer, len(t), len(s))) for axis in (0, 1))
