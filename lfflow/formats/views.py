"""Folders of view images as the HCI 4D Light Field Benchmark names them: ``input_Cam000.png``, row by row from the top.

View number n of a grid of N × N stands at row ``v = n // N − N//2`` and column ``u = n % N − N//2``. Views may be
missing (star-shaped subsets): then they are NaN, and `present` says so. Values are those of the files divided by
their maximum (255 or 65535); no transfer curve is undone.
"""

from __future__ import annotations

import configparser
import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from lfflow.conventions import CHANNELS
from lfflow.formats.errors import LimitError, MetadataError, StructureError, UnknownFormatError, UnreadableError
from lfflow.formats.png import Picture, png_header, read_png, write_png
from lfflow.formats.region import open_binary
from lfflow.formats.writing import written_whole
from lfflow.schema import VIEWS

MAX_VIEWS = 4096
_HCI_GRID = 9
_NAME = re.compile(r"input_Cam(\d{3,4})\.png", re.IGNORECASE)
_PARAMETERS = "parameters.cfg"
_MAX_PARAMETERS = 1 << 15  # configparser takes quadratic time over lines that it does not understand
_CAMERA_NUMBERS = (
    ("focal_length_mm", "focal length of the main lens", "mm"),
    ("sensor_size_mm", "size of the sensor's longer side", "mm"),
    ("baseline_mm", "distance of neighbouring cameras", "mm"),
    ("focus_distance_m", "distance of the focal plane", "m"),
    ("disp_min", "smallest disparity", "pixel"),
    ("disp_max", "largest disparity", "pixel"),
)

Floats = npt.NDArray[np.float32]


def is_view_folder(path: str | os.PathLike[str]) -> bool:
    """Whether a folder holds view images by name."""
    try:
        with os.scandir(path) as entries:
            return any(_NAME.fullmatch(entry.name) for entry in entries)
    except OSError:
        return False


def open_views(path: str | os.PathLike[str]) -> xr.Dataset:
    """Lazy light field of a folder of view images.

    Parameters
    ----------
    path
        Folder with ``input_CamNNN.png`` and, if it is there, ``parameters.cfg``.

    Returns
    -------
    Dataset
        `lfflow.schema.VIEWS`: rgb (v, u, t, s, channel) float32 in 0 … 1; coordinates present (v, u) and the numbers of
        ``parameters.cfg``; its text in the attributes.

    Raises
    ------
    FileFormatError
        If the folder has no views, they differ in size, or a file is broken.
    """
    folder = os.path.abspath(path)  # noqa: PTH100
    files = view_files(folder)
    text, numbers = _parameters(folder)
    side = _grid(folder, files, numbers)
    headers = {name: png_header(os.path.join(folder, name)) for name in files.values()}  # noqa: PTH118
    sizes = {(header.height, header.width) for header in headers.values()}
    if len(sizes) != 1:
        raise StructureError(folder, "views", f"pictures of {len(sizes)} sizes", "one size")
    height, width = sizes.pop()
    present = np.zeros(side * side, bool)
    present[list(files)] = True
    array = indexing.LazilyIndexedArray(ViewsArray(folder, files, side, height, width))
    coords: dict[str, xr.Variable] = {
        name: xr.Variable((name,), values, VIEWS[name].attrs)
        for name, values in _axes(side, side, height, width).items()
    }
    coords["present"] = xr.Variable(("v", "u"), present.reshape(side, side), {"long_name": "view is there"})
    for name, long_name, units in _CAMERA_NUMBERS:
        if name in numbers:
            coords[name] = xr.Variable((), numbers[name], {"long_name": long_name, "units": units})
    rgb = views_variable(array, {"v": 1, "u": 1, "t": height, "s": width, "channel": 3})
    attrs = {"schema": VIEWS.name, "schema_version": VIEWS.version, "parameters": text}
    return xr.Dataset({"rgb": rgb}, coords=coords, attrs=attrs)


