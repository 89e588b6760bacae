"""LFToolbox's light fields: the array ``LF`` in a MATLAB file of version 5 to 7.2.

``LF(j, i, l, k, c)`` has the view's row and column first, then the lens row and column, then R, G, B and, as a fourth
channel, a weight; integers are scaled by their maximum. LFToolbox saves with ``-v6``: uncompressed, column-major, so
that it is mapped here and read as asked for. A compressed array (``-v7``) is inflated as a whole, never beyond the size
that its header declares, and must fit its checksum; ``-v6`` carries none. ``-v7.3`` is HDF5: refused with the command
that converts it, because a file from a stranger is better kept away from a large parser in C than read from everywhere.
"""

from __future__ import annotations

import math
import mmap
import os
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
import numpy.typing as npt
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from lfflow.conventions import CHANNELS
from lfflow.formats.errors import (
    ChecksumError,
    LimitError,
    MetadataError,
    StructureError,
    TruncatedError,
    UnsupportedError,
)
from lfflow.formats.foreign import foreign
from lfflow.formats.region import open_binary
from lfflow.formats.views import as_integers
from lfflow.formats.writing import written_whole
from lfflow.schema import VIEWS

_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_CLASSES = {6: "f8", 7: "f4", 9: "u1", 11: "u2"}
_MAX_ELEMENTS = 1 << 33
_MAX_VARIABLES = 256
_HEAD_BYTES = 1024
_DIMS = 5
_MAX_REST = 64


@dataclass(frozen=True, slots=True)
class _Matrix:
    """Header of a numeric array: name, class, shape, and where and how its values lie in its element."""

    name: str
    dtype: np.dtype[Any]
    stored: np.dtype[Any]
    shape: tuple[int, ...]
    values: int
    size: int


def is_toolbox(head: bytes) -> bool:
    """Whether a file that begins with these 128 bytes is a MATLAB file of version 5."""
    return head[:6] == b"MATLAB" and len(head) >= _HEADER_BYTES and head[124:128] in (b"\0\1IM", b"\1\0MI")


