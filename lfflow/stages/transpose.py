"""The disparity of every view from that of one (METHOD 8.6)."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from lfflow.kernels.transpose import transpose_map
from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.schema import DISPARITY
from lfflow.stages.on_field import LATTICE_NAMES


def transpose_disparity(disp: xr.Dataset, lf: xr.Dataset) -> xr.Dataset:
    """Disparity of every view of `lf` from that of its central view.

    Parameters
    ----------
    disp
        ``disparity``, ``disparity_std``, ``flags`` (t, s) of view (0, 0), as `lfflow.disparity` gives them.
    lf
        Light field (or views) whose ``v`` and ``u`` are wanted.

    Returns
    -------
    Dataset of `lfflow.schema.DISPARITY`: ``disparity``, ``disparity_std``, ``flags`` (v, u, t, s). The nearest surface
    wins; what the central view does not see is filled from the background and flagged occluded and filled.
    """
    v, u = np.asarray(lf["v"]), np.asarray(lf["u"])
    lattice = {name: (disp if name in disp.variables else lf)[name].variable for name in LATTICE_NAMES}

    def one_capture(
        disparity: Any, std: Any, flags: Any, t: Any, dh: Any, dv: Any, theta: Any, arrangement: Any
    ) -> Any:
        geometry = Lattice(float(dh), float(dv), float(theta), 0.0, 0.0, ARRANGEMENTS[int(arrangement)])
        return transpose_map(
            disparity, std, flags, (v, u), geometry.row_offset(t).astype(np.float32), geometry.row_pitch
        )

    maps = [disp[name].variable for name in ("disparity", "disparity_std", "flags")]
    maps = [one.chunk({"t": -1, "s": -1}) if one.chunks else one for one in maps]
    parts = xr.apply_ufunc(
        one_capture,
        *(xr.DataArray(one) for one in maps),
        xr.DataArray(np.asarray(disp["t"]), dims="t"),
        *(xr.DataArray(lattice[name]) for name in ("dh", "dv", "theta", "arrangement")),
        input_core_dims=[["t", "s"]] * 3 + [["t"]] + [[]] * 4,
        output_core_dims=[["v", "u", "t", "s"]] * 3,
        vectorize=True,
        dask="parallelized",
        output_dtypes=["float32", "float32", "uint8"],
        dask_gufunc_kwargs={"output_sizes": {"v": len(v), "u": len(u)}},
    )
    out = xr.Dataset(dict(zip(("disparity", "disparity_std", "flags"), parts, strict=True)))
    coords = {str(name): coord.variable for name, coord in disp.coords.items() if name not in ("u", "v")}
    out = out.assign_coords({**coords, **lattice, "v": ("v", v), "u": ("u", u)})
    out.attrs.update(disp.attrs)
    return DISPARITY.annotate(out)