def write_views(path: str | os.PathLike[str], ds: xr.Dataset, *, bits: int = 8) -> None:
    """Write the views of a light field as HCI names them, with ``parameters.cfg``.

    Parameters
    ----------
    path
        Folder to make; files of the same names in it are replaced.
    ds
        With rgb (v, u, t, s, channel) in 0 … 1, in any order of dims; values outside are clipped, a view of NaN only is
        not written, other NaN are 0. The grid must be square and odd.
    bits
        8 or 16.

    Raises
    ------
    ValueError
        If the grid is another, or `bits`.
    """
    rgb = ds["rgb"].transpose("v", "u", "t", "s", "channel")
    side = rgb.sizes["v"]
    if side != rgb.sizes["u"] or side % 2 == 0:
        raise ValueError(f"a grid of {side} × {rgb.sizes['u']} views, expected a square and odd one")
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(side * side):
        view = np.asarray(rgb.isel(v=number // side, u=number % side).values, np.float32)
        if not np.isnan(view).all():
            write_png(folder / f"input_Cam{number:03d}.png", as_integers(view, bits))
    with written_whole(folder / _PARAMETERS) as file:
        file.write(_parameters_text(ds, side).encode())


def as_integers(values: npt.ArrayLike, bits: int) -> Picture:
    """Values in 0 … 1 as integers of 8 or 16 bits: clipped, rounded to nearest, NaN as 0."""
    if bits not in (8, 16):
        raise ValueError(f"{bits} bits, expected 8 or 16")
    top = (1 << bits) - 1
    scaled = np.rint(np.clip(np.nan_to_num(np.asarray(values, np.float64)), 0, 1) * top)
    return scaled.astype(np.uint8) if bits == 8 else scaled.astype(np.uint16)


def as_floats(picture: npt.NDArray[Any]) -> Floats:
    """Integers as values in 0 … 1, float32: the inverse of `as_integers`."""
    top = np.float64(np.iinfo(picture.dtype).max)
    return (picture / top).astype(np.float32)


def views_variable(array: Any, chunks: dict[str, int]) -> xr.Variable:
    """Variable rgb (v, u, t, s, channel) around a lazy array."""
    rgb = xr.Variable(
        ("v", "u", "t", "s", "channel"), array, VIEWS["rgb"].attrs | {"long_name": "value of each channel"}
    )
    rgb.encoding["preferred_chunks"] = chunks
    return rgb


def _axes(rows: int, columns: int, height: int, width: int) -> dict[str, Any]:
    return {
        "v": np.arange(rows) - rows // 2,
        "u": np.arange(columns) - columns // 2,
        "t": np.arange(height),
        "s": np.arange(width),
        "channel": list(CHANNELS),
    }


class ViewsArray(BackendArray):
    """Lazy float32 (v, u, t, s, channel): a view is decoded when some of it is asked for; a missing one is NaN."""

    def __init__(self, folder: str, files: dict[int, str], side: int, height: int, width: int) -> None:
        self.folder, self.files, self.side = folder, files, side
        self.shape = (side, side, height, width, 3)
        self.dtype = np.dtype(np.float32)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[Any, ...]) -> Floats:
        rows, columns = (np.arange(self.side)[part] for part in key[:2])
        inside = key[2:]
        view_shape = np.empty(self.shape[2:], np.bool_)[inside].shape
        out = np.full((rows.size, columns.size, *view_shape), np.nan, np.float32)
        for i, row in enumerate(np.atleast_1d(rows)):
            for j, column in enumerate(np.atleast_1d(columns)):
                name = self.files.get(int(row) * self.side + int(column))
                if name is not None:
                    out[i, j] = as_floats(self._view(name)[inside])
        return out.reshape(rows.shape + columns.shape + view_shape)

    def _view(self, name: str) -> Picture:
        path = os.path.join(self.folder, name)  # noqa: PTH118 - quick, once per view
        picture = read_png(path)
        if picture.shape != self.shape[2:]:
            raise StructureError(path, "size", f"{picture.shape[:2]}", f"{self.shape[2:4]} as when it was opened")
        return picture


def view_files(folder: str) -> dict[int, str]:
    """Names of the view images in a folder by their number.

    Raises
    ------
    FileFormatError
        If there are none, or two of one number, or one beyond all grids.
    """
    files: dict[int, str] = {}
    for name in _names(folder):
        match = _NAME.fullmatch(name)
        if match is None:
            continue
        number = int(match[1])
        if number >= MAX_VIEWS:
            raise LimitError(folder, name, f"view {number}", f"at most {MAX_VIEWS} views")
        if number in files:
            raise StructureError(folder, name, f"view {number} a second time", f"one file ({files[number]})")
        files[number] = name
    if not files:
        raise UnknownFormatError(folder, "folder", "no input_CamNNN.png", "a folder of view images")
    return files


def _names(folder: str) -> list[str]:
    try:
        return sorted(os.listdir(folder))  # noqa: PTH208 - names are wanted
    except OSError as error:
        raise UnreadableError(folder, "folder", error.strerror, "a readable folder") from error


def _grid(folder: str, files: dict[int, str], numbers: dict[str, float]) -> int:
    top = max(files)
    declared = {numbers[name] for name in ("num_cams_x", "num_cams_y") if name in numbers}
    if declared:
        side = int(declared.pop())
        if declared or side < 1 or side % 2 == 0 or not top < side * side <= MAX_VIEWS:
            raise MetadataError(folder, _PARAMETERS, f"grid {numbers}", f"a square, odd grid with view {top} in it")
        return side
    whole = math.isqrt(len(files))
    if whole * whole == len(files) == top + 1 and whole % 2:
        return whole
    return max(_HCI_GRID, (math.isqrt(top) + 1) // 2 * 2 + 1)


def _parameters(folder: str) -> tuple[str, dict[str, float]]:
    path = os.path.join(folder, _PARAMETERS)  # noqa: PTH118
    if not Path(path).is_file():
        return "", {}
    with open_binary(path) as file:
        data = file.read(_MAX_PARAMETERS + 1)
    if len(data) > _MAX_PARAMETERS:
        raise LimitError(path, "file", f"more than {_MAX_PARAMETERS} bytes", "a few lines")
    text = data.decode("utf-8", "replace")
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise MetadataError(path, "text", _fault(error), "sections of name = value") from error
    wanted = {name for name, _, _ in _CAMERA_NUMBERS} | {"num_cams_x", "num_cams_y"}
    numbers: dict[str, float] = {}
    for section in parser.sections():
        for key, value in parser.items(section):
            if key in wanted and math.isfinite(number := _number(value)):
                numbers[key] = number
    return text, numbers


def _fault(error: configparser.Error) -> str:
    """The first line that the parser does not understand."""
    if isinstance(error, configparser.MissingSectionHeaderError):
        return f"line {error.lineno} before any [section]: {error.line:.40}"
    if isinstance(error, configparser.ParsingError) and error.errors:
        number, line = error.errors[0]
        return f"line {number}: {line:.40}"
    return str(error).splitlines()[0][:80]


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan


def _parameters_text(ds: xr.Dataset, side: int) -> str:
    lines = ["[intrinsics]", f"image_resolution_x_px = {ds.sizes['s']}", f"image_resolution_y_px = {ds.sizes['t']}"]
    present = [name for name, _, _ in _CAMERA_NUMBERS if name in ds.variables]
    optics = ("focal_length_mm", "sensor_size_mm")
    lines += [f"{name} = {float(ds[name])!r}" for name in present if name in optics]
    lines += ["", "[extrinsics]", f"num_cams_x = {side}", f"num_cams_y = {side}"]
    lines += [f"{name} = {float(ds[name])!r}" for name in present if name not in optics and not name.startswith("disp")]
    lines += ["", "[meta]", *(f"{name} = {float(ds[name])!r}" for name in present if name.startswith("disp"))]
    return "\n".join(lines) + "\n"
