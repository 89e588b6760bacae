"""Portable float maps: "PF" (colour) or "Pf" (grey), size, scale (negative: little-endian), rows from the bottom up."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from lfflow.formats.errors import LimitError, MetadataError, StructureError
from lfflow.formats.foreign import foreign
from lfflow.formats.layout import MAX_SAMPLES
from lfflow.formats.region import open_binary
from lfflow.formats.writing import written_whole

_HEADER = re.compile(rb"(PF|Pf)\s+(\d{1,9})\s+(\d{1,9})\s+([-+]?[0-9.]{1,30}(?:[eE][-+]?\d{1,3})?)[ \t\r]?\n")
_MAX_HEADER = 256


def read_pfm(path: str | os.PathLike[str]) -> npt.NDArray[np.float32]:
    """Values of a float map, as they are in the file (the scale's magnitude is not applied), top row first.

    Returns
    -------
    ndarray of float32
        Shape (rows, columns) for a grey map, (rows, columns, 3) for a colour map.

    Raises
    ------
    FileFormatError
        If it is no float map, or has the wrong length.
    """
    name = os.fspath(path)
    with open_binary(name) as file:
        head = file.read(_MAX_HEADER)
        match = _HEADER.match(head)
        if match is None:
            if head[:2] in (b"PF", b"Pf"):
                raise StructureError(name, "header", repr(head[:24]), "PF or Pf, width, height, scale")
            raise foreign(name, head, "a float map: PF or Pf, width, height, scale")
        kind, width, height, scale = match[1], int(match[2]), int(match[3]), _scale(match[4], name)
        channels = 3 if kind == b"PF" else 1
        if not 0 < width * height <= MAX_SAMPLES:
            raise LimitError(name, "size", f"{width} × {height}", f"1 … {MAX_SAMPLES} pixels")
        expected = 4 * width * height * channels
        found = os.fstat(file.fileno()).st_size - match.end()
        if found != expected:
            raise StructureError(name, "data", f"{found} bytes", f"{expected} bytes ({width} × {height} × {channels})")
        file.seek(match.end())
        data = file.read(expected)
    values = np.frombuffer(data, "<f4" if scale < 0 else ">f4").reshape(height, width, channels)[::-1]
    return np.ascontiguousarray(values if channels == 3 else values[..., 0], np.float32)


def write_pfm(path: str | os.PathLike[str], values: npt.ArrayLike, *, order: Literal["<", ">"] = "<") -> None:
    """Write a float map.

    Parameters
    ----------
    path
        The file to make.
    values
        Shape (rows, columns) or (rows, columns, 3), top row first; written as float32.
    order
        "<" little-endian or ">" big-endian.

    Raises
    ------
    ValueError
        If the shape is another.
    """
    array = np.asarray(values, f"{order}f4")
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3) or not array.size:
        raise ValueError(f"a float map has shape (rows, columns) or (rows, columns, 3), not {array.shape}")
    kind = "Pf" if array.ndim == 2 else "PF"
    with written_whole(Path(path)) as file:
        file.write(f"{kind}\n{array.shape[1]} {array.shape[0]}\n{'-1.0' if order == '<' else '1.0'}\n".encode())
        file.write(array[::-1].tobytes())


def _scale(text: bytes, path: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if value == 0 or not np.isfinite(value):
        raise MetadataError(path, "scale", repr(text), "a number other than 0")
    return value
