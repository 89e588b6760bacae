"""What an Illum picture (``.lfr``) has beyond an F01's: an embedded white image and a list of hot pixels.

The list is little-endian: a uint32 count, then the columns, then the rows, each int16.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.formats.bounded_json import at, write_json
from lfflow.formats.container import chunk_id, open_container, write_container
from lfflow.formats.errors import StructureError
from lfflow.formats.lfp import frame_entry, packed_frame

_COUNT = struct.Struct("<I")


def read_hot_pixels(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> xr.Dataset:
    """Hot pixels that the camera knows of.

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
    if at(entry, "hotPixelRef") is not None:
        region = container.chunk(entry["hotPixelRef"], f"{where}.hotPixelRef")
        data = (region.unchecked() if accept_damaged else region).read()
        count = _COUNT.unpack_from(data)[0] if len(data) >= _COUNT.size else -1
        if len(data) != _COUNT.size + 4 * count:
            raise StructureError(container.path, "hot pixels", f"{len(data)} bytes for {count} pixels", "4 + 4 · count")
        places = np.frombuffer(data, "<i2", offset=_COUNT.size).reshape(2, count).astype(np.int64)
    return xr.Dataset(
        {
            "x": ("hot_pixel", places[0], {"long_name": "sensor column", "units": "pixel"}),
            "y": ("hot_pixel", places[1], {"long_name": "sensor row", "units": "pixel"}),
        }
    )


def write_lfr(
    path: str | os.PathLike[str],
    raw: npt.NDArray[np.uint16],
    metadata: Mapping[str, Any],
    private_metadata: Mapping[str, Any] | None = None,
    *,
    modulation: npt.NDArray[np.uint16] | None = None,
    hot_pixels: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    embed_metadata: bool = False,
) -> None:
    """Write a raw picture as the Illum does.

    Parameters
    ----------
    path
        The ``.lfr`` to make.
    raw
        Sensor samples (y, x).
    metadata
        The frame's JSON; size, bits and byte order in it must be those of `raw`.
    private_metadata
        JSON with ``camera.serialNumber``.
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
    private = dict(private_metadata or {})
    name = os.fspath(path)
    chunks: dict[str, bytes] = {}
    frame: dict[str, Any] = {}
    if embed_metadata:
        frame = {"metadata": dict(metadata), "privateMetadata": private}
    else:
        chunks = {"metadataRef": write_json(metadata), "privateMetadataRef": write_json(private)}
    chunks["imageRef"] = packed_frame(raw, metadata, private, name)
    if modulation is not None:
        chunks["modulationDataRef"] = packed_frame(modulation, metadata, private, name)
    if hot_pixels is not None:
        x, y = (np.asarray(part, "<i2") for part in hot_pixels)
        chunks["hotPixelRef"] = _COUNT.pack(x.size) + x.tobytes() + y.tobytes()
    frame |= {key: chunk_id(data) for key, data in chunks.items()}
    toc = {
        "schema": "http://schema.lytro.com/lfp/picture/2.1.4/picture_schema.json",
        "generators": ["lfflow"],
        "thumbnails": [],
        "derivations": [],
        "frames": [{"frame": frame}],
        "annotations": [],
        "views": [],
    }
    write_container(path, toc, list(dict.fromkeys(chunks.values())))
