"""Coloured point clouds as binary PLY."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt


def write_ply(
    path: str | os.PathLike[str], points: npt.ArrayLike, colours: npt.ArrayLike, *, comment: str = ""
) -> None:
    """Write points (n, 3), any unit, with colours (n, 3) in 0…255; points that are not finite are left out.

    `comment`, one line of ASCII, goes into the header: the place to say the unit.
    """
    places, tints = np.asarray(points, dtype="<f4"), np.asarray(colours, dtype=np.uint8)
    if places.ndim != 2 or places.shape[1:] != (3,) or tints.shape != places.shape:
        raise ValueError(f"points {places.shape} and colours {tints.shape}, expected (n, 3) each")
    kept = np.isfinite(places).all(axis=1)
    vertices = np.empty(int(kept.sum()), dtype=[("place", "<f4", 3), ("tint", "u1", 3)])
    vertices["place"], vertices["tint"] = places[kept], tints[kept]
    header = ["ply", "format binary_little_endian 1.0", *([f"comment {comment}"] if comment else [])]
    header.append(f"element vertex {len(vertices)}")
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {colour}" for colour in ("red", "green", "blue")]
    Path(path).write_bytes("\n".join([*header, "end_header", ""]).encode("ascii") + vertices.tobytes())
