"""What a frame shows (a scene, an even light, no light), and who says so: a person, the camera or its samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from lfflow.conventions import SITES
from lfflow.kernels.sensor.flatness import MIN_TILES, TILE, Flatness, flatness

TOLD, CAMERA, CONTENT = "told", "camera", "content"
_BANDS = (0.2, 0.5, 0.8)
_BAND_ROWS = 4 * TILE


def judge(raw: xr.Dataset, told: str = "") -> tuple[str, str]:
    """Kind of a frame, and how it was judged: "told", "camera" (its tags) or "content".

    A camera tags the white and dark images that it took for itself; what a person took of a diffuser or under a lens
    cap is tagged as any picture is, so that only its samples tell. Most scenes need only a few of their rows.
    """
    tagged = str(raw["kind"].item()) if "kind" in raw.variables else "scene"
    if told:
        return told, TOLD
    if tagged != "scene":
        return tagged, CAMERA
    rows = raw.sizes["y"]
    if rows < MIN_TILES * TILE:
        return tagged, CAMERA
    for place in _BANDS:
        start = int(place * (rows - _BAND_ROWS)) // 2 * 2
        band = _flatness(raw, slice(start, start + _BAND_ROWS))
        if band is not None and not band.may_be_even:
            return "scene", CONTENT
    whole = _flatness(raw, slice(None))
    return (tagged, CAMERA) if whole is None else (whole.kind, CONTENT)


def _flatness(raw: xr.Dataset, rows: slice) -> Flatness | None:
    frame = raw["raw"].transpose("y", "x").isel(y=rows)
    return flatness(frame.values, _by_place(raw, "black_level", 0.0), _by_place(raw, "white_level", 65535.0))


def _by_place(raw: xr.Dataset, name: str, default: float) -> np.ndarray[Any, Any]:
    """Level of the four places of the Bayer tile, row by row, from that of the four colour sites."""
    if name not in raw.variables or "cfa_pattern" not in raw.variables:
        return np.full(4, default)
    levels = dict(zip(SITES, np.asarray(raw[name], dtype=float), strict=True))
    pattern = str(raw["cfa_pattern"].item()).lower()
    tile = [pattern[:2], pattern[2:]]
    names = [("gr" if "r" in row else "gb") if letter == "g" else letter for row in tile for letter in row]
    return np.array([levels[site] for site in names])
