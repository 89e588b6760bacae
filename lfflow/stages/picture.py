"""Linear camera colours to what a screen shows, with highlights that stay neutral (seed 5.2, 5.3.4, 5.3.5)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.stages.radiometry import apply_gamma, correct_colour, white_balance

_SCREEN_GAMMA = 1 / 2.2


def develop(rgb: xr.DataArray, camera: xr.Dataset | None = None, *, exposure: float | None = None) -> xr.DataArray:
    """Screen values 0…1: white balance, clipped highlights, colour matrix, gamma; each where the metadata give it.

    After the white balance the channels clip at different values, and the matrix turns a clipped white into magenta.
    Hence all three are cut at the least of them first.

    Parameters
    ----------
    rgb
        Linear radiance (…, channel).
    camera
        Dataset that holds ``white_balance`` (channel), ``color_matrix`` (channel, channel_in) and ``gamma``; an array
        cannot carry the matrix along. The coordinates of `rgb` by default.
    exposure
        Gain on the linear values; None: so that the 99.5th percentile of the largest channel is 1 (this computes it).
    """
    source = rgb if camera is None else camera
    balanced = rgb
    if _known(source, "white_balance"):
        gains = source["white_balance"].reset_coords(drop=True)
        gains = gains / gains.min("channel")
        balanced = white_balance(rgb, gains).clip(max=1.0)
    corrected = correct_colour(balanced, source["color_matrix"]) if _known(source, "color_matrix") else balanced
    gain = exposure if exposure is not None else _auto(corrected)
    gamma = source["gamma"].reset_coords(drop=True) if _known(source, "gamma") else _SCREEN_GAMMA
    return apply_gamma(corrected * np.float32(gain), gamma)


def to_integers(shown: xr.DataArray, bits: int = 8) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
    """Screen values (t, s, channel) as 8 or 16 bit integers; NaN is black."""
    top = (1 << bits) - 1
    values = np.rint(np.nan_to_num(shown.transpose(..., "t", "s", "channel").values) * top)
    return np.asarray(values, dtype=np.uint8) if bits == 8 else np.asarray(values, dtype=np.uint16)


def _known(rgb: xr.DataArray | xr.Dataset, name: str) -> bool:
    return name in rgb.coords and bool(np.isfinite(rgb[name]).all())


def _auto(rgb: xr.DataArray) -> float:
    bright = float(np.nanpercentile(np.asarray(rgb.max("channel")), 99.5))
    return 1.0 / bright if bright > 0 else 1.0
