"""What the samples of a light field tell about themselves: clipped, off by the rounding, usable, renamed."""

from __future__ import annotations

import numpy as np
import xarray as xr

from lfflow.conventions import CFA_NONE, FROM_LFTOOLBOX, LENS_DIMS, TO_LFTOOLBOX, VIEW_DIMS
from lfflow.distortion import Distortion
from lfflow.kernels.sensor.demultiplex import MIN_VIGNETTING, residuals
from lfflow.schema import LIGHTFIELD, PARAMETERS, distortion_numbers
from lfflow.stages.demultiplex import lattices_from


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


def usable_views(lf: xr.Dataset) -> xr.DataArray:
    """True for the views (v, u) with a sample at half of the lenses on the sensor at least; ``view_usable`` if known.

    Below a vignetting of `MIN_VIGNETTING` there are no samples, so that the median weight of the others reaches it.
    """
    if "view_usable" in lf.variables:
        return lf["view_usable"]
    present = lf["cfa"] != CFA_NONE
    on_sensor = present.any(VIEW_DIMS).sum(LENS_DIMS)
    counts = present.sum(LENS_DIMS)
    usable: xr.DataArray = ((counts > 0) & (2 * counts >= on_sensor)).rename("view_usable")
    usable.attrs = LIGHTFIELD["view_usable"].attrs
    return usable


def usable_reach(lf: xr.Dataset) -> int:
    """Largest offset r whose views (0, ±r) and (±r, 0) are usable, and all between them.

    The square of the views −r…r is what exports and pictures show.
    """
    usable = usable_views(lf)
    arms = (
        {int(u): usable.sel(v=0, u=u) for u in lf["u"].values},
        {int(v): usable.sel(v=v, u=0) for v in lf["v"].values},
    )
    reach = 0
    while all(bool(arm.get(side, False)) for arm in arms for side in (-reach - 1, reach + 1)):
        reach += 1
    return reach


def only_usable(lf: xr.Dataset) -> xr.Dataset:
    """Light field without the samples of the views that are not usable; lazy where `lf` is."""
    usable = usable_views(lf).reset_coords(drop=True)
    empty = {"mosaic": np.float32(np.nan), "cfa": np.uint8(CFA_NONE), "weight": np.float32(0)}
    kept = {name: lf[name].where(usable, none).transpose(*lf[name].dims) for name, none in empty.items()}
    return lf.assign(kept)


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
