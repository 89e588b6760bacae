"""What Lytro's software derived from a raw picture: ``-stk.lfp``, ``-dm.lfp`` and the Illum's web picture.

A refocus stack is a list of JPEG pictures, each with its refocus parameter λ, beside a coarse map of λ (the "depth
look-up table"); a depth map is λ and a confidence for each pixel. Float maps are little-endian float32, row by row.
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
from lfflow.formats.bounded_json import Json, at, finite_number
from lfflow.formats.container import Container, open_container
from lfflow.formats.errors import LimitError, MetadataError, StructureError
from lfflow.formats.jpeg import jpeg_size
from lfflow.formats.layout import MAX_SAMPLES
from lfflow.formats.region import Region

MAX_LAYERS = 256
_MAX_PIXELS_PER_BYTE = 1100
_PLACES = (("picture", "accelerationArray"), ("views", 0, "accelerations"))
_LAMBDA = {"long_name": "refocus parameter lambda", "units": "1"}


def accelerations(toc: Json) -> list[Json]:
    """The derived pictures that a table of contents lists, each one JSON object."""
    found: list[Json] = []
    for place in _PLACES:
        listed = at(toc, *place)
        if isinstance(listed, list):
            found += [item for item in listed if isinstance(item, dict)]
    return found


def open_rendering(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> xr.Dataset:
    """Lazy dataset of a refocus stack or a depth map.

    Parameters
    ----------
    path
        ``-stk.lfp``, ``-dm.lfp`` or an Illum web picture.
    accept_damaged
        Read also what differs from its SHA-1.

    Returns
    -------
    Dataset
        Where the file has them: picture (layer, y, x, channel) uint8 sRGB with refocus_lambda (layer); depth
        (depth_y, depth_x) float32, in λ; confidence (depth_y, depth_x) float32.

    Raises
    ------
    FileFormatError
        The subclass says how the file is broken.
    """
    return rendering(open_container(os.path.abspath(path), accept_damaged=accept_damaged))  # noqa: PTH100


def rendering(container: Container) -> xr.Dataset:
    """As `open_rendering`, for an opened container."""
    variables: dict[str, xr.Variable] = {}
    for item in accelerations(container.toc.value):
        # Desktop 3 keeps the description in vendorContent, the web picture beside the kind.
        content = at(item, "vendorContent") or item
        for name, key in (("depth", "depthMap"), ("depth", "depthLut"), ("confidence", "confidenceMap")):
            if isinstance(at(content, key), dict):
                variables[name] = _float_map(container, content, key, _LAMBDA if name == "depth" else {"units": "1"})
        layers = at(content, "imageArray") or at(content, "perImage")
        if isinstance(layers, list) and layers:
            variables |= _stack(container, content, layers)
    if not variables:
        raise StructureError(container.path, "table of contents", "no refocus stack or depth map", "one of them")
    attrs = {"table_of_contents": container.toc.text}
    coords = {name: variables.pop(name) for name in ("refocus_lambda", "channel") if name in variables}
    return xr.Dataset(variables, coords=coords, attrs=attrs)


def _float_map(container: Container, content: Json, key: str, attrs: dict[str, str]) -> xr.Variable:
    entry = content[key]
    # -dm.lfp gives the size once for both maps.
    width, height = (_size(container.path, key, at(entry, name) or at(content, name)) for name in ("width", "height"))
    region = _readable(container, container.chunk(at(entry, "imageRef"), f"{key}.imageRef"))
    if region.length != 4 * width * height:
        found = f"{region.length} bytes"
        raise StructureError(container.path, key, found, f"{4 * width * height} bytes ({width} × {height} float32)")
    return xr.Variable(("depth_y", "depth_x"), indexing.LazilyIndexedArray(FloatMap(region, height, width)), attrs)


def _stack(container: Container, content: Json, layers: list[Any]) -> dict[str, xr.Variable]:
    path = container.path
    if len(layers) > MAX_LAYERS:
        raise LimitError(path, "refocus stack", f"{len(layers)} pictures", f"at most {MAX_LAYERS}")
    sizes = {
        tuple(_size(path, "refocus stack", at(layer, name) or at(content, name)) for name in ("height", "width"))
        for layer in layers
    }
    if len(sizes) != 1:
        raise StructureError(path, "refocus stack", f"pictures of {len(sizes)} sizes", "one size")
    height, width = sizes.pop()
    regions = tuple(
        _readable(container, container.chunk(at(layer, "imageRef"), f"picture {number} of the stack"))
        for number, layer in enumerate(layers)
    )
    numbers = [at(layer, "lambda") if at(layer, "lambda") is not None else at(layer, "focus") for layer in layers]
    values = [finite_number(number) for number in numbers]
    pictures = indexing.LazilyIndexedArray(JpegStack(regions, height, width))
    return {
        "picture": xr.Variable(
            ("layer", "y", "x", "channel"), pictures, {"long_name": "picture, sRGB", "units": "1"},
            {"preferred_chunks": {"layer": 1, "y": height, "x": width, "channel": 3}},
        ),
        "refocus_lambda": xr.Variable(("layer",), np.array(values), _LAMBDA),
        "channel": xr.Variable(("channel",), list(CHANNELS)),
    }  # fmt: skip


def _readable(container: Container, region: Region) -> Region:
    return region.unchecked() if container.accept_damaged else region


def _size(path: str, where: str, value: Any) -> int:
    if type(value) is not int or not 0 < value <= MAX_SAMPLES:
        raise MetadataError(path, where, f"size {value!r:.40}", "a number of pixels")
    return value


class FloatMap(BackendArray):
    """Lazy float32 map (depth_y, depth_x) in a section."""

    def __init__(self, region: Region, height: int, width: int) -> None:
        self.region = region
        self.shape = (height, width)
        self.dtype = np.dtype(np.float32)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER_1VECTOR, self._read)

    def _read(self, key: tuple[Any, ...]) -> npt.NDArray[np.float32]:
        values = np.frombuffer(self.region.read(), "<f4").reshape(self.shape)
        return np.array(values[key], np.float32)


class JpegStack(BackendArray):
    """Lazy uint8 pictures (layer, y, x, channel); each layer is decoded when it is asked for."""

    def __init__(self, regions: tuple[Region, ...], height: int, width: int) -> None:
        self.regions = regions
        self.shape = (len(regions), height, width, 3)
        self.dtype = np.dtype(np.uint8)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[Any, ...]) -> npt.NDArray[np.uint8]:
        wanted = range(len(self.regions))[key[0]]
        if isinstance(wanted, int):
            return np.array(self._decode(wanted)[key[1:]], order="C")
        layers = [self._decode(number)[key[1:]] for number in wanted]
        empty = np.empty(self.shape[1:], np.uint8)[key[1:]]
        return np.stack(layers) if layers else np.empty((0, *empty.shape), np.uint8)

    def _decode(self, number: int) -> npt.NDArray[np.uint8]:
        import cv2

        region, (_, height, width, _) = self.regions[number], self.shape
        data = region.read()
        if height * width > _MAX_PIXELS_PER_BYTE * len(data):
            found = f"{width} × {height} pixels from {len(data)} bytes"
            raise LimitError(region.path, region.name, found, "what JPEG can pack")
        size = jpeg_size(data)
        if size != (height, width):
            raise StructureError(region.path, region.name, f"a JPEG of (height, width) {size}", f"{(height, width)}")
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if picture is None or picture.shape != (height, width, 3):
            raise StructureError(region.path, region.name, "a JPEG that cannot be decoded", "a picture")
        return np.asarray(picture[..., ::-1], np.uint8)
