"""ESLF pictures: all lenses side by side, each as its square of N × N views (Stanford's ``_eslf.png``, N = 14).

Sample (row, column) of the picture is view ``v = row % N − N//2``, ``u = column % N − N//2`` of the lens
``t = row // N``, ``s = column // N``. Pictures written here say their N in a text chunk "views".
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from lfflow.conventions import CHANNELS
from lfflow.formats.errors import MetadataError, StructureError
from lfflow.formats.png import png_header, png_text, read_png, write_png
from lfflow.formats.views import as_floats, as_integers, views_variable
from lfflow.schema import VIEWS

STANFORD_VIEWS = 14
_KEY = "views"


def open_eslf(path: str | os.PathLike[str], *, views: int | None = None) -> xr.Dataset:
    """Lazy light field of an ESLF picture.

    Parameters
    ----------
    path
        A PNG of 8 or 16 bits.
    views
        N; by default what the picture's text says, else 14.

    Returns
    -------
    Dataset
        `lfflow.schema.VIEWS`: rgb (v, u, t, s, channel) float32 in 0 … 1. A PNG can only be decoded as a whole, so any
        window costs the whole picture.

    Raises
    ------
    FileFormatError
        If it is no PNG, or its size is no multiple of N.
    """
    name = os.path.abspath(path)  # noqa: PTH100
    header = png_header(name)
    side = views if views is not None else _declared(name)
    rows, rest_rows = divmod(header.height, side)
    columns, rest_columns = divmod(header.width, side)
    if rest_rows or rest_columns:
        raise StructureError(name, "size", f"{header.width} × {header.height}", f"multiples of {side} views")
    shape = (side, side, rows, columns, 3)
    values = (np.arange(side) - side // 2, np.arange(side) - side // 2, np.arange(rows), np.arange(columns))
    axes = dict(zip(("v", "u", "t", "s", "channel"), (*values, list(CHANNELS)), strict=True))
    coords = {axis: xr.Variable((axis,), value, VIEWS[axis].attrs) for axis, value in axes.items()}
    rgb = views_variable(indexing.LazilyIndexedArray(EslfArray(name, shape)), dict(zip(axes, shape, strict=True)))
    return xr.Dataset({"rgb": rgb}, coords=coords, attrs={"schema": VIEWS.name, "schema_version": VIEWS.version})


def write_eslf(path: str | os.PathLike[str], ds: xr.Dataset, *, bits: int = 8) -> None:
    """Write rgb (v, u, t, s, channel), values 0 … 1 in any order of dims, as an ESLF picture of 8 or 16 bits.

    Raises
    ------
    ValueError
        If the grid of views is not square, or `bits` is another number.
    """
    rgb = ds["rgb"].transpose("t", "v", "s", "u", "channel")
    rows, side, columns, across, _ = rgb.shape
    if side != across:
        raise ValueError(f"a grid of {side} × {across} views, expected a square one")
    picture = as_integers(rgb.values, bits).reshape(rows * side, columns * side, 3)
    write_png(path, picture, {_KEY: str(side)})


def _declared(path: str) -> int:
    text = png_text(path).get(_KEY)
    if text is None:
        return STANFORD_VIEWS
    if not (text.isascii() and text.isdecimal() and len(text) <= 2 and 0 < int(text) <= 64):
        raise MetadataError(path, f"text {_KEY!r}", repr(text[:20]), "a number of views, 1 … 64")
    return int(text)


class EslfArray(BackendArray):
    """Lazy float32 (v, u, t, s, channel) of a lenslet picture."""

    def __init__(self, path: str, shape: tuple[int, int, int, int, int]) -> None:
        self.path = path
        self.shape = shape
        self.dtype = np.dtype(np.float32)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[Any, ...]) -> npt.NDArray[np.float32]:
        side, _, rows, columns, _ = self.shape
        picture = read_png(self.path)
        if picture.shape != (rows * side, columns * side, 3):
            raise StructureError(self.path, "size", f"{picture.shape[:2]}", f"{(rows * side, columns * side)}")
        lenses = picture.reshape(rows, side, columns, side, 3)
        return np.array(as_floats(lenses.transpose(1, 3, 0, 2, 4)[key]), order="C")
