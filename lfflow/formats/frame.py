"""One sensor frame in a file, and the lazy dataset it is for users."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from lfflow.formats.bounded_json import EMPTY, Document
from lfflow.formats.layout import FrameLayout
from lfflow.formats.metadata import FrameMetadata
from lfflow.formats.region import Region
from lfflow.schema import RAW


@dataclass(frozen=True, slots=True)
class Frame:
    """Where the samples of a frame lie, and what its file says about it.

    Parameters
    ----------
    capture
        Id of the picture: the stem of the file.
    region
        The packed samples.
    metadata
        Layout and coordinates.
    documents
        The JSON of the file by name: "metadata", "private_metadata", "table_of_contents".
    damaged
        What is wrong with the file although it was accepted, in words.
    """

    capture: str
    region: Region
    metadata: FrameMetadata
    documents: dict[str, Document] = field(default_factory=dict)
    damaged: tuple[str, ...] = ()

    def dataset(self) -> xr.Dataset:
        """Raw dataset of the frame (`lfflow.schema.RAW`); nothing of the samples is read."""
        layout = self.metadata.layout
        coords: dict[str, xr.Variable] = {
            "capture": xr.Variable((), self.capture, {"long_name": "picture", "units": "1"}),
            "y": _variable("y", ("y",), np.arange(layout.height)),
            "x": _variable("x", ("x",), np.arange(layout.width)),
        }
        coords |= {name: _variable(name, dims, value) for name, (dims, value) in self.metadata.coords.items()}
        samples = indexing.LazilyIndexedArray(FrameArray(self.region, layout))
        raw = xr.Variable(("y", "x"), samples, RAW["raw"].attrs)
        attrs: dict[str, Any] = {"schema": RAW.name, "schema_version": RAW.version, "damaged": "; ".join(self.damaged)}
        attrs |= {name: self.documents.get(name, EMPTY).text for name in ("metadata", "private_metadata")}
        attrs |= {name: document.text for name, document in self.documents.items()}
        return xr.Dataset({"raw": raw}, coords=coords, attrs=attrs)


def _variable(name: str, dims: tuple[str, ...], value: Any) -> xr.Variable:
    return xr.Variable(dims, value, RAW[name].attrs)


class FrameArray(BackendArray):
    """Lazy uint16 samples (y, x) of a frame: a window reads the bytes of its rows only (`lfflow.formats.region`)."""

    def __init__(self, region: Region, layout: FrameLayout) -> None:
        self.region = region
        self.layout = layout
        self.shape = (layout.height, layout.width)
        self.dtype = np.dtype(np.uint16)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._window)

    def rows(self, first: int, last: int) -> npt.NDArray[np.uint16]:
        """Samples of rows `first` … `last` − 1, shape (last − first, width)."""
        from lfflow.formats.packing import unpack, window

        width = self.layout.width
        begin, length, skipped = window(self.layout, first, last)
        data = self.region.read_part(begin, length)
        count = (last - first) * width
        samples = unpack(data, self.layout.packing, skipped + count)[skipped:].reshape(last - first, width)
        return samples >> np.uint16(self.layout.shift) if self.layout.shift else samples

    def _window(self, key: tuple[int | slice, int | slice]) -> npt.NDArray[np.uint16]:
        row, column = key
        wanted = range(self.layout.height)[row]
        if isinstance(wanted, int):
            return np.array(self.rows(wanted, wanted + 1)[0][column], order="C")
        if not wanted:
            return np.empty((0, self.layout.width), np.uint16)[:, column]
        return np.array(self.rows(min(wanted), max(wanted) + 1)[:: wanted.step][:, column], order="C")
