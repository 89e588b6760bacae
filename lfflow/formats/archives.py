r"""Calibration archives: the F01's ``data.C.0`` … ``data.C.3`` and the Illum's ``caldata-*.tar``.

Both hold the camera's white and dark images as ``MOD_NNNN.RAW``, each with its JSON in ``MOD_NNNN.TXT``. Nothing is
extracted: a member is a run of bytes of the archive, read from there, and its name (``C:\T1CALIB\MOD_0000.RAW``,
``../../x``) is only ever compared, never used as a path. A member is addressed as ``data.C.0::MOD_0000.RAW``.

Members of a storage container stand under their SHA-1. A tar has checksums of its headers only: of damage to its
pixels the archive itself knows nothing.

To use an archive as a source of pictures: `is_archive` says whether a file is one (headers only), `archive_entries`
lists its images one by one (headers and JSON only; a broken image is an entry with its error), `open_entry` opens one
by archive and name, and ``ArchiveEntry.path`` is the address under which engine "lfp" opens it in any process.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from lfflow.formats.bounded_json import at
from lfflow.formats.container import Container, chunk_id, is_container, open_container, write_container
from lfflow.formats.errors import FileFormatError, LimitError, StructureError
from lfflow.formats.foreign import foreign
from lfflow.formats.frame import Frame
from lfflow.formats.lfp import damage
from lfflow.formats.raw_pair import paired_frame
from lfflow.formats.region import Region, open_binary
from lfflow.formats.tar import is_tar, tar_members

SEPARATOR = "::"
_DOCUMENTS = (".txt", ".json")
_MAX_SIBLINGS = 16
_MAX_REPETITION = 8


class Member(NamedTuple):
    """A file in an archive: its full name there, and its bytes."""

    name: str
    region: Region

    @property
    def base(self) -> str:
        """Name without folders of either kind of slash."""
        return re.split(r"[\\/]", self.name)[-1]

    @property
    def is_image(self) -> bool:
        """Whether it is a sensor frame by its name."""
        return self.base.lower().endswith(".raw")

    @property
    def pair(self) -> tuple[str, str]:
        """What a .RAW and its .TXT have in common: folder and stem, in lower case."""
        folder = self.name[: len(self.name) - len(self.base)]
        return folder.lower(), Path(self.base).stem.lower()


@dataclass(frozen=True, slots=True)
class ArchiveEntry:
    """A white or dark image in an archive.

    Parameters
    ----------
    path
        ``archive::member``, which engine "lfp" opens.
    name
        Name of the member: without folders where that names it alone.
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


