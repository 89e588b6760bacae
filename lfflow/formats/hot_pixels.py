"""The list of hot pixels that an Illum keeps in its pictures.

Little-endian: a uint32 count, then the columns, then the rows, each int16.
"""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt

from lfflow.formats.errors import StructureError

_COUNT = struct.Struct("<I")


def pack_hot_pixels(x: npt.ArrayLike, y: npt.ArrayLike) -> bytes:
    """Bytes of the list of hot pixels in columns `x` and rows `y` (n,).

    Raises
    ------
    ValueError
        If there are not as many rows as columns.
    """
    columns, rows = np.asarray(x, "<i2"), np.asarray(y, "<i2")
    if columns.shape != rows.shape or columns.ndim != 1:
        raise ValueError(f"columns {columns.shape} and rows {rows.shape}, expected (n,) each")
    return _COUNT.pack(columns.size) + columns.tobytes() + rows.tobytes()


def unpack_hot_pixels(data: bytes, path: str) -> npt.NDArray[np.int64]:
    """Columns and rows, shape (2, n).

    Raises
    ------
    StructureError
        If the length is not that of the count.
    """
    count = _COUNT.unpack_from(data)[0] if len(data) >= _COUNT.size else -1
    if len(data) != _COUNT.size + 4 * count:
        raise StructureError(path, "hot pixels", f"{len(data)} bytes for {count} pixels", "4 + 4 · count")
    return np.frombuffer(data, "<i2", offset=_COUNT.size).reshape(2, count).astype(np.int64)
