"""Raw pictures in LFP containers: F01 ``.lfp``, Illum ``.lfr`` (METHOD B.1 to B.3).

Of a table of contents that lists several frames the first is the picture.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.formats.bounded_json import EMPTY, Document, Json, at, write_json
from lfflow.formats.container import Container, chunk_id, open_container, write_container
from lfflow.formats.errors import StructureError
from lfflow.formats.frame import Frame
from lfflow.formats.hot_pixels import pack_hot_pixels, unpack_hot_pixels
from lfflow.formats.metadata import frame_metadata
from lfflow.formats.region import Region

FRAMES = (("picture", "frameArray", 0), ("frames", 0))
"""Where the table of contents describes the frame: F01 and Desktop 3, Illum and Desktop 4."""


Image = Literal["raw", "modulation"]
IMAGES: dict[str, str] = {"raw": "imageRef", "modulation": "modulationDataRef"}


def open_lfp(path: str | os.PathLike[str], *, image: Image = "raw", accept_damaged: bool = False) -> xr.Dataset:
    """Lazy raw dataset of a picture.

    Parameters
    ----------
    path
        An LFP container with a sensor frame.
    image
        "raw", or "modulation": the white image that an Illum picture embeds.
    accept_damaged
        Read also what differs from its SHA-1; ``attrs["damaged"]`` then says what does.

    Returns
    -------
    Dataset
        `lfflow.schema.RAW`: raw (y, x) uint16, metadata as coordinates, JSON verbatim in the attributes.

    Raises
    ------
    FileFormatError
        The subclass says how the file is broken.
    """
    container = open_container(os.path.abspath(path), accept_damaged=accept_damaged)  # noqa: PTH100 - keeps ".." steps
    return raw_frame(container, image).dataset()


def raw_frame(container: Container, image: Image = "raw") -> Frame:
    """The sensor frame of a container, or the white image that an Illum embeds beside it ("modulation").

    Raises
    ------
    StructureError
        If it has none, or its image has the wrong size.
    """
    path = container.path
    entry, where = frame_entry(container)
    metadata = _document(container, entry, "metadata", where)
    if metadata is None:
        raise StructureError(path, where, "neither metadata nor metadataRef", "the metadata of the frame")
    private, missing = _private(container, entry, where)
    parsed = frame_metadata(metadata.value, private.value, tags_of(container.toc.value), path)
    key = IMAGES[image]
    region = frame_region(container.chunk(at(entry, key), f"{where}.{key}"), f"{image} image", parsed.layout.size)
    capture = Path(path).stem
    if image == "modulation":
        capture += "-modulation"
        parsed = replace(parsed, kind="white", coords={**parsed.coords, "kind": ((), "white")})
    damaged: tuple[str, ...] = ()
    if container.accept_damaged:
        damaged = tuple(words for section in container.sections for words in damage(section.region))
        damaged += container.damaged + missing
    documents = {"metadata": metadata, "private_metadata": private, "table_of_contents": container.toc}
    return Frame(capture, region.unchecked() if damaged else region, parsed, documents, damaged)


def read_hot_pixels(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> xr.Dataset:
    """Hot pixels that the camera knows of (Illum).

    Returns
    -------
    Dataset
        x (hot_pixel), y (hot_pixel): int64 sensor columns and rows; empty where the picture carries no list.

    Raises
    ------
    FileFormatError
        The subclass says how the file is broken.
    """
    container = open_container(os.path.abspath(path), accept_damaged=accept_damaged)  # noqa: PTH100
    entry, where = frame_entry(container)
    places = np.empty((2, 0), np.int64)
    if entry.get("hotPixelRef"):
        region = container.chunk(entry["hotPixelRef"], f"{where}.hotPixelRef")
        places = unpack_hot_pixels((region.unchecked() if accept_damaged else region).read(), container.path)
    return xr.Dataset(
        {
            "x": ("hot_pixel", places[0], {"long_name": "sensor column", "units": "pixel"}),
            "y": ("hot_pixel", places[1], {"long_name": "sensor row", "units": "pixel"}),
        }
    )


def frame_entry(container: Container) -> tuple[Json, str]:
    """The table of contents' entry of the frame, and where it stands."""
    for place in FRAMES:
        entry = at(container.toc.value, *place, "frame")
        if isinstance(entry, dict):
            return entry, f"{place[0]}.{place[1]}[0].frame" if len(place) > 2 else f"{place[0]}[0].frame"
    raise StructureError(container.path, "table of contents", "no frame", "picture.frameArray or frames")


def tags_of(toc: Json) -> Json:
    """The camera's own tags of a picture: darkFrame, modulationFrame."""
    for place in FRAMES:
        tags = at(toc, *place, "parameters", "vendorContent", "com.lytro.tags")
        if isinstance(tags, dict):
            return tags
    return {}


