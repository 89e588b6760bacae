r"""The LFP container: a table of contents and chunks, each under the SHA-1 of its bytes (METHOD B.1).

    file    = header section*                               integers are big-endian
    header  = "\x89LFP\r\n\x1a\n" version=1 length=0         16 bytes
    section = magic(8) version(4) length(4) [sha1(45) zeros(35) data(length) zeros]

A section begins at a multiple of 16 bytes when the cameras write it; readers find it after any run of zeros.
"""

from __future__ import annotations

import hashlib
import os
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import IO, Any, Literal

from lfflow.formats.bounded_json import EMPTY, Document, check_json_size, parse_json, write_json
from lfflow.formats.errors import (
    LimitError,
    StructureError,
    TruncatedError,
    UnsupportedError,
)
from lfflow.formats.foreign import foreign
from lfflow.formats.region import Region, open_binary
from lfflow.formats.writing import written_whole

MAGIC = b"\x89LFP\r\n\x1a\n"
MAX_SECTIONS = 8192
_KINDS: dict[bytes, Literal["toc", "chunk"]] = {b"\x89LFM\r\n\x1a\n": "toc", b"\x89LFC\r\n\x1a\n": "chunk"}
_MAGICS = {kind: magic for magic, kind in _KINDS.items()}
_HEAD = struct.Struct(">8sII")
_ID_BYTES = 80
_ID = re.compile(rb"sha1-([0-9a-fA-F]{40})\0{0,35}")
_MAX_PADDING = 1 << 16
_ALIGNMENT = 16


@dataclass(frozen=True, slots=True)
class Section:
    """One section: its kind, where it begins in the file, and its bytes (with their SHA-1 where it is not empty)."""

    kind: Literal["toc", "chunk"]
    offset: int
    region: Region


@dataclass(frozen=True)
class Container:
    """An opened container: the headers of all sections, and the table of contents.

    Where damage is accepted, `damaged` says behind which place the sections cannot be told.
    """

    path: str
    sections: tuple[Section, ...]
    toc: Document
    accept_damaged: bool = False
    damaged: tuple[str, ...] = ()

    def chunk(self, reference: object, where: str) -> Region:
        """Bytes of the chunk that `reference` ("sha1-…") of the table of contents names.

        Raises
        ------
        StructureError
            If it is no reference, or no chunk or contradicting chunks answer to it.
        """
        found = self.find_chunk(reference)
        if found is None:
            raise StructureError(self.path, where, f"no section with id {_shown(reference)}", "the section referred to")
        return found

    def find_chunk(self, reference: object) -> Region | None:
        """As `chunk`, None where there is none (derived files refer to sections of the raw file they come from)."""
        if not isinstance(reference, str) or not reference.startswith("sha1-"):
            return None
        found = self._by_sha1.get(reference[5:].lower(), [])
        if len({region.length for region in found}) > 1:
            raise StructureError(self.path, f"id {_shown(reference)}", "sections of different lengths", "one section")
        return found[0] if found else None

    @cached_property
    def _by_sha1(self) -> dict[str, list[Region]]:
        found: dict[str, list[Region]] = {}
        for section in self.sections:
            if section.region.sha1 is not None:
                found.setdefault(section.region.sha1, []).append(section.region)
        return found

    def read_json(self, region: Region, where: str) -> Document:
        """Parsed JSON of a section, checked against its SHA-1 unless damage is accepted."""
        check_json_size(region.length, self.path, where)
        data = (region.unchecked() if self.accept_damaged else region).read()
        return parse_json(data, self.path, where)


def open_container(path: str | os.PathLike[str], *, accept_damaged: bool = False) -> Container:
    """Read the headers of all sections, and the table of contents; no other data.

    Parameters
    ----------
    path
        An LFP container of any kind.
    accept_damaged
        Parse JSON also where its SHA-1 is wrong, and take the sections before a cut or before garbage for all.

    Raises
    ------
    FileFormatError
        The subclass says how the file is broken.
    """
    name = os.fspath(path)
    sections: list[Section] = []
    damaged: tuple[str, ...] = ()
    with open_binary(name) as file:
        try:
            for section in _sections(file, name):
                sections.append(section)  # noqa: PERF402 - what came before an error is kept
        except (TruncatedError, StructureError) as error:
            if not (accept_damaged and sections):
                raise
            damaged = (f"{error.where}: {error.found}",)
    tocs = [section.region for section in sections if section.kind == "toc"]
    if len(tocs) != 1:
        raise StructureError(name, "sections", f"{len(tocs)} tables of contents (LFM)", "one")
    without = Container(name, tuple(sections), EMPTY, accept_damaged, damaged)
    return replace(without, toc=without.read_json(tocs[0], "table of contents"))


