"""Metres from disparity: the thin lens with a microlens array behind it (METHOD appendix A)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from lfflow.errors import LfflowError

_NEEDED = ("pixel_pitch", "lens_pitch", "mla_offset_z")
_SOURCES = ("told", "fitted to known depths")


def strength(ds: xr.Dataset | xr.DataArray, image_distance: float | xr.DataArray) -> xr.DataArray:
    """Lens pitches per view step and per 1/m: δ·B²/(f·P), metres (A.2).

    ``ds`` carries ``pixel_pitch`` δ, ``lens_pitch`` P and ``mla_offset_z`` f, metres; `image_distance` is B, metres.
    """
    missing = [n for n in _NEEDED if n not in ds.coords or not bool(np.isfinite(ds[n]).all()) or not (ds[n] > 0).all()]
    if missing:
        raise LfflowError(f"no depth without {', '.join(missing)}: neither the disparity nor a camera= tells it")
    square = image_distance * image_distance
    return xr.DataArray(ds["pixel_pitch"] * square / (ds["mla_offset_z"] * ds["lens_pitch"])).reset_coords(drop=True)


def depth(
    disp: xr.Dataset,
    *,
    focus_distance: float | None = None,
    known: Sequence[tuple[float, float]] | None = None,
    disparity_of_view_step: float | None = None,
    camera: xr.Dataset | None = None,
) -> xr.Dataset:
    """Distance from the main lens, and its standard deviation.

    ``1/z = 1/z_f + d·f·P/(δ·B²)`` with ``1/B = 1/F − 1/z_f``, and ``σ_z = z²·f·P/(δ·B²)·σ_d`` (A.2).

    Parameters
    ----------
    disp
        ``disparity`` and ``disparity_std`` in any dims; coordinates ``focal_length`` F, ``pixel_pitch`` δ,
        ``lens_pitch`` P, ``mla_offset_z`` f (metres).
    focus_distance
        z_f, metres: the distance that has disparity 0. Metadata do not give it, they hold motor steps only.
    known
        Pairs (disparity, metres) of measured points. One fits z_f; two or more fit z_f and the strength together.
    disparity_of_view_step
        Strength δ·B²/(f·P) in metres, when it is known better than the metadata tell.
    camera
        Dataset of the same captures whose coordinates tell what those of `disp` do not: the light field, where `disp`
        comes out of a collection's store.

    Returns
    -------
    Dataset
        ``depth`` and ``depth_std``, metres, float32. Points at or beyond infinity are NaN. The attributes of ``depth``
        say where the focal distance came from.

    Raises
    ------
    LfflowError
        Without `focus_distance` or `known`, without the lens data, or when the known points contradict each other.
    """
    if (focus_distance is None) == (known is None):
        raise LfflowError("depth needs the distance in focus (focus_distance, metres) or points of known depth (known)")
    disp = disp if camera is None else _with_lens_data(disp, camera)
    if known is not None:
        power, focus = _fit(disp, known, disparity_of_view_step)
    else:
        focus = xr.DataArray(1.0 / float(focus_distance or np.inf))
        power = _power(disp, focus, disparity_of_view_step)
    inverse = focus + disp["disparity"] / power
    distance = (1.0 / inverse.where(inverse > 0)).astype(np.float32)
    spread = (distance**2 * disp["disparity_std"] / power).astype(np.float32)
    out = xr.Dataset({"depth": distance.transpose(*disp["disparity"].dims),
                      "depth_std": spread.transpose(*disp["disparity"].dims)})  # fmt: skip
    out["depth"].attrs = {
        "long_name": "distance from the main lens",
        "units": "m",
        "focus_distance": _SOURCES[known is not None],
    }
    out["depth_std"].attrs = {"long_name": "standard deviation of the depth", "units": "m"}
    return out


def _with_lens_data(disp: xr.Dataset, camera: xr.Dataset) -> xr.Dataset:
    if "capture" in disp.dims and "capture" in camera.dims:
        camera = camera.sel(capture=disp["capture"])
    missing = [n for n in (*_NEEDED, "focal_length") if n in camera.coords and n not in disp.coords]
    return disp.assign_coords({name: camera[name].variable for name in missing})


def _power(disp: xr.Dataset, focus: xr.DataArray, told: float | None) -> xr.DataArray:
    if told is not None:
        return xr.DataArray(told)
    if "focal_length" not in disp.coords or not bool(np.isfinite(disp["focal_length"]).all()):
        raise LfflowError("no depth without focal_length: neither the disparity nor a camera= tells it")
    return strength(disp, 1.0 / (1.0 / disp["focal_length"] - focus).reset_coords(drop=True))


def _fit(
    disp: xr.Dataset, known: Sequence[tuple[float, float]], told: float | None
) -> tuple[xr.DataArray, xr.DataArray]:
    """Strength and 1/z_f from points (disparity, metres)."""
    d, z = np.array(known, dtype=np.float64).T
    if len(d) > 1 and told is None:
        slope, focus = np.polyfit(d, 1.0 / z, 1)
        if not slope > 0:
            raise LfflowError("the known depths contradict the disparities: nearer points have the larger disparity")
        return xr.DataArray(1.0 / slope), xr.DataArray(focus)
    focus_at = xr.DataArray(np.mean(1.0 / z))
    for _ in range(50):
        power = _power(disp, focus_at, told)
        focus_at = (xr.DataArray(1.0 / z, dims="known") - xr.DataArray(d, dims="known") / power).mean("known")
    return power, focus_at