def open_toolbox(path: str | os.PathLike[str]) -> xr.Dataset:
    """Lazy light field of an LFToolbox file.

    Returns
    -------
    Dataset
        `lfflow.schema.VIEWS`: rgb (v, u, t, s, channel) float32 in 0 … 1, and weight (v, u, t, s) where LF has a fourth
        channel.

    Raises
    ------
    FileFormatError
        The subclass says how the file is broken.
    """
    name = os.path.abspath(path)  # noqa: PTH100
    matrix, offset, length = _find(name)
    rows, columns, height, width, channels = matrix.shape
    array = ToolboxArray(name, matrix, offset, length)
    values = (np.arange(rows) - rows // 2, np.arange(columns) - columns // 2, np.arange(height), np.arange(width))
    axes = dict(zip(("v", "u", "t", "s", "channel"), (*values, list(CHANNELS)), strict=True))
    coords = {axis: xr.Variable((axis,), value, VIEWS[axis].attrs) for axis, value in axes.items()}
    lazy = xr.Variable(("v", "u", "t", "s", "channel"), indexing.LazilyIndexedArray(array))
    variables = {"rgb": lazy[..., :3]}
    variables["rgb"].attrs = VIEWS["rgb"].attrs | {"long_name": "value of each channel"}
    variables["rgb"].encoding["preferred_chunks"] = dict(zip(axes, (*matrix.shape[:4], 1), strict=True))
    if channels == 4:
        variables["weight"] = lazy[..., 3]
        variables["weight"].attrs = {"long_name": "weight", "units": "1"}
    return xr.Dataset(variables, coords=coords, attrs={"schema": VIEWS.name, "schema_version": VIEWS.version})


def write_toolbox(path: str | os.PathLike[str], ds: xr.Dataset) -> None:
    """Write rgb (v, u, t, s, channel), and weight (v, u, t, s) where there is one, as LFToolbox does: uint16, ``-v6``.

    Raises
    ------
    ValueError
        If the array is larger than a MATLAB file of version 5 holds (4 GiB).
    """
    from scipy.io import savemat

    parts = [ds["rgb"].transpose("v", "u", "t", "s", "channel").values]
    if "weight" in ds.variables:
        parts.append(ds["weight"].transpose("v", "u", "t", "s").values[..., None])
    integers = as_integers(np.concatenate(parts, axis=-1), 16)
    if integers.nbytes >= 1 << 32:
        raise ValueError(f"{integers.nbytes} bytes do not fit into a MATLAB file of version 5 (4 GiB)")
    with written_whole(Path(path)) as file:
        savemat(cast("Any", file), {"LF": integers}, do_compression=False)


class ToolboxArray(BackendArray):
    """Lazy float32 (v, u, t, s, channel) of the array LF."""

    def __init__(self, path: str, matrix: _Matrix, offset: int, length: int) -> None:
        self.path, self.matrix, self.offset, self.length = path, matrix, offset, length
        self.shape = matrix.shape
        self.dtype = np.dtype(np.float32)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[Any, ...]) -> npt.NDArray[np.float32]:
        matrix = self.matrix
        with open_binary(self.path) as file:
            if os.fstat(file.fileno()).st_size < self.offset + self.length:
                raise TruncatedError(self.path, "LF", "a file shorter than when it was opened", f"{self.length} bytes")
            if matrix.values < 0:
                file.seek(self.offset)
                whole = _inflate(file.read(self.length), _inflated_size(matrix), self.path)
                return self._scaled(np.frombuffer(whole, matrix.stored, math.prod(self.shape), -matrix.values), key)
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
                flat = np.frombuffer(mapped, matrix.stored, math.prod(self.shape), self.offset + matrix.values)
                scaled = self._scaled(flat, key)
                del flat
                return scaled

    def _scaled(self, flat: npt.NDArray[Any], key: tuple[Any, ...]) -> npt.NDArray[np.float32]:
        values = flat.reshape(self.shape, order="F")[key].astype(self.matrix.dtype)
        if values.dtype.kind == "u":
            return np.asarray(values / np.float64(np.iinfo(values.dtype).max), np.float32)
        return np.array(values, np.float32)


def _find(path: str) -> tuple[_Matrix, int, int]:
    with open_binary(path) as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(_HEADER_BYTES)
        if not is_toolbox(head):
            raise foreign(path, head, "a MATLAB file of version 5 to 7.2")
        if head[126:128] != b"IM":
            raise UnsupportedError(path, "header", "big-endian", "a little-endian MATLAB file")
        offset = _HEADER_BYTES
        for _ in range(_MAX_VARIABLES):
            if offset == size:
                break
            kind, length = _tag(file, offset, size, path)
            matrix = _matrix(file, offset + 8, kind, length, path)
            if matrix is not None and matrix.name == "LF":
                return _checked(matrix, kind, length, path), offset + 8, length
            offset = min(size, offset + 8 + length + (-length % 8 if kind != _COMPRESSED else 0))
    raise StructureError(path, "variables", "no numeric array LF", "the array LF of LFToolbox")


def _tag(file: BinaryIO, offset: int, size: int, path: str) -> tuple[int, int]:
    file.seek(offset)
    tag = file.read(8)
    kind, length = int.from_bytes(tag[:4], "little"), int.from_bytes(tag[4:], "little")
    if len(tag) < 8 or offset + 8 + length > size:
        raise TruncatedError(path, f"element at byte {offset}", f"{size - offset - 8} bytes", f"{length} bytes")
    return kind, length


def _matrix(file: BinaryIO, offset: int, kind: int, length: int, path: str) -> _Matrix | None:
    file.seek(offset)
    head = file.read(min(length, _HEAD_BYTES))
    if kind == _COMPRESSED:
        try:
            head = zlib.decompressobj().decompress(head, _HEAD_BYTES)
        except zlib.error as error:
            raise StructureError(path, f"element at byte {offset}", str(error), "zlib data") from error
        kind = int.from_bytes(head[:4], "little")
        matrix = _parse_matrix(head[8:], path, offset) if kind == _MATRIX else None
        return None if matrix is None else _moved(matrix)
    return _parse_matrix(head, path, offset) if kind == _MATRIX else None


