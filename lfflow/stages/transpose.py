"""The disparity of every view from that of one, or from the maps of several (METHOD 8.6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from lfflow.kernels.transpose import SourceMap, transpose_maps
from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.schema import DISPARITY, lattice_variables
from lfflow.stages.on_field import LATTICE_NAMES

_MAP = ("disparity", "disparity_std", "flags")
PIXELS = Lattice(1.0, 1.0, 0.0, 0.0, 0.0, "square")
"""Lattice of full-colour views, whose places are pixels."""


def transpose_disparity(disp: xr.Dataset | Sequence[xr.Dataset], lf: xr.Dataset) -> xr.Dataset:
    """Disparity of every view of `lf` from that of its central view, or from those of several views.

    Parameters
    ----------
    disp
        ``disparity``, ``disparity_std``, ``flags`` (t, s) of the view of their scalar coordinates ``u``, ``v`` (the
        central one where there are none), as `lfflow.disparity` gives them, or a sequence of such maps of several
        views, which are fused: what most of them contradict is left out, and what is hidden from one is taken from
        another.
    lf
        Light field (or full-colour views) whose ``v`` and ``u`` are wanted.

    Returns
    -------
    Dataset of `lfflow.schema.DISPARITY`: ``disparity``, ``disparity_std``, ``flags`` (v, u, t, s), lazy where `disp`
    is. The nearest surface wins; what no map sees is filled from the background and flagged occluded and filled, and
    so are filled places that do not agree with the map they are carried back to.

    Raises
    ------
    ValueError
        `disp` is empty.

    Examples
    --------
    >>> places = [(0, 0), (-2, 0), (2, 0), (0, -2), (0, 2)]  # doctest: +SKIP
    >>> maps = [lfflow.disparity(lf, u=u, v=v) for u, v in places]  # doctest: +SKIP
    >>> every = lfflow.transpose_disparity(maps, lf)  # doctest: +SKIP
    """
    given = [disp] if isinstance(disp, xr.Dataset) else list(disp)
    if not given:
        raise ValueError("no disparity map given")
    first = given[0]
    v, u = np.asarray(lf["v"]), np.asarray(lf["u"])
    places = [(int(one.coords.get("u", 0)), int(one.coords.get("v", 0))) for one in given]
    lattice = _lattice(first, lf)

    def one_capture(*arrays: Any) -> Any:
        *values, t, dh, dv, theta, cx, cy, arrangement = arrays
        numbers = float(dh), float(dv), float(theta), float(cx), float(cy)
        geometry = Lattice(*numbers, ARRANGEMENTS[int(arrangement)])
        maps = zip(values[0::3], values[1::3], values[2::3], places, strict=True)
        sources = [SourceMap(d, std, flags, *place) for d, std, flags, place in maps]
        return transpose_maps(sources, (v, u), geometry.row_offset(t).astype(np.float32), geometry.row_pitch)

    maps = [one[name].variable for one in given for name in _MAP]
    maps = [one.chunk({"t": -1, "s": -1}) if one.chunks else one for one in maps]
    parts = xr.apply_ufunc(
        one_capture,
        *(xr.DataArray(one) for one in maps),
        xr.DataArray(np.asarray(first["t"]), dims="t"),
        *(xr.DataArray(variable) for variable in lattice.values()),
        input_core_dims=[["t", "s"]] * len(maps) + [["t"]] + [[]] * len(lattice),
        output_core_dims=[["v", "u", "t", "s"]] * 3,
        vectorize=True,
        dask="parallelized",
        output_dtypes=["float32", "float32", "uint8"],
        dask_gufunc_kwargs={"output_sizes": {"v": len(v), "u": len(u)}},
    )
    out = xr.Dataset(dict(zip(_MAP, parts, strict=True)))
    out = out.assign_coords(t=np.asarray(first["t"]), s=np.asarray(first["s"]))
    coords = {str(name): coord.variable for name, coord in first.coords.items() if name not in ("u", "v")}
    out = out.assign_coords({**coords, **lattice, "v": ("v", v), "u": ("u", u)})
    out.attrs.update(first.attrs)
    return DISPARITY.annotate(out)


def _lattice(disp: xr.Dataset, lf: xr.Dataset) -> dict[str, xr.Variable]:
    """Lattice of the map: its own, that of the light field, or that of the pixels of full-colour views."""
    for data in (disp, lf):
        if all(name in data.variables for name in LATTICE_NAMES):
            return {name: data[name].variable for name in LATTICE_NAMES}
    return {name: xr.Variable((), value) for name, value in lattice_variables(PIXELS).items()}