def is_archive(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a calibration archive, by its first bytes and (of a container) its table of contents."""
    name = os.path.abspath(path)  # noqa: PTH100
    try:
        with open_binary(name) as file:
            head = file.read(512)
        return is_storage(open_container(name)) if is_container(head) else is_tar(head)
    except FileFormatError:
        return False


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
    raise foreign(name, head, "a storage container or a tar")


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
        shown = f"{name:.80} ({region.name})"
        members.append(Member(name, Region(region.path, shown, region.offset, region.length, region.sha1)))
    # One section may stand under several names, but not so often that listing them is work without end.
    stored = sum(section.region.length for section in container.sections)
    named = sum(member.region.length for member in members)
    if named > _MAX_REPETITION * stored:
        raise LimitError(container.path, "files", f"{named} bytes in {stored}", f"at most {_MAX_REPETITION} times")
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
    documents = _Documents(archive, members)
    images = [member for member in members if member.is_image]
    times = Counter(member.base.lower() for member in images)
    for member in images:
        label = member.base if times[member.base.lower()] == 1 else member.name
        yield _entry(archive, label, member, documents, accept_damaged)


def open_entry(archive: str | os.PathLike[str], name: str, *, accept_damaged: bool = False) -> xr.Dataset:
    """Lazy raw dataset of one image of an archive: `archive_frame` by archive and name of the member."""
    return archive_frame(f"{os.fspath(archive)}{SEPARATOR}{name}", accept_damaged=accept_damaged).dataset()


def archive_frame(address: str, *, accept_damaged: bool = False) -> Frame:
    """Frame of one member, addressed as ``archive::member`` (its name without folders, in any case).

    Raises
    ------
    FileFormatError
        If there is no such member, or it is broken.
    """
    archive, _, wanted = address.rpartition(SEPARATOR)
    archive, wanted = os.path.abspath(archive), wanted.lower()  # noqa: PTH100
    members = archive_members(archive)
    found = [member for member in members if member.name.lower() == wanted]
    found = found or [member for member in members if member.base.lower() == wanted]
    if len(found) != 1:
        raise StructureError(archive, "members", f"{len(found)} members {wanted!r:.80}", "one")
    return _frame(found[0], _Documents(archive, members), accept_damaged)


def write_storage(path: str | os.PathLike[str], files: Mapping[str, bytes]) -> None:
    r"""Write a storage container as the F01's backup is: full names (``C:\T1CALIB\MOD_0000.RAW``) to contents."""
    listed = [{"name": name, "dataRef": chunk_id(data)} for name, data in files.items()]
    write_container(path, {"files": listed, "nextFile": len(listed)}, list(files.values()))


class _Documents:
    """Finds the JSON of an image: in its folder of the archive, else by its stem there, else in a sibling archive."""

    def __init__(self, archive: str, members: list[Member]) -> None:
        self.archive = archive
        here = [member for member in members if member.base.lower().endswith(_DOCUMENTS)]
        self._by_pair = {member.pair: member for member in here}
        self._times = Counter(stem for _, stem in self._by_pair)
        self._by_stem = {stem: member for (_, stem), member in self._by_pair.items()}
        self._siblings: _Documents | None = None

    def of(self, image: Member) -> Member:
        """The document of an image; raises `StructureError` where there is none."""
        found = self.find(image) or self._beside().find(image)
        if found is None:
            expected = f"{Path(image.base).stem}.TXT"
            raise StructureError(self.archive, f"{image.name:.80}", "no metadata beside it", expected)
        return found

    def find(self, image: Member) -> Member | None:
        """The document of an image if it is in this archive."""
        folder_and_stem = image.pair
        alone = self._times[folder_and_stem[1]] == 1
        return self._by_pair.get(folder_and_stem) or (self._by_stem[folder_and_stem[1]] if alone else None)

    def _beside(self) -> _Documents:
        """Documents of data.C.0, data.C.1, …: a backup is split anywhere."""
        if self._siblings is None:
            members: list[Member] = []
            for path in _sibling_archives(self.archive):
                with contextlib.suppress(FileFormatError):
                    members += archive_members(path)
            self._siblings = _Documents(self.archive, members)
        return self._siblings


def _sibling_archives(archive: str) -> list[str]:
    stem, dot, number = archive.rpartition(".")
    if not (dot and number.isdecimal()):
        return []
    paths = (f"{stem}.{other}" for other in range(_MAX_SIBLINGS) if str(other) != number)
    return [path for path in paths if Path(path).is_file()]


def _entry(archive: str, label: str, member: Member, documents: _Documents, accept_damaged: bool) -> ArchiveEntry:
    address = f"{archive}{SEPARATOR}{label}"
    try:
        frame = _frame(member, documents, accept_damaged)
    except FileFormatError as error:
        return ArchiveEntry(address, label, error=error)
    coords: dict[str, Any] = {name: value for name, (_, value) in frame.metadata.coords.items()}
    zoom, focus = float(coords["zoom_step"]), float(coords["focus_step"])
    return ArchiveEntry(address, label, coords["kind"], coords["camera_serial"], zoom, focus, frame)


def _frame(member: Member, documents: _Documents, accept_damaged: bool) -> Frame:
    document = documents.of(member)
    region, text = member.region, document.region
    damaged: tuple[str, ...] = ()
    if accept_damaged:
        damaged = (*damage(region), *damage(text))
        region, text = (region.unchecked(), text.unchecked()) if damaged else (region, text)
    return paired_frame(Path(member.base).stem, region, text, damaged)
