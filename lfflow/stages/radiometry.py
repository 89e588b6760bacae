"""From counts to colours, one step a function: levels, white balance, colour matrix, gamma (seed 5.1 to 5.4)."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.conventions import CFA_NONE, CHANNELS, SENSOR_DIMS, SITES
from lfflow.errors import LfflowError
from lfflow.kernels.sensor.radiometry import level_tiles, normalise_levels

DataT = TypeVar("DataT", xr.DataArray, xr.Dataset)


def normalise(raw: xr.Dataset) -> xr.DataArray:
    """Radiance (raw − black)/(white − black) of each Bayer site, float32, dims of ``raw["raw"]`` (seed 5.1).

    ``raw`` is a `schema.RAW` dataset with or without ``capture``; values below the black level stay negative.
    """
    frame = raw["raw"].transpose(..., *SENSOR_DIMS)
    if frame.chunks is not None:
        frame = frame.chunk(dict.fromkeys(SENSOR_DIMS, -1))
    radiance: xr.DataArray = xr.apply_ufunc(
        _normalise_block,
        frame,
        *(raw[name].sel(site=list(SITES)) for name in ("black_level", "white_level")),
        raw["cfa_pattern"],
        input_core_dims=[SENSOR_DIMS, ("site",), ("site",), ()],
        output_core_dims=[SENSOR_DIMS],
        dask="parallelized",
        output_dtypes=[np.float32],
    )
    radiance.attrs = {"long_name": "radiance, 0 black level, 1 white level", "units": "1"}
    return radiance.rename("radiance").transpose(*raw["raw"].dims)


def white_balance(data: DataT, gains: xr.DataArray | None = None) -> DataT:
    """Multiply each colour by its gain (seed 5.2).

    ``data`` is an array with a ``channel`` dim, or a light field whose ``mosaic`` is balanced by its ``cfa``;
    ``gains`` (channel) default to its coordinate ``white_balance``.
    """
    gains = _given(data, gains, "white_balance")
    if isinstance(data, xr.Dataset):
        balanced = data["mosaic"] * _gain_of_sample(data["cfa"], gains)
        return data.assign(mosaic=balanced.astype(np.float32).assign_attrs(data["mosaic"].attrs))
    return (data * gains.astype(np.float32)).transpose(*data.dims).assign_attrs(data.attrs)


def correct_colour(rgb: xr.DataArray, matrix: xr.DataArray | None = None) -> xr.DataArray:
    """Linear camera RGB to linear sRGB by the matrix (channel, channel_in): c' = M c (seed 5.3).

    ``matrix`` defaults to the coordinate ``color_matrix``. For pictures for people only.
    """
    matrix = _given(rgb, matrix, "color_matrix").astype(np.float32).reset_coords(drop=True)
    plain = matrix.drop_vars([name for name in ("channel", "channel_in") if name in matrix.coords])
    source = rgb.rename(channel="channel_in").drop_vars("channel_in")
    corrected: xr.DataArray = xr.dot(plain, source.reset_coords(drop=True), dim="channel_in").transpose(*rgb.dims)
    return corrected.assign_coords(rgb.coords).assign_attrs(rgb.attrs).rename(rgb.name)


def apply_gamma(rgb: xr.DataArray, gamma: float | xr.DataArray | None = None) -> xr.DataArray:
    """Display value c^γ of values clipped to 0…1 (seed 5.4); ``gamma`` defaults to the coordinate. For pictures."""
    exponent = _given(rgb, gamma, "gamma") if not isinstance(gamma, float) else gamma
    curved: xr.DataArray = rgb.clip(0, 1) ** exponent
    return curved.astype(np.float32).assign_attrs(rgb.attrs)


def _given(data: xr.DataArray | xr.Dataset, value: Any, name: str) -> xr.DataArray:
    if value is not None:
        return xr.DataArray(value) if not isinstance(value, xr.DataArray) else value
    if name not in data.coords:
        raise LfflowError(f"the data carry no {name}: give it as an argument")
    return data[name]


def _gain_of_sample(cfa: xr.DataArray, gains: xr.DataArray) -> xr.DataArray:
    by_channel = gains.sel(channel=list(CHANNELS)) if "channel" in gains.coords else gains
    gain = xr.ones_like(cfa, dtype=np.float32)
    for colour in range(len(CHANNELS)):
        gain = gain.where(cfa != colour, by_channel.isel(channel=colour, drop=True).astype(np.float32))
    return gain.where(cfa != CFA_NONE, np.float32(1))


def _normalise_block(
    raw: npt.NDArray[Any], black: npt.NDArray[Any], white: npt.NDArray[Any], pattern: npt.NDArray[Any]
) -> npt.NDArray[np.float32]:
    pattern = np.asarray(pattern)
    outer = np.broadcast_shapes(raw.shape[:-2], black.shape[:-1], white.shape[:-1], pattern.shape)
    raw = np.broadcast_to(raw, outer + raw.shape[-2:])
    black, white = (np.broadcast_to(a, (*outer, len(SITES))) for a in (black, white))
    patterns = np.broadcast_to(pattern, outer)
    out = np.empty(raw.shape, np.float32)
    for index in np.ndindex(outer):
        low, gain, _ = level_tiles(black[index], white[index], str(patterns[index]))
        out[index] = normalise_levels(np.ascontiguousarray(raw[index]), low, gain)
    return out
