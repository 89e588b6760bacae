"""The files of an uncompressed tar as regions: headers only, forward only, nothing extracted, every count bounded.

Links, devices and folders are passed over, so is what a name may try (``..``, absolute paths): names are labels here.
A compressed tar has no places to read from: one image would mean to inflate all that comes before it, for each window
of each image, and a bomb could only be told by inflating it. It is refused with the command that unpacks it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

from lfflow.formats.errors import LimitError, StructureError, TruncatedError, UnsupportedError
from lfflow.formats.region import Region, open_binary

MAX_MEMBERS = 8192
_BLOCK = 512
_MAX_NAME = 1 << 14
_REGULAR = (b"0", b"\0", b"7")
_LONG_NAME, _PAX, _PAX_GLOBAL, _SPARSE = b"L", b"x", b"g", b"S"


class TarMember(NamedTuple):
    """A regular file of a tar."""

    name: str
    region: Region


def is_tar(head: bytes) -> bool:
    """Whether a file that begins with these 512 bytes is an uncompressed tar."""
    return len(head) >= _BLOCK and head[0] != 0 and _checksum_fits(head[:_BLOCK])


def tar_members(path: str) -> Iterator[TarMember]:
    """Regular files of a tar in its order.

    Raises
    ------
    TruncatedError, StructureError, LimitError, UnsupportedError
        If the tar is broken, or has what no calibration archive has.
    """
    with open_binary(path) as file:
        size = os.fstat(file.fileno()).st_size
        offset, long_name = 0, ""
        for _ in range(MAX_MEMBERS):
            head = _header(file, offset, path)
            if head is None:
                return
            length, flag = _number(head[124:136], path, offset), head[156:157]
            begin = offset + _BLOCK
            if begin + length > size:
                found = f"{size - begin} bytes before the file ends"
                raise TruncatedError(path, f"member at byte {offset}", found, f"{length} bytes")
            if flag == _SPARSE:
                raise UnsupportedError(path, f"member at byte {offset}", "a sparse file", "a regular file")
            if flag in (_LONG_NAME, _PAX):
                long_name = _long_name(file, begin, length, flag, path) or long_name
            elif flag != _PAX_GLOBAL:
                if flag in _REGULAR:
                    name = long_name or _short_name(head)
                    yield TarMember(name, Region(path, f"member {name!r:.80}", begin, length))
                long_name = ""
            offset = begin + -(-length // _BLOCK) * _BLOCK
    raise LimitError(path, "members", f"more than {MAX_MEMBERS}", "a calibration archive")


def _header(file: BinaryIO, offset: int, path: str) -> bytes | None:
    file.seek(offset)
    head = file.read(_BLOCK)
    if not head.strip(b"\0"):
        return None
    if len(head) < _BLOCK:
        raise TruncatedError(path, f"header at byte {offset}", f"{len(head)} bytes", f"{_BLOCK} bytes")
    if not _checksum_fits(head):
        raise StructureError(path, f"header at byte {offset}", "a wrong checksum", "a tar header")
    return head


def _checksum_fits(head: bytes) -> bool:
    digits = head[148:156].strip(b" \0")
    if not digits or digits.strip(b"01234567"):
        return False
    return int(digits, 8) == sum(head) - sum(head[148:156]) + 8 * ord(" ")


def _number(field: bytes, path: str, offset: int) -> int:
    digits = field.strip(b" \0")
    if digits.strip(b"01234567"):
        raise UnsupportedError(path, f"header at byte {offset}", f"size {field!r}", "an octal number")
    return int(digits or b"0", 8)


def _short_name(head: bytes) -> str:
    name, prefix = (part.split(b"\0")[0].decode("utf-8", "replace") for part in (head[:100], head[345:500]))
    return f"{prefix}/{name}" if prefix and head[257:263] == b"ustar\0" else name


def _long_name(file: BinaryIO, begin: int, length: int, flag: bytes, path: str) -> str:
    if length > _MAX_NAME:
        raise LimitError(path, f"name at byte {begin}", f"{length} bytes", f"at most {_MAX_NAME}")
    file.seek(begin)
    data = file.read(length)
    if flag == _LONG_NAME:
        return data.split(b"\0")[0].decode("utf-8", "replace")
    for line in data.split(b"\n"):
        _, _, pair = line.partition(b" ")
        if pair.startswith(b"path="):
            return pair[5:].decode("utf-8", "replace")
        if pair.startswith((b"size=", b"GNU.sparse")):
            raise UnsupportedError(path, f"extended header at byte {begin}", repr(pair[:40]), "a plain member")
    return ""
