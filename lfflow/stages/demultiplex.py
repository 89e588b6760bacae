"""Raw frame and calibration to the mosaicked light field."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.cameras import KNOWN_CAMERAS, view_radius
from lfflow.conventions import FIELD_DIMS, SENSOR_DIMS, SITES, VIEW_DIMS
from lfflow.distortion import Distortion
from lfflow.errors import LfflowError
from lfflow.kernels.sensor.demultiplex import FieldArrays, demultiplex_frame
from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.schema import LIGHTFIELD, PARAMETERS, distortion_numbers
from lfflow.stages.defects import with_defects

Method = Literal["nearest", "interpolated"]

_LATTICE_NAMES = (*PARAMETERS, "arrangement")


def demultiplex(
    raw: xr.Dataset,
    cal: xr.Dataset,
    *,
    shape: tuple[int, int] | None = None,
    radius: int | None = None,
    defects: xr.DataArray | None = None,
    method: Method = "nearest",
) -> xr.Dataset:
    """Mosaicked light field of a raw frame: every usable sensor pixel at its view and lens (METHOD 7.a, 7.1).

    Parameters
    ----------
    raw
        Raw frame (`schema.RAW`), dims (y, x), with or without ``capture``; numpy or dask.
    cal
        Calibration (`schema.CALIBRATION`) of the same sensor; one for all captures, or one per capture.
    shape
        Rows and columns (t, s) of the grid. By default that of the camera model, which all its captures share; for
        cameras that lfflow does not know, the smallest grid that covers the sensor.
    radius
        Views run over −radius…radius in u and v; by default as far as the subimage reaches.
    defects
        Flags (y, x) of sensor pixels that are left out beside those of `cal` (`lfflow.stages.defects`).
    method
        "nearest": every sample is a sensor pixel's own, taken at the place (u, v) + ρ of the aperture (METHOD 7).
        "interpolated", for comparison only: the radiance is moved to (u, v) itself by the slopes between the pixels of
        the same colour in the same subimage; colours and weights are those of the nearest pixels.

    Returns
    -------
    xr.Dataset
        `schema.LIGHTFIELD`: ``mosaic`` (radiance, no white balance), ``cfa`` and ``weight``, dims (v, u, t, s) with
        the leading dims of `raw`; ``view_usable`` (v, u), the lattice renumbered for this grid and the camera's
        settings as coordinates. Where there is no sample: NaN, 255 and 0. A clipped sample keeps its value, with a
        weight far below all others
        (`lfflow.stages.samples.saturated`). Lazy where `raw` or `cal` is.

    Raises
    ------
    LfflowError
        Sensor sizes or captures of `raw` and `cal` differ, or the grid cannot be known without computing.
    """
    raw, cal = _matched(raw, with_defects(cal, defects))
    size = (raw.sizes["y"], raw.sizes["x"])
    shape, radius = _grid(raw, cal, size, shape, radius)
    lattice = [cal[name].variable for name in _LATTICE_NAMES]
    anchored = xr.apply_ufunc(
        _anchored_origin,
        *lattice,
        kwargs={"size": size, "shape": shape},
        output_core_dims=[[], []],
        dask="parallelized",
        output_dtypes=[np.float64, np.float64],
    )
    lattice[3:5] = anchored
    mosaic, cfa, weight, usable = xr.apply_ufunc(
        _demultiplex_block,
        _whole(raw["raw"].variable),
        _whole(cal["vignetting"].variable),
        _whole(cal["pixel_flags"].variable),
        *(_sites(raw[name]) for name in ("black_level", "white_level")),
        distortion_numbers(cal).variable,
        raw["cfa_pattern"].variable,
        *lattice,
        kwargs={"shape": shape, "radius": radius, "interpolated": _is_interpolated(method)},
        input_core_dims=[SENSOR_DIMS] * 3 + [("site",)] * 2 + [("axis", "term")] + [()] * 7,
        output_core_dims=[FIELD_DIMS] * 3 + [VIEW_DIMS],
        dask="parallelized",
        output_dtypes=[np.float32, np.uint8, np.float32, np.bool_],
        dask_gufunc_kwargs={
            "output_sizes": {"v": 2 * radius + 1, "u": 2 * radius + 1, "t": shape[0], "s": shape[1]},
        },
    )
    field = xr.Dataset({"mosaic": mosaic, "cfa": cfa, "weight": weight}, coords=_axes(shape, radius))
    field = field.assign_coords(view_usable=usable)
    field = field.assign_coords(dict(zip(_LATTICE_NAMES, lattice, strict=True)))
    if "distortion" in cal.variables:
        field = field.assign_coords(distortion=distortion_numbers(cal))
    field = field.assign_coords(_carried(raw) | _white_image(cal))
    return LIGHTFIELD.annotate(field)


def _matched(raw: xr.Dataset, cal: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    for dim in SENSOR_DIMS:
        if raw.sizes.get(dim) != cal.sizes.get(dim):
            raise LfflowError(
                f"the calibration is of another sensor: {dim} has {cal.sizes.get(dim)} pixels there, "
                f"{raw.sizes.get(dim)} in the raw frame"
            )
    if "capture" in raw.dims and "capture" in cal.dims:
        try:
            raw, cal = xr.align(raw, cal, join="exact", exclude=SENSOR_DIMS)
        except ValueError as error:
            raise LfflowError("raw frames and calibrations are not of the same captures, in the same order") from error
    return raw, cal


def _grid(
    raw: xr.Dataset, cal: xr.Dataset, size: tuple[int, int], shape: tuple[int, int] | None, radius: int | None
) -> tuple[tuple[int, int], int]:
    """Rows and columns of the grid and radius of the views: as told, else of the camera model, else of the lattice."""
    if shape is not None and radius is not None:
        return shape, radius
    model = KNOWN_CAMERAS.get(_camera_model(raw))
    if model is not None and (model.height, model.width) == size:
        return shape or model.grid_shape, model.view_radius if radius is None else radius
    if any(cal[name].chunks is not None for name in _LATTICE_NAMES):
        raise LfflowError(
            "the camera is unknown and its calibration is not computed yet, so the size of the light field cannot be "
            "told: give shape=(rows, columns) and radius=…, or call cal.compute() before"
        )
    lattices = lattices_from([cal[name].values for name in _LATTICE_NAMES])
    grids = [lattice.grid_shape(*size) for lattice in lattices]
    if shape is None:
        shape = (max(rows for rows, _ in grids), max(columns for _, columns in grids))
    return shape, view_radius(max(lattice.dh for lattice in lattices)) if radius is None else radius


def _camera_model(raw: xr.Dataset) -> str:
    if "camera_model" not in raw.coords or raw["camera_model"].chunks is not None:
        return ""
    models = {str(name) for name in raw["camera_model"].values.ravel()}
    if len(models) > 1:
        raise LfflowError(f"captures of several camera models ({', '.join(sorted(models))}) have no common grid")
    return models.pop() if models else ""


def lattices_from(numbers: list[npt.NDArray[Any]]) -> list[Lattice]:
    """Lattices from arrays of dh, dv, theta, cx, cy and arrangement that broadcast."""
    columns = [array.ravel().tolist() for array in np.broadcast_arrays(*numbers)]
    return [
        Lattice(dh, dv, theta, cx, cy, ARRANGEMENTS[flag]) for dh, dv, theta, cx, cy, flag in zip(*columns, strict=True)
    ]


def _anchored_origin(*numbers: Any, size: tuple[int, int], shape: tuple[int, int]) -> tuple[Any, Any]:
    outer = np.broadcast_shapes(*(np.shape(array) for array in numbers))
    anchored = [lattice.anchored(*size, shape) for lattice in lattices_from([np.asarray(array) for array in numbers])]
    cx = np.array([lattice.cx for lattice in anchored]).reshape(outer)
    cy = np.array([lattice.cy for lattice in anchored]).reshape(outer)
    return cx, cy


def _demultiplex_block(
    raw: npt.NDArray[Any],
    vignetting: npt.NDArray[Any],
    flags: npt.NDArray[Any],
    black: npt.NDArray[Any],
    white: npt.NDArray[Any],
    distortion: npt.NDArray[Any],
    pattern: npt.NDArray[Any],
    *numbers: npt.NDArray[Any],
    shape: tuple[int, int],
    radius: int,
    interpolated: bool,
) -> tuple[npt.NDArray[Any], ...]:
    scalars = [np.asarray(array) for array in (pattern, *numbers)]
    outer = np.broadcast_shapes(
        *(array.shape[:-2] for array in (raw, vignetting, flags, distortion)),
        *(array.shape[:-1] for array in (black, white)),
        *(array.shape for array in scalars),
    )
    raw, vignetting, flags = (np.broadcast_to(a, outer + a.shape[-2:]) for a in (raw, vignetting, flags))
    black, white = (np.broadcast_to(a, outer + a.shape[-1:]) for a in (black, white))
    distortion = np.broadcast_to(distortion, outer + distortion.shape[-2:])
    patterns, *lattice_numbers = (np.broadcast_to(a, outer) for a in scalars)
    views = 2 * radius + 1
    size = (*outer, views, views, *shape)
    out = FieldArrays(np.empty(size, np.float32), np.empty(size, np.uint8), np.empty(size, np.float32))
    usable = np.empty((*outer, views, views), np.bool_)
    for index, lattice in zip(np.ndindex(outer), lattices_from(lattice_numbers), strict=True):
        usable[index] = demultiplex_frame(
            raw[index],
            vignetting[index],
            flags[index],
            lattice,
            black=black[index],
            white=white[index],
            pattern=str(patterns[index]),
            out=FieldArrays(out.mosaic[index], out.cfa[index], out.weight[index]),
            distortion=Distortion(distortion[index]),
            interpolated=interpolated,
        )
    return out.mosaic, out.cfa, out.weight, usable


def _is_interpolated(method: str) -> bool:
    if method not in get_args(Method):
        raise LfflowError(f"method is {method!r}: expected one of {', '.join(get_args(Method))}")
    return method == "interpolated"


def _whole(variable: xr.Variable) -> xr.Variable:
    """Variable with y and x in one chunk when it is chunked."""
    return variable.chunk(dict.fromkeys(SENSOR_DIMS, -1)) if variable.chunks is not None else variable


def _sites(levels: xr.DataArray) -> xr.Variable:
    """Levels in the order (r, gr, gb, b)."""
    ordered = levels.sel(site=list(SITES)) if "site" in levels.coords else levels
    return ordered.variable.chunk({"site": -1}) if ordered.chunks is not None else ordered.variable


def _axes(shape: tuple[int, int], radius: int) -> dict[Hashable, npt.NDArray[np.int64]]:
    views = np.arange(-radius, radius + 1)
    return {"v": views, "u": views, "t": np.arange(shape[0]), "s": np.arange(shape[1])}


def _carried(raw: xr.Dataset) -> dict[Hashable, xr.DataArray]:
    """Coordinates of the raw frame that a light field keeps: capture, camera, optics and colour."""
    names = [
        name
        for name in (*LIGHTFIELD.names, "capture")
        if name in raw.coords and not set(raw[name].dims) & set(SENSOR_DIMS)
    ]
    return {name: raw[name].reset_coords(drop=True) if name not in raw[name].dims else raw[name] for name in names}


def _white_image(cal: xr.Dataset) -> dict[Hashable, xr.DataArray]:
    """Which white image the calibration is of, and how far it is from the picture, where the calibration tells."""
    found = {name: cal[name] for name in ("white_image", "white_distance") if name in cal.variables}
    white = "kind" not in cal.coords or bool((cal["kind"] == "white").all())
    if white and "white_image" not in found and "capture" in cal.coords and not cal["capture"].dims:
        found["white_image"] = cal["capture"]
    return {name: array.reset_coords(drop=True).rename(name) for name, array in found.items()}
