"""PNG pictures of 8 and 16 bits: every chunk's checksum is looked at, and the size, before anything is decoded."""

from __future__ import annotations

import itertools
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from lfflow.formats.errors import (
    ChecksumError,
    LimitError,
    StructureError,
    TruncatedError,
    UnsupportedError,
)
from lfflow.formats.foreign import foreign
from lfflow.formats.layout import MAX_SAMPLES
from lfflow.formats.region import open_binary
from lfflow.formats.writing import written_whole

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 33
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_PALETTE = 3
_ADAM7 = ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1))
_LAST_FILTER = 4
_CRITICAL = (b"IHDR", b"PLTE", b"IDAT")
_MAX_EXTRA = 64 << 20
_MAX_CHUNKS = 1 << 17
_HEAD = struct.Struct(">4s4sIIBBBBB")

Picture = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


class PngHeader(NamedTuple):
    """Size and kind of a PNG."""

    height: int
    width: int
    bits: int
    color_type: int
    interlaced: bool


def png_header(path: str | os.PathLike[str]) -> PngHeader:
    """What the first bytes of a PNG say.

    Raises
    ------
    FileFormatError
        If it is none, or larger than any picture.
    """
    name = os.fspath(path)
    with open_binary(name) as file:
        return _header(file.read(_HEADER_BYTES), name)


def read_png(path: str | os.PathLike[str]) -> Picture:
    """Samples of a PNG: uint8 or uint16, shape (rows, columns, 3), RGB; grey is repeated, alpha left out.

    Raises
    ------
    FileFormatError
        If it is no PNG, cut, or differs from its checksums.
    """
    import cv2

    name = os.fspath(path)
    with open_binary(name) as file:
        header = _header(file.read(_HEADER_BYTES), name)
        _check_size(os.fstat(file.fileno()).st_size, header, name)
        chunks = [(kind, body) for kind, body in _chunks(file, name) if kind in _CRITICAL]
    data = _checked_data(chunks, header, name)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if picture is None or picture.shape != (header.height, header.width, 3):
        raise StructureError(name, "picture data", "what cannot be decoded", "a PNG picture")
    rgb = np.ascontiguousarray(picture[..., ::-1])
    return rgb.view(np.uint16) if rgb.dtype == np.uint16 else rgb.view(np.uint8)


def check_png(path: str | os.PathLike[str]) -> PngHeader:
    """Header of a PNG after all its checksums were looked at; nothing is decoded. Errors as in `read_png`."""
    name = os.fspath(path)
    with open_binary(name) as file:
        header = _header(file.read(_HEADER_BYTES), name)
        _check_size(os.fstat(file.fileno()).st_size, header, name)
        for _ in _chunks(file, name):
            pass
    return header


def png_text(path: str | os.PathLike[str]) -> dict[str, str]:
    """Texts (tEXt chunks) before the picture data of a PNG, by keyword; no picture data are read.

    Raises
    ------
    FileFormatError
        If it is no PNG, cut, or its texts differ from their checksums.
    """
    name = os.fspath(path)
    with open_binary(name) as file:
        _header(file.read(_HEADER_BYTES), name)
        ahead = itertools.takewhile(lambda chunk: chunk[0] != b"IDAT", _chunks(file, name, only=b"tEXt"))
        texts = [body.partition(b"\0") for kind, body in ahead if kind == b"tEXt"]
    return {key.decode("latin-1"): value.decode("latin-1") for key, _, value in texts}


def write_png(path: str | os.PathLike[str], picture: Picture, text: Mapping[str, str] | None = None) -> None:
    """Write uint8 or uint16 samples, shape (rows, columns) or (rows, columns, 3) RGB, with texts by keyword.

    Raises
    ------
    ValueError
        If the samples are of another kind.
    """
    import cv2

    if picture.dtype not in (np.uint8, np.uint16) or picture.ndim not in (2, 3) or not picture.size:
        raise ValueError(f"a PNG holds uint8 or uint16 (rows, columns[, 3]), not {picture.dtype} {picture.shape}")
    if picture.ndim == 3 and picture.shape[2] != 3:
        raise ValueError(f"a colour PNG has 3 channels, not {picture.shape[2]}")
    bgr = picture if picture.ndim == 2 else picture[..., ::-1]
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(bgr))
    if not done:
        raise ValueError(f"samples of shape {picture.shape} cannot be encoded")
    data = encoded.tobytes()
    with written_whole(Path(path)) as file:
        file.write(data[:_HEADER_BYTES])
        for key, value in (text or {}).items():
            file.write(_chunk(b"tEXt", key.encode("latin-1") + b"\0" + value.encode("latin-1")))
        file.write(data[_HEADER_BYTES:])