def _moved(matrix: _Matrix) -> _Matrix:
    # A negative place of the values marks an array that must be inflated first (its own tag is 8 bytes).
    return _Matrix(matrix.name, matrix.dtype, matrix.stored, matrix.shape, -(matrix.values + 8), matrix.size)


def _parse_matrix(head: bytes, path: str, offset: int) -> _Matrix | None:
    parts, at = [], 0
    for _ in range(3):
        body, at = _element(head, at)
        parts.append(body)
    flags, dims, name = parts
    if len(flags) < 8 or flags[0] not in _CLASSES or flags[1] & 0x08 or len(dims) % 4 or at + 8 > len(head):
        return None
    shape = tuple(int(number) for number in np.frombuffer(dims, "<i4"))
    kind, small = int.from_bytes(head[at : at + 4], "little"), int.from_bytes(head[at + 2 : at + 4], "little")
    if small:
        return None
    if kind not in _STORED:
        raise UnsupportedError(path, f"element at byte {offset}", f"values of kind {kind}", "numbers")
    size = int.from_bytes(head[at + 4 : at + 8], "little")
    stored, dtype = np.dtype("<" + _STORED[kind]), np.dtype("<" + _CLASSES[flags[0]])
    return _Matrix(name.decode("latin-1"), dtype, stored, shape, at + 8, size)


def _element(head: bytes, at: int) -> tuple[bytes, int]:
    word = int.from_bytes(head[at : at + 4], "little")
    if word >> 16:
        return head[at + 4 : at + 4 + min(4, word >> 16)], at + 8
    length = int.from_bytes(head[at + 4 : at + 8], "little")
    return head[at + 8 : at + 8 + length], at + 8 + length + -length % 8


def _checked(matrix: _Matrix, kind: int, length: int, path: str) -> _Matrix:
    shape = matrix.shape
    if len(shape) != _DIMS or shape[4] not in (3, 4) or min(shape) < 1:
        raise UnsupportedError(path, "LF", f"shape {shape}"[:80], "(views, views, rows, columns, 3 or 4)")
    count = math.prod(shape)
    if count > _MAX_ELEMENTS:
        raise LimitError(path, "LF", f"{count} values", f"at most {_MAX_ELEMENTS}")
    if matrix.size != count * matrix.stored.itemsize:
        raise StructureError(path, "LF", f"{matrix.size} bytes", f"{count * matrix.stored.itemsize} bytes by its shape")
    if kind == _MATRIX and matrix.values + matrix.size > length:
        raise MetadataError(path, "LF", f"{matrix.size} bytes in {length}", "values inside the element")
    # zlib cannot pack more than about 1030 to 1.
    if kind == _COMPRESSED and matrix.size > 1100 * length:
        raise LimitError(path, "LF", f"{matrix.size} bytes from {length}", "what zlib can pack")
    return matrix


def _inflated_size(matrix: _Matrix) -> int:
    return -matrix.values + matrix.size


def _inflate(data: bytes, size: int, path: str) -> bytes:
    """The first `size` bytes; the rest of the element is inflated as far as its checksum, if it is padding."""
    stream = zlib.decompressobj()
    try:
        whole = stream.decompress(data, size)
        rest = stream.decompress(stream.unconsumed_tail, _MAX_REST) if not stream.eof else b""
    except zlib.error as error:
        raise ChecksumError(path, "LF", str(error), "zlib data that fit their checksum") from error
    if len(whole) < size:
        raise TruncatedError(path, "LF", f"{len(whole)} bytes after inflation", f"{size} bytes")
    if not stream.eof:
        found = f"{len(rest)} bytes and more behind the values"
        raise StructureError(path, "LF", found, "the end of the element, with its checksum")
    return whole
