"""The zarr store that a schema declares: every metadata file and small array, byte for byte."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec
from zarr.storage import MemoryStore, StorePath

from lfflow.collection.records import Record
from lfflow.collection.scalars import SMALL_SIZES, decode, is_region, small_variables
from lfflow.conventions import CHANNELS, SITES
from lfflow.schema import PARAMETERS, Schema, Variable

_SMALL_CHUNK = 4096
_LARGEST_BLOCK = 1024
_NAT = np.iinfo(np.int64).min
_LIST_OF_TEXTS = re.compile(rb'(?<=": )\[(?:\s*"(?:[^"\\]|\\.)*",?)*\s*\]')
_LABELS = {"channel": CHANNELS, "site": SITES, "parameter": PARAMETERS, "axis": ("x", "y")}


def compressors() -> list[Any]:
    """Codecs of every array; the checksum is the last, so that it covers what lies on the disk."""
    return [BloscCodec(cname="zstd", clevel=3, shuffle="shuffle"), Crc32cCodec()]


def axis_values(name: str, size: int) -> np.ndarray[Any, Any]:
    """Values of an axis: views are centred on 0, channels and the like have names, the rest counts from 0."""
    if name in _LABELS:
        return np.array(_LABELS[name], dtype=object)
    return np.arange(size) - (size // 2 if name in ("u", "v") else 0)


def block(length: int) -> int:
    """Largest divisor of `length` that keeps a chunk's edge small; a prime length is one chunk."""
    return max(
        part
        for part in range(1, min(length, _LARGEST_BLOCK) + 1)
        if (length % part == 0 and part * 16 > length) or part == 1
    )


