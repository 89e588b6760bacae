"""What a file is, in words and numbers that fit into JSON."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lfflow.formats.archives import archive_entries, archive_members
from lfflow.formats.bounded_json import Json, at
from lfflow.formats.container import Container, Section, is_container, open_container
from lfflow.formats.errors import FileFormatError, MetadataError, UnknownFormatError
from lfflow.formats.eslf import open_eslf
from lfflow.formats.foreign import foreign
from lfflow.formats.frame import Frame
from lfflow.formats.lfp import FRAMES, raw_frame
from lfflow.formats.metadata import MODELS, FrameMetadata
from lfflow.formats.opening import container_kind, is_address, open_frame
from lfflow.formats.pfm import read_pfm
from lfflow.formats.png import SIGNATURE, check_png
from lfflow.formats.raw_pair import document_metadata, is_pair
from lfflow.formats.region import open_binary
from lfflow.formats.renderings import rendering
from lfflow.formats.tar import is_tar
from lfflow.formats.toolbox import is_toolbox, open_toolbox
from lfflow.formats.views import is_view_folder, open_views, view_files

_SHOWN = ("camera_model", "camera_serial", "zoom_step", "focus_step", "time")
_LONG = ("metadata", "sections", "images")
_DOCUMENTS = (".txt", ".json")
NO_CHECKSUM = "none: damaged samples cannot be noticed"


def describe(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> Json:
    """Description of one file, folder of views, or ``archive::member``; all bytes under a SHA-1 or CRC are checked.

    Returns
    -------
    dict
        "path", "kind" and "bytes", and what the kind has of: "sizes", "kind_of_frame", "camera_model", "camera_serial",
        "checksum" (what tells damage), "sections" (kind, name, offset, length, sha1, state), "images" (of an archive),
        "metadata", "damaged".

    Raises
    ------
    FileFormatError
        If it is none of the known kinds, or broken.
    """
    name = os.fspath(path)
    if is_address(name):
        frame = open_frame(name, accept_damaged=accept_damaged)
        frame.region.verify()
        return {"path": name, "kind": "raw picture in an archive", **_of_frame(frame)}
    if Path(name).is_dir():
        return {"path": name, **_of_folder(name)}
    with open_binary(name) as file:
        head = file.read(512)
        size = os.fstat(file.fileno()).st_size
    return {"path": name, "bytes": size, **_by_content(name, head, accept_damaged=accept_damaged)}


def describe_folder(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> Iterator[Json]:
    """One short description of each entry of a folder, by name, one after the other; what cannot be read has "error".

    The .TXT of a .RAW is part of its picture and not listed.
    """
    for entry in sorted(Path(path).iterdir()):
        if entry.suffix.lower() in _DOCUMENTS and is_pair(entry):
            continue
        try:
            described = describe(entry, accept_damaged=accept_damaged)
        except UnknownFormatError as error:
            described = {"path": str(entry), "kind": "unknown", "error": str(error)}
            if entry.is_dir():
                described = {"path": str(entry), "kind": "folder"}
        except FileFormatError as error:
            described = {"path": str(entry), "kind": "broken", "error": str(error)}
        yield {key: value for key, value in described.items() if key not in _LONG}


def _of_folder(name: str) -> Json:
    if not is_view_folder(name):
        raise UnknownFormatError(name, "folder", "no input_CamNNN.png", "a folder of view images")
    for view in view_files(name).values():
        check_png(Path(name) / view)
    ds = open_views(name)
    return {"kind": "folder of views", "sizes": _sizes(ds), "views": int(ds["present"].sum()), "checksum": "CRC-32"}


def _by_content(name: str, head: bytes, *, accept_damaged: bool) -> Json:
    if is_container(head):
        return _of_container(open_container(os.path.abspath(name), accept_damaged=accept_damaged))  # noqa: PTH100
    if is_pair(name):
        return {"kind": "raw picture with its text", **_of_frame(open_frame(name))}
    if is_toolbox(head):
        return {"kind": "LFToolbox light field", "sizes": _sizes(open_toolbox(name)), "checksum": NO_CHECKSUM}
    if head[:8] == SIGNATURE:
        return _of_png(name)
    if head[:2] in (b"PF", b"Pf"):
        sizes = dict(zip(("y", "x", "channel"), read_pfm(name).shape, strict=False))
        return {"kind": "float map", "sizes": sizes, "checksum": NO_CHECKSUM}
    if is_tar(head):
        return {"kind": "calibration archive", **_of_archive(name, accept_damaged), "checksum": NO_CHECKSUM}
    if Path(name).suffix.lower() in _DOCUMENTS:
        return _of_document(name, head)
    raise foreign(name, head, "a format that lfflow knows")


def _of_container(container: Container) -> Json:
    names = _names_of_sections(container)
    sections = [_section(section, names) for section in container.sections]
    wrong = [
        f"section at byte {row['offset']} ({row['name']}): wrong SHA-1" for row in sections if row["state"] == "wrong"
    ]
    told: Json = {"checksum": "SHA-1", "sections": sections, "damaged": [*wrong, *container.damaged]}
    kind = container_kind(container)
    if kind == "storage":
        return {"kind": "calibration archive", **_of_archive(container.path, container.accept_damaged), **told}
    if kind == "rendering":
        ds = rendering(container)
        held = {str(name): _sizes(variable) for name, variable in ds.data_vars.items()}
        return {"kind": "derived picture", "holds": held, "sizes": _sizes(ds), **_of_origin(container), **told}
    frames = max(len(at(container.toc.value, *place[:-1]) or ()) for place in FRAMES)
    more = {"frames": frames} if frames > 1 else {}
    return {"kind": "raw picture", **more, **_of_frame(raw_frame(container)), **told}


def _of_origin(container: Container) -> Json:
    """What a derived picture says of the raw picture that it was made from; often nothing."""
    found = (at(container.toc.value, *place, "frame", "metadata") for place in FRAMES)
    metadata = next((document for document in found if document), None)
    camera = at(metadata, "camera", "model")
    camera = MODELS.get(camera, camera) if isinstance(camera, str) else None
    values = {"camera_model": camera, "time": at(metadata, "devices", "clock", "zuluTime")}
    return {key: value for key, value in values.items() if isinstance(value, str)}


def _names_of_sections(container: Container) -> dict[str, str]:
    """What the table of contents calls each section, by SHA-1: its name, or the last two steps to its reference."""
    names: dict[str, str] = {}
    stack: list[tuple[tuple[str, ...], Any]] = [((), container.toc.value)]
    while stack:
        steps, value = stack.pop()
        if isinstance(value, dict):
            if isinstance(value.get("name"), str) and isinstance(value.get("dataRef"), str):
                names.setdefault(value["dataRef"][5:].lower(), value["name"][:80])
            stack += [((*steps, key), item) for key, item in reversed(value.items())]
        elif isinstance(value, list):
            stack += [((*steps[:-1], f"{steps[-1]}[{n}]"), item) for n, item in reversed(list(enumerate(value)))]
        elif isinstance(value, str) and value.startswith("sha1-"):
            names.setdefault(value[5:].lower(), ".".join(steps[-2:])[:80])
    return names


def _section(section: Section, names: dict[str, str]) -> Json:
    region = section.region
    state = "empty" if region.sha1 is None else "right" if region.digest() == region.sha1 else "wrong"
    name = "table of contents" if section.kind == "toc" else names.get(region.sha1 or "", "")
    return {
        "kind": section.kind, "name": name, "offset": section.offset, "length": region.length, "sha1": region.sha1,
        "state": state,
    }  # fmt: skip


def _of_frame(frame: Frame) -> Json:
    checksum = "SHA-1" if frame.region.sha1 else NO_CHECKSUM
    return {**_of_metadata(frame.metadata), "checksum": checksum, "damaged": list(frame.damaged)}


def _of_metadata(metadata: FrameMetadata) -> Json:
    layout = metadata.layout
    values = {name: plain(value) for name, (_, value) in metadata.coords.items()}
    return {
        "kind_of_frame": metadata.kind,
        "sizes": {"y": layout.height, "x": layout.width},
        "bits": layout.packing.bits,
        "byte_order": layout.packing.endianness,
        **{name: values[name] for name in _SHOWN},
        "metadata": values,
    }


def _of_document(name: str, head: bytes) -> Json:
    try:
        return {"kind": "metadata without its picture", **_of_metadata(document_metadata(name))}
    except MetadataError as error:
        if error.where in ("metadata", "image.height", "image.width"):
            raise foreign(name, head, "a format that lfflow knows") from error
        raise


def _of_archive(path: str, accept_damaged: bool) -> Json:
    images = [
        {
            "name": entry.name, "kind": entry.kind, "camera_serial": entry.serial, "zoom_step": plain(entry.zoom),
            "focus_step": plain(entry.focus), "error": str(entry.error) if entry.error else None,
        }
        for entry in archive_entries(path, accept_damaged=accept_damaged)
    ]  # fmt: skip
    counted = Counter(image["kind"] or "unreadable" for image in images)
    serials = sorted({image["camera_serial"] for image in images} - {""})
    return {
        "files": len(archive_members(path)), "holds": dict(counted), "camera_serial": ", ".join(serials),
        "images": images,
    }  # fmt: skip


def _of_png(name: str) -> Json:
    header = check_png(name)
    told: Json = {"bits": header.bits, "checksum": "CRC-32"}
    if name.lower().endswith("eslf.png"):
        return {"kind": "lenslet picture", "sizes": _sizes(open_eslf(name)), **told}
    return {"kind": "picture", "sizes": {"y": header.height, "x": header.width}, **told}


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
