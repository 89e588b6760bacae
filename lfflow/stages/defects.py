"""Sensor pixels not to be trusted: from dark frames, from many captures, from one picture (seed 5.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.conventions import SENSOR_DIMS
from lfflow.errors import LfflowError
from lfflow.kernels.sensor.defects import DEAD, HOT, STEPS, aberrant_pixels, hot_in_dark
from lfflow.schema import CALIBRATION
from lfflow.schema.declarations import PIXEL_FLAGS
from lfflow.stages.radiometry import normalise


def dark_defects(dark: xr.Dataset, *, threshold: float = 0.03) -> xr.DataArray:
    """Hot pixels of dark frames (y, x), per ``capture`` where there is one: `PIXEL_FLAGS` uint8 (seed 5.2)."""
    flags: xr.DataArray = xr.apply_ufunc(
        _dark_block,
        _whole(normalise(dark)),
        kwargs={"threshold": threshold},
        input_core_dims=[SENSOR_DIMS],
        output_core_dims=[SENSOR_DIMS],
        dask="parallelized",
        output_dtypes=[np.uint8],
    )
    return _annotated(flags)


def aberrant(raw: xr.Dataset, cal: xr.Dataset, *, step: float | None = None) -> xr.Dataset:
    """Pixels that stick out of their same-colour neighbours in each picture (seed 5.2).

    One picture may hold fine highlights that look like hot pixels, and its dark places hide dead ones: `defect_map` of
    many captures tells.

    Parameters
    ----------
    raw
        Raw frame (`schema.RAW`), with or without ``capture``; numpy or dask.
    cal
        Calibration of the same sensor; its ``vignetting`` takes the shape of the subimages out of the comparison.
    step
        Least excess of a hot pixel, radiance; by default 0.12, which detail of a scene does not reach.

    Returns
    -------
    xr.Dataset
        ``pixel_flags`` (y, x) uint8 (`PIXEL_FLAGS`) and ``tested`` (y, x) bool: whether a dead pixel would have shown.
        Lazy where `raw` or `cal` is.
    """
    flags, tested = xr.apply_ufunc(
        _aberrant_block,
        _whole(normalise(raw)),
        _whole(cal["vignetting"]).reset_coords(drop=True),
        kwargs={"step": STEPS["scene"] if step is None else step},
        input_core_dims=[SENSOR_DIMS] * 2,
        output_core_dims=[SENSOR_DIMS] * 2,
        dask="parallelized",
        output_dtypes=[np.uint8, np.bool_],
    )
    return xr.Dataset({"pixel_flags": _annotated(flags), "tested": tested}).reset_coords(drop=True)


def saturated_pixels(raw: xr.Dataset) -> xr.DataArray:
    """Pixels at or above the white level of their site (y, x): `PIXEL_FLAGS` uint8."""
    return _annotated((normalise(raw) >= np.float32(1)).astype(np.uint8) * np.uint8(PIXEL_FLAGS["saturated"]))


def defect_counts(found: xr.Dataset | xr.DataArray) -> xr.Dataset:
    """In how many captures each pixel was marked: ``hot``, ``dead`` (y, x), and for how many of them ``tested``.

    ``found`` is what `aberrant` gives of many captures, or flags (capture, y, x) such as `dark_defects` gives (Figure
    13); a dim ``capture`` is needed. The counts of several batches may be added.
    """
    flags = found["pixel_flags"] if isinstance(found, xr.Dataset) else found
    if "capture" not in flags.dims:
        raise LfflowError("defects are counted over captures: the flags have no dim 'capture'")
    counts = {name: (flags & PIXEL_FLAGS[name] > 0).sum("capture").astype(np.int32) for name in ("hot", "dead")}
    if isinstance(found, xr.Dataset):
        counts["tested"] = found["tested"].sum("capture").astype(np.int32)
    ds = xr.Dataset(counts, attrs={"captures": flags.sizes["capture"]})
    for name in counts:
        ds[name].attrs = {"long_name": f"captures in which the pixel was {name}", "units": "1"}
    return ds


def defect_map(counts: xr.Dataset, *, least: float = 0.5) -> xr.DataArray:
    """Flags (y, x) of the pixels that are defects in at least the share `least` of the captures.

    A hot pixel shows in every capture. A dead one shows where the picture is bright, so that its share is of the
    captures that tested it. Two captures at least must agree, where there are two.
    """
    captures = int(counts.attrs["captures"])
    agree = min(2, captures)
    hot = counts["hot"] >= max(least * captures, agree)
    tested = counts.get("tested", captures)
    dead = (counts["dead"] >= agree) & (counts["dead"] >= least * tested) & ~hot
    return _annotated(hot * np.uint8(HOT) + dead * np.uint8(DEAD))


def with_defects(cal: xr.Dataset, defects: xr.DataArray | None) -> xr.Dataset:
    """Calibration whose ``pixel_flags`` hold also the `defects` (y, x) known of the sensor, of dark frames or a map."""
    if defects is None:
        return cal
    for dim in SENSOR_DIMS:
        if defects.sizes.get(dim) != cal.sizes[dim]:
            raise LfflowError(
                f"the defects are of another sensor: {dim} has {defects.sizes.get(dim)} pixels there, "
                f"{cal.sizes[dim]} in the calibration"
            )
    flags = cal["pixel_flags"].variable | defects.transpose(..., *SENSOR_DIMS).variable.astype(np.uint8)
    return cal.assign(pixel_flags=_annotated(xr.DataArray(flags)))


def _annotated(flags: xr.DataArray) -> xr.DataArray:
    return flags.astype(np.uint8).rename("pixel_flags").assign_attrs(CALIBRATION["pixel_flags"].attrs)


def _whole(array: xr.DataArray) -> xr.DataArray:
    return array.chunk(dict.fromkeys(SENSOR_DIMS, -1)) if array.chunks is not None else array


def _dark_block(radiance: npt.NDArray[Any], threshold: float) -> npt.NDArray[np.uint8]:
    frames = radiance.reshape(-1, *radiance.shape[-2:])
    return np.array([hot_in_dark(frame, threshold=threshold) for frame in frames]).reshape(radiance.shape)


def _aberrant_block(
    radiance: npt.NDArray[Any], vignetting: npt.NDArray[Any], step: float
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
    outer = np.broadcast_shapes(radiance.shape[:-2], vignetting.shape[:-2])
    radiance, vignetting = (np.broadcast_to(a, outer + a.shape[-2:]) for a in (radiance, vignetting))
    flags, tested = np.empty(radiance.shape, np.uint8), np.empty(radiance.shape, np.bool_)
    for index in np.ndindex(outer):
        flags[index], tested[index] = aberrant_pixels(radiance[index], vignetting[index], step=step)
    return flags, tested
