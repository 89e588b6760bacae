"""PNG pictures of 8 and 16 bits: every chunk's checksum is looked at, and the size, before anything is decoded."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lfflow.formats.errors import (
    ChecksumError,
    LimitError,
    StructureError,
    TruncatedError,
    UnknownFormatError,
    UnsupportedError,
)
from lfflow.formats.layout import MAX_SAMPLES
from lfflow.formats.region import open_binary
from lfflow.formats.writing import written_whole

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END = b"\0\0\0\0IEND\xaeB`\x82"
_HEAD = struct.Struct(">4s4sIIBBBBB")

Picture = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


class PngHeader(NamedTuple):
    """Size and kind of a PNG."""

    height: int
    width: int
    bits: int
    color_type: int


def png_header(path: str | os.PathLike[str]) -> PngHeader:
    """What the first bytes of a PNG say.

    Raises
    ------
    FileFormatError
        If it is none, or larger than any picture.
    """
    name = os.fspath(path)
    with open_binary(name) as file:
        return _header(file.read(33), name)


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
        data = file.read()
    header = _header(data, name)
    for _ in _chunks(data, name):
        pass
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if picture is None or picture.shape != (header.height, header.width, 3):
        raise StructureError(name, "picture data", "what cannot be decoded", "a PNG picture")
    rgb = np.ascontiguousarray(picture[..., ::-1])
    return rgb.view(np.uint16) if rgb.dtype == np.uint16 else rgb.view(np.uint8)


def png_text(path: str | os.PathLike[str]) -> dict[str, str]:
    """Texts (tEXt chunks) of a PNG by keyword; parameters and errors as in `read_png`."""
    name = os.fspath(path)
    with open_binary(name) as file:
        data = file.read()
    _header(data, name)
    texts = [body.partition(b"\0") for kind, body in _chunks(data, name) if kind == b"tEXt"]
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
    body = data[: -len(_END)]
    with written_whole(Path(path)) as file:
        file.write(body)
        for key, value in (text or {}).items():
            chunk = b"tEXt" + key.encode("latin-1") + b"\0" + value.encode("latin-1")
            file.write(struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)))
        file.write(_END)


def _header(data: bytes, path: str) -> PngHeader:
    if data[:8] != SIGNATURE:
        raise UnknownFormatError(path, "header", f"bytes {data[:8].hex(' ')}" if data else "an empty file", "a PNG")
    if len(data) < 33:
        raise TruncatedError(path, "header", f"{len(data)} bytes", "33 bytes")
    _, kind, width, height, bits, color_type, _, _, _ = _HEAD.unpack(data[8:29])
    if kind != b"IHDR":
        raise StructureError(path, "header", f"chunk {kind!r}", "chunk IHDR")
    if not (width > 0 and height > 0 and width * height <= MAX_SAMPLES):
        raise LimitError(path, "size", f"{width} × {height}", f"1 … {MAX_SAMPLES} pixels")
    if bits not in (1, 2, 4, 8, 16):
        raise UnsupportedError(path, "bit depth", str(bits), "1, 2, 4, 8 or 16")
    return PngHeader(height, width, bits, color_type)


def _chunks(data: bytes, path: str) -> Iterator[tuple[bytes, bytes]]:
    at = len(SIGNATURE)
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        kind, end = data[at + 4 : at + 8], at + 12 + length
        where = f"chunk {kind!r} at byte {at}"
        if end > len(data):
            raise TruncatedError(path, where, f"{max(0, len(data) - at)} bytes", f"{12 + length} bytes")
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise ChecksumError(path, where, "a wrong CRC-32", "the CRC-32 of the chunk")
        if kind == b"IEND":
            return
        yield kind, data[at + 8 : end - 4]
        at = end
    raise TruncatedError(path, "end", "no IEND chunk", "a whole PNG")
