"""Views for people: the square grid with the right aspect, upright, and ready for a screen."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.conventions import CHANNELS, LENS_DIMS
from lfflow.errors import LfflowError
from lfflow.kernels.square_grid import DENSE_REACH, SPARSE_REACH, resample_square, square_shape
from lfflow.schema import lattice_of
from lfflow.stages.picture import develop

_TURNS = {1: "", 2: "s", 3: "ts", 4: "t", 5: "x", 6: "xs", 7: "xts", 8: "xt"}
"""EXIF orientation: x exchanges the axes, then t and s are reversed."""


def square(data: xr.Dataset | xr.DataArray, scale: int = 1) -> xr.DataArray:
    """Views on a square grid of `scale` samples per lens pitch, in the true geometry of the lattice.

    Parameters
    ----------
    data
        Light field (``mosaic``, ``cfa``, ``weight``): each colour is averaged from the lenses that have it, no colour
        mixed. Or an array in the brick layout, with the lattice as coordinates: linear interpolation; NaN is no value.
    scale
        1 or 2.

    Returns
    -------
    xr.DataArray
        Dims of the input, t and s now of the square grid (X = s/scale, Y = t/scale, in lens pitches), and for a light
        field ``channel``: ``rgb``, linear radiance; NaN where no lens near has the colour. Lazy where `data` is.
    """
    if scale not in (1, 2):
        raise LfflowError(f"scale is {scale}; a square grid has 1 or 2 samples per lens")
    lattice = lattice_of(data.isel(capture=0) if "capture" in data["dh"].dims else data)
    kwargs = {"row_pitch": lattice.row_pitch, "hexagonal": lattice.arrangement == "hexagonal", "scale": scale}
    rows, columns = square_shape(data.sizes["t"], data.sizes["s"], lattice.row_pitch, scale)
    arrays = [data[name] for name in ("mosaic", "cfa", "weight")] if isinstance(data, xr.Dataset) else [data]
    colours = isinstance(data, xr.Dataset)
    out_dims = ("t_square", "s_square", "channel") if colours else ("t_square", "s_square")
    result: xr.DataArray = xr.apply_ufunc(
        _colour_block if colours else _plane_block,
        *(_whole(array).drop_vars(LENS_DIMS) for array in arrays),
        kwargs=kwargs,
        input_core_dims=[LENS_DIMS] * len(arrays),
        output_core_dims=[out_dims],
        dask="parallelized",
        output_dtypes=[np.float32],
        dask_gufunc_kwargs={
            "output_sizes": {"t_square": rows, "s_square": columns} | ({"channel": 3} if colours else {})
        },
        keep_attrs=False,
    )
    result = result.rename(t_square="t", s_square="s").assign_coords(t=np.arange(rows), s=np.arange(columns))
    if colours:
        result = result.assign_coords(channel=list(CHANNELS)).rename("rgb")
        result.attrs = {"long_name": "linear radiance of each channel", "units": "1"}
        return result
    return result.transpose(*arrays[0].dims).assign_attrs(arrays[0].attrs)


def upright(views: xr.DataArray, orientation: int | None = None) -> xr.DataArray:
    """Views on the square grid turned by their EXIF orientation; u and v turn with s and t, so that signs hold."""
    if orientation is None:
        orientation = int(views["orientation"]) if "orientation" in views.coords else 1
    if orientation not in _TURNS:
        raise LfflowError(f"orientation is {orientation}; EXIF knows 1 to 8")
    turn = _TURNS[orientation]
    if "x" in turn:
        dims = views.dims
        swap = {"t": "s", "s": "t", "v": "u", "u": "v"}
        names = {old: new for old, new in swap.items() if old in views.dims or old in views.coords}
        views = views.rename(names).transpose(*dims)
    for lens, view in (("t", "v"), ("s", "u")):
        if lens in turn:
            views = views.isel({lens: slice(None, None, -1)}).assign_coords({lens: views[lens]})
            if view in views.coords:
                views = views.assign_coords({view: -views[view]})
                views = views.isel({view: slice(None, None, -1)}) if view in views.dims else views
    return views.assign_coords(orientation=1)


def picture(lf: xr.Dataset | xr.DataArray, scale: int = 1, *, camera: xr.Dataset | None = None) -> xr.DataArray:
    """Views as a person sees them: square, upright, white balance, colour matrix and gamma where they are known.

    Parameters
    ----------
    lf
        Light field, or colours (…, channel) on the square grid: a dataset with ``rgb``, or the array.
    scale
        As for `square`.
    camera
        Dataset that holds ``white_balance``, ``color_matrix`` and ``gamma``; `lf` by default. Needed for an array in
        camera colours, which cannot carry a matrix along.

    Raises
    ------
    LfflowError
        Camera colours without the camera that they are of.
    """
    if isinstance(lf, xr.Dataset):
        rgb, camera = lf["rgb"] if "rgb" in lf else square(lf, scale), lf if camera is None else camera
    else:
        rgb = lf
    if camera is None and {"camera_model", "white_balance"} & set(rgb.coords):
        raise LfflowError("an array in camera colours carries no colour matrix: give camera=…, the dataset it is of")
    shown = upright(rgb)
    return develop(shown, shown.to_dataset(name="rgb") if camera is None else camera, exposure=1.0)


def _whole(array: xr.DataArray) -> xr.DataArray:
    return array.chunk(dict.fromkeys(LENS_DIMS, -1)) if array.chunks is not None else array


def _plane_block(values: npt.NDArray[Any], **geometry: Any) -> npt.NDArray[np.float32]:
    planes = values.reshape(-1, *values.shape[-2:])
    out = [resample_square(np.nan_to_num(p), np.isfinite(p), reach=DENSE_REACH, **geometry) for p in planes]
    return np.array(out).reshape(*values.shape[:-2], *out[0].shape)


def _colour_block(
    mosaic: npt.NDArray[Any], cfa: npt.NDArray[Any], weight: npt.NDArray[Any], **geometry: Any
) -> npt.NDArray[np.float32]:
    planes = [array.reshape(-1, *array.shape[-2:]) for array in (mosaic, cfa, weight)]
    out = []
    for values, colours, weights in zip(*planes, strict=True):
        clean = np.nan_to_num(values)
        out.append([resample_square(clean, weights * (colours == c), reach=SPARSE_REACH, **geometry) for c in range(3)])
    stacked = np.moveaxis(np.array(out), 1, -1)
    return stacked.reshape(*mosaic.shape[:-2], *stacked.shape[1:])
