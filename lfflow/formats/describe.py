"""What a file is, in words and numbers that fit into JSON."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from lfflow.formats.archives import archive_entries, archive_members
from lfflow.formats.bounded_json import Json
from lfflow.formats.container import Container, Section, is_container, open_container
from lfflow.formats.errors import FileFormatError, UnknownFormatError
from lfflow.formats.eslf import open_eslf
from lfflow.formats.frame import Frame
from lfflow.formats.lfp import raw_frame
from lfflow.formats.opening import container_kind, is_address, open_frame
from lfflow.formats.pfm import read_pfm
from lfflow.formats.png import SIGNATURE, png_header
from lfflow.formats.raw_pair import is_pair
from lfflow.formats.region import open_binary
from lfflow.formats.renderings import rendering
from lfflow.formats.tar import is_tar
from lfflow.formats.toolbox import is_toolbox, open_toolbox
from lfflow.formats.views import is_view_folder, open_views

_SHOWN = ("camera_model", "camera_serial", "zoom_step", "focus_step", "time")


def describe(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> Json:
    """Description of one file, folder of views, or ``archive::member``; all bytes under a SHA-1 are hashed.

    Returns
    -------
    dict
        "path", "kind" and "bytes", and what the kind has of: "sizes", "kind_of_frame", "camera_model", "camera_serial",
        "sections" (kind, offset, length, sha1, state), "images" (of an archive), "metadata", "damaged".

    Raises
    ------
    FileFormatError
        If it is none of the known kinds, or broken.
    """
    name = os.fspath(path)
    if is_address(name):
        return {"path": name, "kind": "raw picture in an archive", **_of_frame(open_frame(name))}
    if Path(name).is_dir():
        if not is_view_folder(name):
            raise UnknownFormatError(name, "folder", "no input_CamNNN.png", "a folder of view images")
        ds = open_views(name)
        return {"path": name, "kind": "folder of views", "sizes": _sizes(ds), "views": int(ds["present"].sum())}
    with open_binary(name) as file:
        head = file.read(512)
        size = os.fstat(file.fileno()).st_size
    return {"path": name, "bytes": size, **_by_content(name, head, accept_damaged=accept_damaged)}


def describe_folder(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> list[Json]:
    """One short description of each file in a folder, sorted by name; what cannot be read has "error".

    The .TXT of a .RAW is part of its picture and not listed.
    """
    rows: list[Json] = []
    for entry in sorted(Path(path).iterdir()):
        if entry.suffix.lower() in (".txt", ".json") and is_pair(entry):
            continue
        if entry.is_dir() and not is_view_folder(entry):
            continue
        try:
            described = describe(entry, accept_damaged=accept_damaged)
        except FileFormatError as error:
            described = {"path": str(entry), "kind": "unknown", "error": str(error)}
            if not isinstance(error, UnknownFormatError):
                described["kind"] = "broken"
        rows.append({key: value for key, value in described.items() if key not in ("metadata", "sections", "images")})
    return rows


def _by_content(name: str, head: bytes, *, accept_damaged: bool) -> Json:
    if is_container(head):
        return _of_container(open_container(os.path.abspath(name), accept_damaged=accept_damaged))  # noqa: PTH100
    if is_pair(name):
        return {"kind": "raw picture with its text", **_of_frame(open_frame(name))}
    if is_toolbox(head):
        return {"kind": "LFToolbox light field", "sizes": _sizes(open_toolbox(name))}
    if head[:8] == SIGNATURE:
        return _of_png(name)
    if head[:2] in (b"PF", b"Pf"):
        shape = read_pfm(name).shape
        return {"kind": "float map", "sizes": dict(zip(("y", "x", "channel"), shape, strict=False))}
    if is_tar(head):
        return {"kind": "calibration archive", **_of_archive(name)}
    found = f"bytes {head[:8].hex(' ')}" if head else "an empty file"
    raise UnknownFormatError(name, "header", found, "a format that lfflow knows")


def _of_container(container: Container) -> Json:
    sections = [_section(section) for section in container.sections]
    wrong = [f"section at byte {row['offset']}: wrong SHA-1" for row in sections if row["state"] == "wrong"]
    told: Json = {"sections": sections, "damaged": wrong}
    kind = container_kind(container)
    if kind == "storage":
        return {"kind": "calibration archive", **_of_archive(container.path), **told}
    if kind == "rendering":
        ds = rendering(container)
        return {"kind": "derived picture", "holds": list(map(str, ds.data_vars)), "sizes": _sizes(ds), **told}
    return {"kind": "raw picture", **_of_frame(raw_frame(container)), **told}


def _section(section: Section) -> Json:
    region = section.region
    state = "empty" if region.sha1 is None else "right" if region.digest() == region.sha1 else "wrong"
    return {
        "kind": section.kind, "offset": section.offset, "length": region.length, "sha1": region.sha1, "state": state,
    }  # fmt: skip


def _of_frame(frame: Frame) -> Json:
    layout, coords = frame.metadata.layout, frame.metadata.coords
    values = {name: plain(value) for name, (_, value) in coords.items()}
    return {
        "kind_of_frame": frame.metadata.kind,
        "sizes": {"y": layout.height, "x": layout.width},
        "bits": layout.packing.bits,
        "byte_order": layout.packing.endianness,
        **{name: values[name] for name in _SHOWN},
        "metadata": values,
        "damaged": list(frame.damaged),
    }


def _of_archive(path: str) -> Json:
    images = [
        {
            "name": entry.name, "kind": entry.kind, "camera_serial": entry.serial, "zoom_step": plain(entry.zoom),
            "focus_step": plain(entry.focus), "error": str(entry.error) if entry.error else None,
        }
        for entry in archive_entries(path)
    ]  # fmt: skip
    return {"files": len(archive_members(path)), "images": images}


def _of_png(name: str) -> Json:
    header = png_header(name)
    if name.lower().endswith("eslf.png"):
        return {"kind": "lenslet picture", "bits": header.bits, "sizes": _sizes(open_eslf(name))}
    return {"kind": "picture", "bits": header.bits, "sizes": {"y": header.height, "x": header.width}}


def _sizes(ds: Any) -> dict[str, int]:
    return {str(name): int(size) for name, size in ds.sizes.items()}


def plain(value: Any) -> Any:
    """Value as JSON knows it: NaN and NaT as null, arrays as lists, times as text."""
    if isinstance(value, np.ndarray):
        return [plain(item) for item in value]
    if isinstance(value, np.datetime64):
        return None if np.isnat(value) else str(value)
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and math.isnan(value) else value
