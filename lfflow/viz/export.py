"""One capture written for other programs and for people: views, stacks, maps, moving pictures, points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from lfflow.errors import LfflowError
from lfflow.formats.eslf import write_eslf
from lfflow.formats.pfm import write_pfm
from lfflow.formats.ply import write_ply
from lfflow.formats.png import write_png
from lfflow.formats.toolbox import write_toolbox
from lfflow.formats.views import write_views
from lfflow.stages.depth import depth
from lfflow.stages.grid import grid_of
from lfflow.stages.picture import develop, to_integers
from lfflow.stages.reconstruct import reconstruct_views
from lfflow.stages.refocus import refocus
from lfflow.stages.samples import usable_reach


@dataclass(frozen=True, slots=True)
class Options:
    """How a capture is written.

    Parameters
    ----------
    scale
        Places of the square grid per lens pitch.
    bits
        8 or 16, for pictures.
    planes
        Planes of a focal stack.
    developed
        Colours for people instead of linear camera radiance in views, ESLF and toolbox files.
    focus_distance
        Distance that has disparity 0, metres: points get metres. No camera writes it into its metadata.
    """

    scale: float = 1.0
    bits: int = 8
    planes: int = 9
    developed: bool = True
    focus_distance: float | None = None


def export_capture(
    lf: xr.Dataset, disp: xr.Dataset, to: str, out: Path, name: str, options: Options | None = None
) -> Path:
    """Write one capture; returns the file or folder made.

    Parameters
    ----------
    lf, disp
        LIGHTFIELD and DISPARITY of one capture, without the dim ``capture``.
    to
        A name in `WRITERS`.
    out, name
        Folder (made when missing) and the stem of the file.
    """
    if to not in WRITERS:
        raise LfflowError(f"no format {to!r}: there are {', '.join(WRITERS)}")
    out.mkdir(parents=True, exist_ok=True)
    # in memory, so that the views share what they are made of
    lf, disp = lf.compute(scheduler="synchronous"), disp.compute(scheduler="synchronous")
    return WRITERS[to](lf, disp, out / name, options or Options())


def _views(lf: xr.Dataset, disp: xr.Dataset, options: Options, offsets: Any = None) -> xr.Dataset:
    """The views at `offsets`; by default the square of those that have light."""
    square = range(-usable_reach(lf), usable_reach(lf) + 1)
    return reconstruct_views(lf, disp, scale=options.scale, views=offsets or {"v": square, "u": square})


def _shown(views: xr.Dataset, options: Options) -> xr.Dataset:
    return views.assign(rgb=develop(views["rgb"], views)) if options.developed else views


def _middle(lf: xr.Dataset) -> dict[str, list[int]]:
    return {dim: [int(lf[dim][int(np.argmin(np.abs(np.asarray(lf[dim]))))])] for dim in ("v", "u")}


def _folder(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    write_views(path, _shown(_views(lf, disp, options), options), bits=options.bits)
    return path


def _eslf(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    file = path.with_name(f"{path.name}_eslf.png")
    write_eslf(file, _shown(_views(lf, disp, options), options), bits=options.bits)
    return file


def _toolbox(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    file = path.with_name(f"{path.name}.mat")
    write_toolbox(file, _shown(_views(lf, disp, options), options))
    return file


def _map(lf: xr.Dataset, disp: xr.Dataset, options: Options) -> Any:
    view = _views(lf, disp, options, _middle(lf))["disparity"].isel(v=0, u=0)
    return view.transpose("t", "s").values


def _pfm(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    file = path.with_name(f"{path.name}.pfm")
    write_pfm(file, _map(lf, disp, options))
    return file


def _png16(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    values = _map(lf, disp, options)
    low, high = (float(np.nanmin(values)), float(np.nanmax(values))) if np.isfinite(values).any() else (0.0, 1.0)
    step = (high - low) / 65534 or 1.0
    levels = np.where(np.isfinite(values), 1 + np.rint((np.nan_to_num(values) - low) / step), 0)
    file = path.with_name(f"{path.name}.png")
    meaning = f"disparity = {low!r} + {step!r} * (value - 1); 0 is no disparity"
    write_png(file, levels.astype(np.uint16), {"Description": meaning})
    return file


def _focal_stack(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    import cv2

    views = _views(lf, disp, options)
    low, high = np.nanpercentile(views["disparity"], [2, 98])
    stack = develop(refocus(views, np.linspace(low, high, options.planes).tolist()), lf)
    file = path.with_name(f"{path.name}_stack.tiff")
    pages = to_integers(stack, options.bits)
    if not cv2.imwritemulti(str(file), [np.ascontiguousarray(page[..., ::-1]) for page in pages]):
        raise LfflowError(f"{file}: the focal stack could not be written")
    return file


def _parallax(lf: xr.Dataset, disp: xr.Dataset, file: Path, options: Options, **how: Any) -> Path:
    """A moving picture of a round trip in the aperture, for ever."""
    from PIL import Image

    radius = 0.75 * usable_reach(lf)
    angles = [2 * math.pi * k / 16 for k in range(16)]
    places = [{"v": [radius * math.sin(a)], "u": [radius * math.cos(a)]} for a in angles]
    views = [_views(lf, disp, options, place)["rgb"].isel(v=0, u=0, drop=True) for place in places]
    pages = to_integers(develop(xr.concat(views, "frame"), lf), 8)
    frames = [Image.fromarray(np.asarray(page, dtype=np.uint8)) for page in pages]
    frames[0].save(file, save_all=True, append_images=frames[1:], duration=80, loop=0, **how)
    return file


def _gif(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    return _parallax(lf, disp, path.with_name(f"{path.name}.gif"), options)


def _webp(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    return _parallax(lf, disp, path.with_name(f"{path.name}.webp"), options, quality=90)


def _ply(lf: xr.Dataset, disp: xr.Dataset, path: Path, options: Options) -> Path:
    """Points of the central view: x right, y down, z away from the camera."""
    views = _views(lf, disp, options, _middle(lf)).isel(v=0, u=0)
    x, y = (places - places.mean() for places in grid_of(views).places(views["t"], views["s"]))
    if options.focus_distance is None:
        z = -views["disparity"].transpose("t", "s").values * len(lf["u"])
        unit = "lens pitches; z is -disparity times the number of views: no distance in focus was told"
    else:
        metres = depth(views, focus_distance=options.focus_distance)["depth"].transpose("t", "s").values
        behind = 1 / (1 / float(views["focal_length"]) - 1 / options.focus_distance)
        pitch = float(lf["dh"]) * float(views["pixel_pitch"])
        x, y, z = x * pitch / behind * metres, y * pitch / behind * metres, metres
        unit = f"metres from the main lens, which was told to be focused at {options.focus_distance!r} m"
    file = path.with_name(f"{path.name}.ply")
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    write_ply(file, points, to_integers(develop(views["rgb"], views), 8).reshape(-1, 3), comment=f"unit: {unit}")
    return file


WRITERS: dict[str, Callable[[xr.Dataset, xr.Dataset, Path, Options], Path]] = {
    "views": _folder,
    "eslf": _eslf,
    "toolbox": _toolbox,
    "pfm": _pfm,
    "png16": _png16,
    "focal-stack": _focal_stack,
    "gif": _gif,
    "webp": _webp,
    "ply": _ply,
}