def frame_region(region: Region, name: str, size: int) -> Region:
    """The region under a name for messages, if it has the size of the frame."""
    if region.length != size:
        raise StructureError(region.path, name, f"{region.length} bytes", f"{size} bytes by the metadata")
    return Region(region.path, f"{name} ({region.name})", region.offset, region.length, region.sha1)


def damage(region: Region) -> tuple[str, ...]:
    """What is wrong with the bytes of a region, in words; empty when they are right."""
    digest = region.digest()
    if region.sha1 is None or digest == region.sha1:
        return ()
    return (f"{region.name}: SHA-1 {digest}, expected {region.sha1}",)


def write_lfp(
    path: str | os.PathLike[str],
    raw: npt.NDArray[np.uint16],
    metadata: Mapping[str, Any],
    private_metadata: Mapping[str, Any] | None = None,
    *,
    white: bool = False,
    dark: bool = False,
    modulation: npt.NDArray[np.uint16] | None = None,
    hot_pixels: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    embed_metadata: bool = False,
) -> None:
    """Write a raw picture as the cameras do: a ``.lfr`` with the Illum's table of contents, all else with the F01's.

    Parameters
    ----------
    path
        The file to make.
    raw
        Sensor samples (y, x).
    metadata
        The frame's JSON; size, bits and byte order in it must be those of `raw`.
    private_metadata
        JSON with ``camera.serialNumber``.
    white, dark
        The camera's tags: modulation image, dark frame.
    modulation
        White image (y, x) to embed.
    hot_pixels
        Columns and rows of the sensor's hot pixels.
    embed_metadata
        Put the JSON into the table of contents instead of chunks of their own.

    Raises
    ------
    FileFormatError
        If the metadata contradict themselves or the samples.
    """
    private, name = dict(private_metadata or {}), os.fspath(path)
    frame: dict[str, Any] = {"metadata": dict(metadata), "privateMetadata": private} if embed_metadata else {}
    chunks: dict[str, bytes] = {}
    if not embed_metadata:
        chunks = {"metadataRef": write_json(metadata), "privateMetadataRef": write_json(private)}
    chunks["imageRef"] = packed_frame(raw, metadata, private, name)
    if modulation is not None:
        chunks["modulationDataRef"] = packed_frame(modulation, metadata, private, name)
    if hot_pixels is not None:
        chunks["hotPixelRef"] = pack_hot_pixels(*hot_pixels)
    frame |= {key: chunk_id(data) for key, data in chunks.items()}
    tags = {"com.lytro.tags": {"darkFrame": dark, "modulationFrame": white}}
    entry = {"frame": frame, "parameters": {"vendorContent": tags}}
    toc = _illum_contents(entry) if Path(name).suffix.lower() == ".lfr" else _f01_contents(entry)
    write_container(path, toc, list(dict.fromkeys(chunks.values())))


def _f01_contents(entry: Json) -> Json:
    return {
        "picture": {"frameArray": [entry], "viewArray": [], "accelerationArray": [], "derivationArray": []},
        "thumbnailArray": [],
        "version": {"major": 1, "minor": 0, "provisionalDate": "2011-08-03"},
    }


def _illum_contents(entry: Json) -> Json:
    return {
        "schema": "http://schema.lytro.com/lfp/picture/2.1.4/picture_schema.json",
        "generators": ["lfflow"],
        "thumbnails": [],
        "derivations": [],
        "frames": [entry],
        "annotations": [],
        "views": [],
    }


def packed_frame(
    raw: npt.NDArray[np.uint16], metadata: Mapping[str, Any], private: Mapping[str, Any], path: str
) -> bytes:
    """Bytes of a frame in the packing that its metadata declare."""
    from lfflow.formats.packing import pack

    layout = frame_metadata(dict(metadata), dict(private), {}, path).layout
    if raw.shape != (layout.height, layout.width):
        raise StructureError(path, "samples", f"shape {raw.shape}", f"{(layout.height, layout.width)} by the metadata")
    highest = (1 << layout.packing.bits - layout.shift) - 1
    if raw.size and int(raw.max()) > highest:
        raise StructureError(path, "samples", f"a sample of {int(raw.max())}", f"at most {highest} by the metadata")
    return pack(np.left_shift(raw, np.uint16(layout.shift)), layout.packing)


def _document(
    container: Container, entry: Json, name: Literal["metadata", "privateMetadata"], where: str
) -> Document | None:
    if isinstance(entry.get(name), dict):
        return Document.of(entry[name])
    reference = entry.get(name + "Ref")
    if not reference:
        return None
    here = f"{where}.{name}Ref"
    return container.read_json(container.chunk(reference, here), here)


def _private(container: Container, entry: Json, where: str) -> tuple[Document, tuple[str, ...]]:
    """The part with the serial number, and what is wrong with it if that is accepted; people cut it out."""
    try:
        return _document(container, entry, "privateMetadata", where) or EMPTY, ()
    except StructureError as error:
        if not container.accept_damaged:
            raise
        return EMPTY, (f"{error.where}: {error.found}",)