def is_container(head: bytes) -> bool:
    """Whether a file that begins with these bytes (8 or more) is an LFP container."""
    return head[: len(MAGIC)] == MAGIC


def chunk_id(data: bytes) -> str:
    """Reference under which `data` stand in a container: "sha1-" and 40 hexadecimal digits."""
    return "sha1-" + hashlib.sha1(data, usedforsecurity=False).hexdigest()


def write_container(path: str | os.PathLike[str], toc: Mapping[str, Any], chunks: Sequence[bytes]) -> None:
    """Write a container as the cameras do: table of contents first, sections aligned to 16 bytes.

    The file appears under its name only when it is whole.
    """
    with written_whole(Path(path)) as file:
        file.write(_HEAD.pack(MAGIC, 1, 0))
        _write_section(file, "toc", write_json(toc))
        for chunk in chunks:
            _write_section(file, "chunk", chunk)


def _write_section(file: IO[bytes], kind: Literal["toc", "chunk"], data: bytes) -> None:
    file.write(_HEAD.pack(_MAGICS[kind], 0, len(data)))
    if data:
        file.write(chunk_id(data).encode().ljust(_ID_BYTES, b"\0"))
        file.write(data)
        file.write(bytes(-len(data) % _ALIGNMENT))


def _sections(file: IO[bytes], path: str) -> Iterator[Section]:
    size = os.fstat(file.fileno()).st_size
    head = file.read(_HEAD.size)
    if not is_container(head):
        raise foreign(path, head, f"an LFP container ({MAGIC.hex(' ')})")
    if len(head) < _HEAD.size:
        raise TruncatedError(path, "header", f"{len(head)} bytes", f"{_HEAD.size} bytes")
    _, version, length = _HEAD.unpack(head)
    if (version, length) != (1, 0):
        raise UnsupportedError(path, "header", f"version {version}, length {length}", "version 1, length 0")
    offset = _HEAD.size
    for number in range(MAX_SECTIONS + 1):
        offset = _skip_zeros(file, offset, size, path)
        if offset == size:
            return
        if number == MAX_SECTIONS:
            raise LimitError(path, "sections", f"more than {MAX_SECTIONS}", "a real file")
        section = _section(file, offset, size, path)
        yield section
        offset = section.region.offset + section.region.length


def _section(file: IO[bytes], offset: int, size: int, path: str) -> Section:
    where = f"section at byte {offset}"
    file.seek(offset)
    head = file.read(_HEAD.size + _ID_BYTES)
    if head[:8] not in _KINDS:
        raise StructureError(path, where, f"bytes {head[:8].hex(' ')}", "a section (LFM or LFC)")
    if len(head) < _HEAD.size:
        raise TruncatedError(path, where, f"{len(head)} bytes of its head", f"{_HEAD.size} bytes")
    magic, _, length = _HEAD.unpack(head[: _HEAD.size])
    if length == 0:
        return Section(_KINDS[magic], offset, Region(path, where, offset + _HEAD.size, 0))
    if len(head) < _HEAD.size + _ID_BYTES:
        raise TruncatedError(path, where, f"{len(head)} bytes of its head", f"{_HEAD.size + _ID_BYTES} bytes")
    begin = offset + _HEAD.size + _ID_BYTES
    if begin + length > size:
        raise TruncatedError(path, where, f"{size - begin} bytes of data before the file ends", f"{length} bytes")
    match = _ID.match(head, _HEAD.size)
    if match is None:
        raise StructureError(path, where, f"id {head[_HEAD.size : _HEAD.size + 45]!r}", "sha1- and 40 digits")
    return Section(_KINDS[magic], offset, Region(path, where, begin, length, match[1].decode().lower()))


def _skip_zeros(file: IO[bytes], offset: int, size: int, path: str) -> int:
    file.seek(offset)
    padding = file.read(64)
    if not padding.strip(b"\0"):
        padding += file.read(_MAX_PADDING - len(padding))
    zeros = len(padding) - len(padding.lstrip(b"\0"))
    if zeros == _MAX_PADDING and offset + zeros < size:
        raise LimitError(path, f"padding at byte {offset}", f"{zeros} zeros and more", "the next section")
    return offset + zeros


def _shown(reference: object) -> str:
    return str(reference)[:60]
