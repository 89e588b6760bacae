"""A function of one capture's arrays applied to a light field, lazily and with or without a ``capture`` dim."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.conventions import FIELD_DIMS
from lfflow.distortion import Distortion
from lfflow.errors import SchemaError
from lfflow.kernels.mosaicked.mosaic_field import MosaicField, mosaic_field
from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.schema import PARAMETERS, distortion_numbers

LATTICE_NAMES = (*PARAMETERS, "arrangement")
_SAMPLES = ("mosaic", "cfa", "weight")


def on_field(
    function: Callable[[MosaicField], tuple[npt.NDArray[Any], ...]],
    lf: xr.Dataset,
    outputs: Sequence[tuple[tuple[str, ...], str]],
    sizes: Mapping[str, int],
) -> tuple[xr.DataArray, ...]:
    """Arrays that `function` makes of the field of each capture; nothing is computed before they are asked for.

    Parameters
    ----------
    outputs
        Dims and dtype of each array.
    sizes
        Length of the dims that the light field does not have.
    """
    missing = [name for name in (*_SAMPLES, *LATTICE_NAMES, *FIELD_DIMS) if name not in lf.variables]
    if missing:
        raise SchemaError(f"dataset is no light field: it has no {', '.join(missing)}")

    def one_capture(*arrays: Any) -> Any:
        mosaic, cfa, weight, v, u, t, s, bend, dh, dv, theta, cx, cy, arrangement = arrays
        numbers = float(dh), float(dv), float(theta), float(cx), float(cy)
        lattice = Lattice(*numbers, ARRANGEMENTS[int(arrangement)])
        out = function(mosaic_field(mosaic, cfa, weight, (v, u, t, s), lattice, Distortion(bend)))
        return out if len(out) > 1 else out[0]

    samples = [lf[name].variable for name in _SAMPLES]
    whole = [sample.chunk(dict.fromkeys(FIELD_DIMS, -1)) if sample.chunks else sample for sample in samples]
    arrays = [
        *(xr.DataArray(variable) for variable in whole),
        *(xr.DataArray(np.asarray(lf[dim]), dims=dim) for dim in FIELD_DIMS),
        distortion_numbers(lf),
        *(xr.DataArray(lf[name].variable) for name in LATTICE_NAMES),
    ]
    result = xr.apply_ufunc(
        one_capture,
        *arrays,
        input_core_dims=[list(FIELD_DIMS)] * 3 + [[dim] for dim in FIELD_DIMS] + [["axis", "term"]] + [[]] * 6,
        output_core_dims=[list(dims) for dims, _ in outputs],
        vectorize=True,
        dask="parallelized",
        output_dtypes=[dtype for _, dtype in outputs],
        dask_gufunc_kwargs={"output_sizes": dict(sizes)},
    )
    return result if isinstance(result, tuple) else (result,)


def carried_coords(lf: xr.Dataset, dims: Sequence[str]) -> dict[str, Any]:
    """Coordinates of `lf` that lie on `dims` and ``capture`` alone, and its lattice."""
    allowed = {*dims, "capture"}
    return {
        str(name): coord.variable
        for name, coord in lf.coords.items()
        if set(coord.dims) <= allowed and str(name) not in {"u", "v"} - set(dims)
    } | {name: lf[name].variable for name in LATTICE_NAMES}
