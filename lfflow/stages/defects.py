"""Sensor pixels not to be trusted: from dark frames, from many captures, from one picture (seed 5.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.conventions import SENSOR_DIMS
from lfflow.kernels.pixel_defects import DEAD, HOT, aberrant_pixels, hot_in_dark
from lfflow.schema import CALIBRATION, PARAMETERS
from lfflow.schema.declarations import PIXEL_FLAGS
from lfflow.stages.demultiplex import lattices_from
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


def aberrant(raw: xr.Dataset, cal: xr.Dataset, *, threshold: float = 0.12) -> xr.DataArray:
    """Pixels that stick out of their same-colour neighbours in each picture (y, x): `PIXEL_FLAGS` uint8 (seed 5.2).

    The lattice of `cal` takes the shape of the subimages out of the comparison. One picture may hold fine highlights
    that look alike: `defect_map` of many captures tells them from defects. Lazy where `raw` is.
    """
    flags: xr.DataArray = xr.apply_ufunc(
        _aberrant_block,
        _whole(normalise(raw)).variable,
        *(cal[name].variable for name in (*PARAMETERS, "arrangement")),
        kwargs={"threshold": threshold},
        input_core_dims=[SENSOR_DIMS] + [()] * 6,
        output_core_dims=[SENSOR_DIMS],
        dask="parallelized",
        output_dtypes=[np.uint8],
    )
    names = [name for name in ("y", "x", "capture") if name in raw.coords]
    return _annotated(xr.DataArray(flags, coords={name: raw[name] for name in names}))


def saturated_pixels(raw: xr.Dataset) -> xr.DataArray:
    """Pixels at or above the white level of their site (y, x): `PIXEL_FLAGS` uint8."""
    return _annotated((normalise(raw) >= np.float32(1)).astype(np.uint8) * np.uint8(PIXEL_FLAGS["saturated"]))


def defect_counts(flags: xr.DataArray) -> xr.Dataset:
    """In how many captures each pixel was marked: ``hot``, ``dead`` (y, x), from flags (capture, y, x) (Figure 13)."""
    counts = {name: (flags == PIXEL_FLAGS[name]).sum("capture").astype(np.int32) for name in ("hot", "dead")}
    ds = xr.Dataset(counts)
    for name in counts:
        ds[name].attrs = {"long_name": f"captures that show the pixel {name}", "units": "1"}
    return ds


def defect_map(flags: xr.DataArray, *, least: float = 0.5) -> xr.DataArray:
    """Flags (y, x) of the pixels that are marked in at least the share `least` of the captures (capture, y, x).

    A dead pixel shows only where the picture is bright, so that half of that share is enough for it; two captures at
    least must agree.
    """
    counts = defect_counts(flags)
    captures = flags.sizes["capture"]
    enough = {"hot": max(least * captures, min(2, captures)), "dead": max(least * captures / 2, min(2, captures))}
    hot, dead = (counts[name] >= enough[name] for name in ("hot", "dead"))
    return _annotated(hot * np.uint8(HOT) + (dead & ~hot) * np.uint8(DEAD))


def _annotated(flags: xr.DataArray) -> xr.DataArray:
    return flags.astype(np.uint8).rename("pixel_flags").assign_attrs(CALIBRATION["pixel_flags"].attrs)


def _whole(array: xr.DataArray) -> xr.DataArray:
    return array.chunk(dict.fromkeys(SENSOR_DIMS, -1)) if array.chunks is not None else array


def _dark_block(radiance: npt.NDArray[Any], threshold: float) -> npt.NDArray[np.uint8]:
    frames = radiance.reshape(-1, *radiance.shape[-2:])
    return np.array([hot_in_dark(frame, threshold=threshold) for frame in frames]).reshape(radiance.shape)


def _aberrant_block(radiance: npt.NDArray[Any], *numbers: Any, threshold: float) -> npt.NDArray[np.uint8]:
    outer = np.broadcast_shapes(radiance.shape[:-2], *(np.shape(number) for number in numbers))
    frames = np.broadcast_to(radiance, outer + radiance.shape[-2:])
    lattices = lattices_from([np.broadcast_to(number, outer) for number in numbers])
    out = np.empty(frames.shape, np.uint8)
    for index, lattice in zip(np.ndindex(outer), lattices, strict=True):
        out[index] = aberrant_pixels(frames[index], lattice, threshold=threshold)
    return out