def region_chunks(variable: Variable, sizes: Mapping[str, int]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Chunk (one view of one capture) and shard (one capture) of a large array with its capture dim."""
    shard = tuple(sizes[dim] for dim in variable.dims)
    edges = {"v": 1, "u": 1, "y": block(sizes["y"]) if "y" in sizes else 1}
    return (1, *(edges.get(dim, sizes[dim]) for dim in variable.dims)), (1, *shard)


def build(
    schema: Schema,
    group: str,
    sizes: Mapping[str, int],
    captures: Sequence[str],
    records: Mapping[str, Record],
    history: Sequence[str] = (),
    *,
    values: bool = True,
) -> dict[str, bytes]:
    """Content by key of the store of one group: metadata, axes and small variables; no regions.

    Without `values` the metadata only.
    """
    content: dict[str, Any] = {}
    store = MemoryStore(store_dict=content)
    zarr.create_group(store, attributes={"title": f"lfflow {schema.name}"})
    attributes = {
        "Conventions": "CF-1.11",
        "title": schema.description,
        "schema": schema.name,
        "schema_version": schema.version,
        "history": list(history),
    }
    zarr.create_group(StorePath(store, group), attributes=attributes)
    place = StorePath(store, group)
    write = _written if values else _declared
    write(place, "capture", ("capture",), np.array(captures, dtype=object), "string", {"long_name": "capture"})
    for variable in schema.variables:
        if variable.axis:
            size = sizes.get(variable.name, SMALL_SIZES.get(variable.name, 0))
            write(place, variable.name, variable.dims, axis_values(variable.name, size), variable.dtype,
                   _attributes(variable))  # fmt: skip
        elif is_region(variable):
            _large(place, variable, sizes, len(captures))
    for variable in small_variables(schema):
        rows = [decode(records[name].scalars if name in records else {}, variable) for name in captures]
        shape = (len(captures), *(SMALL_SIZES[dim] for dim in variable.dims))
        stacked = np.stack(rows) if rows else np.empty(shape, dtype=object)
        write(place, variable.name, ("capture", *variable.dims), stacked, variable.dtype,
               _attributes(variable))  # fmt: skip
    return {key: value.to_bytes() for key, value in sorted(content.items())}


def _attributes(variable: Variable) -> dict[str, Any]:
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in variable.attrs.items()}


def _large(place: StorePath, variable: Variable, sizes: Mapping[str, int], captures: int) -> None:
    chunks, shards = region_chunks(variable, sizes)
    attributes = _attributes(variable)
    if variable.keep_bits is not None:
        attributes["keep_bits"] = variable.keep_bits
    zarr.create_array(
        place / variable.name,
        shape=(captures, *shards[1:]),
        chunks=chunks,
        shards=shards,
        dtype=variable.dtype,
        fill_value=variable.fill_value,
        compressors=compressors(),
        dimension_names=("capture", *variable.dims),
        attributes=attributes,
    )


def _written(
    place: StorePath, name: str, dims: tuple[str, ...], values: np.ndarray[Any, Any], dtype: str, attributes: Any
) -> None:
    array = _declared(place, name, dims, values, dtype, attributes)
    if values.size:
        array[...] = values.astype("datetime64[ns]").astype("int64") if dtype.startswith("datetime") else values


def _declared(
    place: StorePath, name: str, dims: tuple[str, ...], values: np.ndarray[Any, Any], dtype: str, attributes: Any
) -> Any:
    if dtype.startswith("datetime"):
        units = {"units": "nanoseconds since 1970-01-01", "calendar": "proleptic_gregorian", "_FillValue": _NAT}
        dtype, attributes = "int64", {**attributes, **units}
    fill: Any = "" if dtype == "string" else (np.nan if dtype.startswith("float") else 0)
    return zarr.create_array(
        place / name,
        shape=values.shape,
        chunks=tuple(max(1, min(length, _SMALL_CHUNK)) if dim != "capture" else _SMALL_CHUNK
                     for dim, length in zip(dims, values.shape, strict=True)),
        dtype=dtype,
        fill_value=fill,
        serializer=BytesCodec() if dtype != "string" else "auto",
        compressors=compressors() if dtype != "string" else [Crc32cCodec()],
        dimension_names=dims,
        attributes=attributes,
        config={"write_empty_chunks": True},
    )  # fmt: skip


def differences(found: bytes, expected: bytes) -> list[str]:
    """What the metadata of an array or group on the disk has that its declaration has not; capture count left out."""
    try:
        mine, theirs = _lasting(found), _lasting(expected)
    except ValueError as error:
        return [f"not readable ({error})"]
    if not isinstance(mine, dict):
        return ["not a zarr node"]
    keys = sorted({*mine, *theirs})
    return [
        f"{key}: found {mine.get(key)}, expected {theirs.get(key)}" for key in keys if mine.get(key) != theirs.get(key)
    ]


def _lasting(data: bytes) -> Any:
    """Metadata of an array or group without what grows: the number of captures, and the history."""
    document = json.loads(data)
    if _captures(document) is not None:
        document["shape"] = document["shape"][1:]
    if isinstance(document, dict) and isinstance(document.get("attributes"), dict):
        document["attributes"].pop("history", None)
    return document


def has_other_length(found: bytes, expected: bytes) -> bool:
    """Whether an array has not the captures of its group: its last growth was lost, stopped half-way, or rotted."""
    mine, theirs = _captures(json.loads(found)), _captures(json.loads(expected))
    return mine is not None and theirs is not None and mine != theirs


def _captures(document: Any) -> int | None:
    """Captures that the metadata of an array have room for; None where they say nothing of it, or are damaged."""
    shape, names = (document.get(key) if isinstance(document, dict) else None for key in ("shape", "dimension_names"))
    if not (isinstance(shape, list) and isinstance(names, list) and shape and names[:1] == ["capture"]):
        return None
    return shape[0] if isinstance(shape[0], int) else None


def looks_rotten(found: bytes, expected: bytes) -> bool:
    """Whether a metadata file is the expected one with a few bytes hit, rather than another program's intent.

    Files are compared as they were written, since other programs lay them out in other ways; but a group carries its
    history, a list of texts whose name may be what was hit, which is compared without.
    """
    try:
        json.loads(found)
    except ValueError:
        return True
    if json.loads(expected).get("node_type") == "group":
        found, expected = (_LIST_OF_TEXTS.sub(b"[]", data) for data in (found, expected))
    return _few_hits(found, expected)


def _few_hits(mine: bytes, theirs: bytes) -> bool:
    return len(mine) == len(theirs) and sum(a != b for a, b in zip(mine, theirs, strict=True)) <= 8
