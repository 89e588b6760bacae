"""A run of bytes inside a file, read only when asked and never used before its SHA-1 was seen to be right.

Integrity
---------
An LFP section carries one SHA-1 of all its bytes. Opening a file does not read its images, so the hash of an image is
checked where its bytes are first used:

- a read of the whole region hashes the very bytes it returns, each time;
- a read of a part is preceded, once per process and state of the file (device, inode, size, time of change), by a
  streamed hash of the whole region; afterwards a part reads its own bytes only.

So no sample of a damaged image ever reaches a caller, and a window costs one pass over the section the first time.
"""

from __future__ import annotations

import hashlib
import os
import stat
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import BinaryIO

from lfflow.formats.errors import ChecksumError, TruncatedError, UnreadableError

_BLOCK = 1 << 20
_REMEMBERED = 4096
_digests: OrderedDict[tuple[object, ...], str] = OrderedDict()
_lock = threading.Lock()


@contextmanager
def open_binary(path: str) -> Iterator[BinaryIO]:
    """File opened for reading; a file that the system refuses is an `UnreadableError`."""
    try:
        file = open(path, "rb", opener=_without_waiting)  # noqa: SIM115 - Path.open costs twice the time
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the path
        raise UnreadableError(path, "file", getattr(error, "strerror", error), "a readable file") from error
    with file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise UnreadableError(path, "file", "a device or a pipe", "a regular file")
        try:
            yield file
        except OSError as error:
            raise UnreadableError(path, "file", error.strerror, "a readable file") from error


def _without_waiting(path: str, flags: int) -> int:
    """Open a file; a pipe too returns at once, to be refused."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


@dataclass(frozen=True, slots=True)
class Region:
    """`length` bytes of a file from `offset` on.

    Parameters
    ----------
    path
        The file that holds the bytes.
    name
        What the bytes are, for messages.
    offset, length
        In bytes.
    sha1
        Hexadecimal SHA-1 the bytes must have; None where the file carries none.
    """

    path: str
    name: str
    offset: int
    length: int
    sha1: str | None = None

    def unchecked(self) -> Region:
        """Same bytes, read without looking at their hash."""
        return replace(self, sha1=None)

    def read(self) -> bytes:
        """All bytes, hashed on the way.

        Raises
        ------
        TruncatedError
            If the file ends inside the region.
        ChecksumError
            If the bytes differ from those the file's SHA-1 was made of.
        """
        with open_binary(self.path) as file:
            data = self._read(file, 0, self.length)
        if self.sha1 is not None:
            self._compare(hashlib.sha1(data, usedforsecurity=False).hexdigest())
        return data

    def read_part(self, start: int, length: int) -> bytes:
        """`length` bytes from `start` on (relative to the region), after the whole region was once seen to be right.

        Raises
        ------
        TruncatedError, ChecksumError
            As in `read`.
        """
        if start == 0 and length == self.length:
            return self.read()
        with open_binary(self.path) as file:
            if self.sha1 is not None:
                self._compare(self._remembered_digest(file))
            return self._read(file, start, length)

    def digest(self) -> str:
        """Hexadecimal SHA-1 of the bytes as they are now, streamed."""
        with open_binary(self.path) as file:
            return self._digest(file)

    def verify(self) -> None:
        """Read and hash all bytes, streamed.

        Raises
        ------
        TruncatedError, ChecksumError
            As in `read`.
        """
        digest = self.digest()
        if self.sha1 is not None:
            self._compare(digest)

    def _read(self, file: BinaryIO, start: int, length: int) -> bytes:
        file.seek(self.offset + start)
        data = file.read(length)
        if len(data) != length:
            raise TruncatedError(self.path, self.name, f"{len(data)} bytes at {self.offset + start}", f"{length} bytes")
        return data

    def _digest(self, file: BinaryIO) -> str:
        file.seek(self.offset)
        sha1 = hashlib.sha1(usedforsecurity=False)
        left = self.length
        while left:
            block = file.read(min(_BLOCK, left))
            if not block:
                found = f"{self.length - left} bytes at {self.offset}"
                raise TruncatedError(self.path, self.name, found, f"{self.length} bytes")
            sha1.update(block)
            left -= len(block)
        return sha1.hexdigest()

    def _remembered_digest(self, file: BinaryIO) -> str:
        state = os.fstat(file.fileno())
        key = (self.path, self.offset, self.length, state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns)
        with _lock:
            if key in _digests:
                _digests.move_to_end(key)
                return _digests[key]
        digest = self._digest(file)
        with _lock:
            _digests[key] = digest
            while len(_digests) > _REMEMBERED:
                _digests.popitem(last=False)
        return digest

    def _compare(self, digest: str) -> None:
        if digest != self.sha1:
            raise ChecksumError(self.path, self.name, f"SHA-1 {digest}", f"SHA-1 {self.sha1}")
