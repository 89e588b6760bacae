r"""Calibration archives: the F01's ``data.C.0`` … ``data.C.3`` and the Illum's ``caldata-*.tar``.

Both hold the camera's white and dark images as ``MOD_NNNN.RAW``, each with its JSON in ``MOD_NNNN.TXT``. Nothing is
extracted: a member is a run of bytes of the archive, read from there, and its name (``C:\T1CALIB\MOD_0000.RAW``,
``../../x``) is only ever compared, never used as a path. A member is addressed as ``data.C.0::MOD_0000.RAW``.

Members of a storage container stand under their SHA-1. A tar has checksums of its headers only: of damage to its
pixels the archive itself knows nothing.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from lfflow.formats.bounded_json import at
from lfflow.formats.container import Container, chunk_id, is_container, open_container, write_container
from lfflow.formats.errors import FileFormatError, StructureError, UnknownFormatError
from lfflow.formats.frame import Frame
from lfflow.formats.lfp import damage
from lfflow.formats.raw_pair import paired_frame
from lfflow.formats.region import Region, open_binary
from lfflow.formats.tar import is_tar, tar_members

SEPARATOR = "::"
_DOCUMENTS = (".txt", ".json")


class Member(NamedTuple):
    """A file in an archive: its full name there, and its bytes."""

    name: str
    region: Region

    @property
    def base(self) -> str:
        """Name without folders of either kind of slash."""
        return re.split(r"[\\/]", self.name)[-1]


@dataclass(frozen=True, slots=True)
class ArchiveEntry:
    """A white or dark image in an archive.

    Parameters
    ----------
    path
        ``archive::member``, which engine "lfp" opens.
    name
        Name of the member without folders.
    kind, serial, zoom, focus
        "white", "dark" or "scene", serial number of the camera, positions of the motors (NaN when unknown).
    frame
        The frame, not read yet.
    error
        Why the member cannot be read; then there is no frame.
    """

    path: str
    name: str
    kind: str = ""
    serial: str = ""
    zoom: float = float("nan")
    focus: float = float("nan")
    frame: Frame | None = None
    error: FileFormatError | None = None

    def open(self) -> xr.Dataset:
        """Lazy raw dataset of the image."""
        if self.frame is None:
            raise self.error or StructureError(self.path, self.name, "no frame", "a sensor frame")
        return self.frame.dataset()


def is_storage(container: Container) -> bool:
    """Whether a container stores named files."""
    return isinstance(container.toc.value.get("files"), list)


def archive_members(path: str | os.PathLike[str]) -> list[Member]:
    """All files in an archive, in its order.

    Raises
    ------
    FileFormatError
        If the archive is none, or broken.
    """
    name = os.path.abspath(path)  # noqa: PTH100
    with open_binary(name) as file:
        head = file.read(512)
    if is_container(head):
        return storage_members(open_container(name))
    if is_tar(head):
        return [Member(member.name, member.region) for member in tar_members(name)]
    raise UnknownFormatError(name, "header", f"bytes {head[:8].hex(' ')}", "a storage container or a tar")


def storage_members(container: Container) -> list[Member]:
    """The named files of a storage container."""
    listed = container.toc.value.get("files")
    if not isinstance(listed, list):
        raise StructureError(container.path, "table of contents", "no list of files", "a storage container")
    members = []
    for number, item in enumerate(listed):
        where = f"files[{number}]"
        name = at(item, "name")
        if not isinstance(name, str):
            raise StructureError(container.path, where, f"name {name!r:.40}", "a file name")
        region = container.chunk(at(item, "dataRef"), f"{where}.dataRef")
        shown = f"{name} ({region.name})"
        members.append(Member(name, Region(region.path, shown, region.offset, region.length, region.sha1)))
    return members


def archive_entries(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> Iterator[ArchiveEntry]:
    """Every image in an archive; a broken one is listed with its error and stops nothing.

    Parameters
    ----------
    path
        ``data.C.N`` or ``caldata-*.tar``.
    accept_damaged
        List also an image that differs from its SHA-1; its frame then says so in `damaged`.

    Raises
    ------
    FileFormatError
        If the archive as a whole cannot be read.
    """
    archive = os.path.abspath(path)  # noqa: PTH100
    members = archive_members(archive)
    documents = _documents(members)
    for member in members:
        if member.base.lower().endswith(".raw"):
            yield _entry(archive, member, documents, accept_damaged)


def archive_frame(address: str, *, accept_damaged: bool = False) -> Frame:
    """Frame of one member, addressed as ``archive::member`` (its name without folders, in any case).

    Raises
    ------
    FileFormatError
        If there is no such member, or it is broken.
    """
    archive, _, wanted = address.rpartition(SEPARATOR)
    members = archive_members(archive)
    found = [member for member in members if wanted.lower() in (member.base.lower(), member.name.lower())]
    if len(found) != 1:
        raise StructureError(archive, "members", f"{len(found)} members {wanted!r}", "one")
    return _frame(os.path.abspath(archive), found[0], _documents(members), accept_damaged)  # noqa: PTH100


def write_storage(path: str | os.PathLike[str], files: Mapping[str, bytes]) -> None:
    r"""Write a storage container as the F01's backup is: full names (``C:\T1CALIB\MOD_0000.RAW``) to contents."""
    listed = [{"name": name, "dataRef": chunk_id(data)} for name, data in files.items()]
    write_container(path, {"files": listed, "nextFile": len(listed)}, list(files.values()))


def _documents(members: list[Member]) -> dict[str, Member]:
    return {Path(member.base.lower()).stem: member for member in members if member.base.lower().endswith(_DOCUMENTS)}


def _entry(archive: str, member: Member, documents: dict[str, Member], accept_damaged: bool) -> ArchiveEntry:
    address = f"{archive}{SEPARATOR}{member.base}"
    try:
        frame = _frame(archive, member, documents, accept_damaged)
    except FileFormatError as error:
        return ArchiveEntry(address, member.base, error=error)
    coords: dict[str, Any] = {name: value for name, (_, value) in frame.metadata.coords.items()}
    zoom, focus = float(coords["zoom_step"]), float(coords["focus_step"])
    return ArchiveEntry(address, member.base, coords["kind"], coords["camera_serial"], zoom, focus, frame)


def _frame(archive: str, member: Member, documents: dict[str, Member], accept_damaged: bool) -> Frame:
    stem = Path(member.base).stem
    document = documents.get(stem.lower())
    if document is None:
        raise StructureError(archive, member.name, "no metadata beside it", f"{stem}.TXT")
    region = member.region
    damaged = damage(region) if accept_damaged else ()
    text = document.region.unchecked() if accept_damaged else document.region
    return paired_frame(stem, region.unchecked() if damaged else region, text, damaged)