def _header(data: bytes, path: str) -> PngHeader:
    if data[:8] != SIGNATURE:
        raise foreign(path, data, "a PNG")
    if len(data) < _HEADER_BYTES:
        raise TruncatedError(path, "header", f"{len(data)} bytes", f"{_HEADER_BYTES} bytes")
    _, kind, width, height, bits, color_type, *methods = _HEAD.unpack(data[8:29])
    if kind != b"IHDR":
        raise StructureError(path, "header", f"chunk {kind!r}", "chunk IHDR")
    if not (width > 0 and height > 0 and width * height <= MAX_SAMPLES):
        raise LimitError(path, "size", f"{width} × {height}", f"1 … {MAX_SAMPLES} pixels")
    if bits not in _DEPTHS.get(color_type, ()):
        raise UnsupportedError(path, "header", f"{bits} bits of colour type {color_type}", "a kind of PNG that exists")
    if methods[:2] != [0, 0] or methods[2] > 1:
        found = f"compression, filter, interlace {methods}"
        raise UnsupportedError(path, "header", found, "compression 0, filter 0, interlace 0 or 1")
    return PngHeader(height, width, bits, color_type, bool(methods[2]))


def _unpacked(header: PngHeader) -> int:
    """Bytes of the picture before it was deflated: each row with the byte that names its filter."""
    passes = _ADAM7 if header.interlaced else ((0, 0, 1, 1),)
    total = 0
    for row, column, down, across in passes:
        height, width = -(-(header.height - row) // down), -(-(header.width - column) // across)
        if width > 0:
            total += max(height, 0) * (1 + -(-width * header.bits * _CHANNELS[header.color_type] // 8))
    return total


def _checked_data(chunks: list[tuple[bytes, bytes]], header: PngHeader, path: str) -> bytes:
    """A PNG of the chunks that the picture needs, after its stream was seen to be whole: decoders say less clearly."""
    if [kind for kind, _ in chunks].count(b"IHDR") != 1:
        raise StructureError(path, "chunks", "more than one IHDR", "one")
    palette = [body for kind, body in chunks if kind == b"PLTE"]
    if (header.color_type == _PALETTE) != (len(palette) == 1) and header.color_type in (0, _PALETTE, 4):
        raise StructureError(path, "chunks", f"{len(palette)} palettes (PLTE)", "what the colour type needs")
    packed = b"".join(body for kind, body in chunks if kind == b"IDAT")
    expected, stream = _unpacked(header), zlib.decompressobj()
    try:
        rows = stream.decompress(packed, expected + 1)
    except zlib.error as error:
        raise ChecksumError(path, "picture data", str(error), "a zlib stream that fits its checksum") from error
    if len(rows) != expected or not stream.eof:
        found = f"{len(rows)} bytes" + ("" if stream.eof else " and more")
        raise StructureError(path, "picture data", found, f"{expected} bytes by the header")
    if not header.interlaced and max(rows[:: expected // header.height]) > _LAST_FILTER:
        raise StructureError(path, "picture data", "an unknown row filter", f"0 … {_LAST_FILTER}")
    packed = packed[: len(packed) - len(stream.unused_data)]
    kept = [chunk for chunk in chunks if chunk[0] == b"IHDR"]
    kept += [(b"PLTE", body) for body in palette if header.color_type == _PALETTE]
    return SIGNATURE + b"".join(_chunk(*chunk) for chunk in (*kept, (b"IDAT", packed), (b"IEND", b"")))


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(body, zlib.crc32(kind)))


def _check_size(size: int, header: PngHeader, path: str) -> None:
    """Refuse what no picture of that size needs, and what deflate cannot have packed (about 1030 to 1)."""
    unpacked = _unpacked(header)
    if size > 2 * unpacked + _MAX_EXTRA:
        raise LimitError(path, "file", f"{size} bytes", f"at most {2 * unpacked + _MAX_EXTRA} for its size")
    if unpacked > 1100 * size:
        raise LimitError(path, "size", f"{header.width} × {header.height} from {size} bytes", "what deflate can pack")


def _chunks(file: BinaryIO, path: str, *, only: bytes | None = None) -> Iterator[tuple[bytes, bytes]]:
    """Kind and body of every chunk, checked; with `only`, other kinds are passed over with an empty body."""
    size = os.fstat(file.fileno()).st_size
    at = len(SIGNATURE)
    for _ in range(_MAX_CHUNKS):
        if at == size:
            raise TruncatedError(path, "end", "no IEND chunk", "a whole PNG")
        file.seek(at)
        head = file.read(8)
        length, kind, end = int.from_bytes(head[:4], "big"), head[4:], at + 12 + int.from_bytes(head[:4], "big")
        where = f"chunk {kind!r} at byte {at}"
        if end > size:
            raise TruncatedError(path, where, f"{size - at} bytes", f"{12 + length} bytes")
        body = b""
        if only in (None, kind):
            body, crc = file.read(length), file.read(4)
            if zlib.crc32(body, zlib.crc32(kind)) != int.from_bytes(crc, "big"):
                raise ChecksumError(path, where, "a wrong CRC-32", "the CRC-32 of the chunk")
        if kind == b"IEND":
            return
        yield kind, body
        at = end
    raise LimitError(path, "chunks", f"more than {_MAX_CHUNKS}", "a picture")
