"""Where the files of a collection lie: a local folder or any fsspec URL, with durable atomic writes."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from lfflow.errors import CollectionError


class Storage(Protocol):
    """Files by name, relative to the collection; a write is there whole or not at all."""

    url: str

    def read(self, name: str) -> bytes:
        """Return the content; raises FileNotFoundError."""

    def read_many(self, names: Sequence[str]) -> dict[str, bytes]:
        """Contents of many small files by name, at once where that is quicker; what is not there is left out."""

    def write(self, name: str, data: bytes, *, durable: bool = True) -> None:
        """Replace the file in one step; when this returns and it is `durable`, it survives a power cut."""

    def write_many(self, contents: Mapping[str, bytes]) -> None:
        """Replace many small files, at once where that is quicker; none needs to survive a power cut."""

    def remove(self, name: str) -> None:
        """Remove the file if it is there."""

    def has(self, name: str) -> bool:
        """Whether there is such a file."""

    def names(self, folder: str) -> list[str]:
        """Sorted names of the files in a folder; empty when there is no such folder."""

    def files_below(self, folder: str) -> list[str]:
        """Sorted names, relative to the collection, of all files below a folder."""

    def digest(self, name: str) -> str:
        """Hexadecimal sha256 of a file; raises FileNotFoundError."""

    def flush(self, names: Iterable[str]) -> None:
        """Bring files that something else has written to the disk."""

    def zarr_store(self, name: str) -> Any:
        """Zarr store rooted at a folder."""


class LocalStorage:
    """A collection in a folder of this machine."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.url = str(root)

    def path(self, name: str) -> Path:
        """Path of a file."""
        return self.root / name

    def read(self, name: str) -> bytes:
        """Return the content; raises FileNotFoundError."""
        return self.path(name).read_bytes()

    def read_many(self, names: Sequence[str]) -> dict[str, bytes]:
        """Contents of many small files by name; what is not there is left out."""
        contents: dict[str, bytes] = {}
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                contents[name] = self.read(name)
        return contents

    def write(self, name: str, data: bytes, *, durable: bool = True) -> None:
        """Write to a temporary name, flush, rename, flush the folder."""
        target = self.path(name)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(f".{target.name}.{os.getpid()}-{threading.get_ident()}.tmp")
        try:
            with temporary.open("wb") as stream:
                stream.write(data)
                stream.flush()
                if durable:
                    os.fsync(stream.fileno())
            temporary.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        if durable:
            _flush_path(target.parent)

    def write_many(self, contents: Mapping[str, bytes]) -> None:
        """Replace many small files; none needs to survive a power cut."""
        for name, data in contents.items():
            self.write(name, data, durable=False)

    def remove(self, name: str) -> None:
        """Remove the file if it is there."""
        target = self.path(name)
        if target.exists():
            target.unlink(missing_ok=True)
            _flush_path(target.parent)

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        return self.path(name).is_file()

    def names(self, folder: str) -> list[str]:
        """Sorted names of the files in a folder."""
        try:
            with os.scandir(self.path(folder)) as entries:
                return sorted(entry.name for entry in entries if not entry.name.startswith(".") and entry.is_file())
        except FileNotFoundError:
            return []

    def files_below(self, folder: str) -> list[str]:
        """Sorted names of all files below a folder."""
        base = self.path(folder)
        return sorted(
            str((Path(parent) / name).relative_to(self.root)) for parent, _, files in os.walk(base) for name in files
        )

    def digest(self, name: str) -> str:
        """Hexadecimal sha256 of a file."""
        return file_digest(self.path(name))

    def flush(self, names: Iterable[str]) -> None:
        """Flush files, then every folder between them and the collection."""
        folders: set[Path] = set()
        for name in names:
            path = self.path(name)
            _flush_path(path)
            parent = path.parent
            while parent != self.root and parent not in folders:
                folders.add(parent)
                parent = parent.parent
        for folder in folders:
            _flush_path(folder)

    def zarr_store(self, name: str) -> Any:
        """Zarr store rooted at a folder."""
        from zarr.storage import LocalStore

        return LocalStore(self.path(name))


class RemoteStorage:
    """A collection at an fsspec URL; the object store's puts are atomic and durable."""

    def __init__(self, url: str) -> None:
        import fsspec

        self.url = url.rstrip("/")
        self._fs, self._base = fsspec.core.url_to_fs(self.url)

    def _key(self, name: str) -> str:
        return f"{self._base}/{name}"

    def _name(self, key: str) -> str:
        return key.strip("/").removeprefix(self._base.strip("/") + "/")

    def read(self, name: str) -> bytes:
        """Return the content; raises FileNotFoundError."""
        return bytes(self._fs.cat_file(self._key(name)))

    def read_many(self, names: Sequence[str]) -> dict[str, bytes]:
        """Contents of many small objects by name, asked for at once; what is not there is left out."""
        if not names:
            return {}
        contents: dict[str, bytes] = {}
        answers = self._fs.cat([self._key(name) for name in names], on_error="return")
        for key, answer in answers.items():
            if not isinstance(answer, Exception):
                contents[self._name(key)] = bytes(answer)
            elif not isinstance(answer, FileNotFoundError):
                raise answer
        return contents

    def write(self, name: str, data: bytes, *, durable: bool = True) -> None:  # noqa: ARG002
        """Put the object."""
        self.write_many({name: data})

    def write_many(self, contents: Mapping[str, bytes]) -> None:
        """Put many small objects at once."""
        keys = {self._key(name): data for name, data in contents.items()}
        try:
            self._fs.pipe(keys)
        except FileNotFoundError:
            for folder in {key.rpartition("/")[0] for key in keys}:
                self._fs.makedirs(folder, exist_ok=True)
            self._fs.pipe(keys)

    def create(self, name: str, data: bytes) -> bool:
        """Put the object unless there is one; whether it was put."""
        if self._fs.exists(self._key(name)):
            return False
        try:
            self._fs.pipe_file(self._key(name), data, mode="create")
        except OSError:
            return False
        return True

    def remove(self, name: str) -> None:
        """Remove the object if it is there."""
        with contextlib.suppress(FileNotFoundError):
            self._fs.rm_file(self._key(name))

    def has(self, name: str) -> bool:
        """Whether there is such an object."""
        self._fs.invalidate_cache()
        return bool(self._fs.exists(self._key(name)))

    def names(self, folder: str) -> list[str]:
        """Sorted names of the objects in a folder."""
        return sorted(name.rpartition("/")[2] for name in self._found(folder, maxdepth=1))

    def files_below(self, folder: str) -> list[str]:
        """Sorted names of all objects below a folder."""
        return sorted(self._name(key) for key in self._found(folder))

    def _found(self, folder: str, maxdepth: int | None = None) -> list[str]:
        self._fs.invalidate_cache()
        try:
            return list(self._fs.find(self._key(folder), maxdepth=maxdepth))
        except FileNotFoundError:
            return []

    def digest(self, name: str) -> str:
        """Hexadecimal sha256 of an object."""
        return hashlib.sha256(self.read(name)).hexdigest()

    def flush(self, names: Iterable[str]) -> None:
        """Nothing: a put that returned is durable."""

    def zarr_store(self, name: str) -> Any:
        """Zarr store rooted at a folder of the URL."""
        from zarr.storage import FsspecStore

        return FsspecStore.from_url(f"{self.url}/{name}")


def open_storage(where: str | os.PathLike[str]) -> Storage:
    """Storage of a collection: a folder, or a URL such as ``s3://bucket/collection``."""
    text = os.fspath(where)
    if "://" in text and not text.startswith("file://"):
        return RemoteStorage(text)
    return LocalStorage(Path(text.removeprefix("file://")).absolute())


def file_digest(path: str | os.PathLike[str]) -> str:
    """Hexadecimal sha256 of a file on this machine."""
    with Path(path).open("rb", buffering=0) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def explain(error: OSError) -> CollectionError:
    """The error of a write to the collection in words for the person at the keyboard."""
    reasons = {
        errno.ENOSPC: "no space left on the disk",
        errno.EDQUOT: "the disk quota is used up",
        errno.EROFS: "the file system is read-only",
        errno.EACCES: "permission denied",
    }
    reason = reasons.get(error.errno or 0, error.strerror or str(error))
    where = f" ({error.filename})" if error.filename else ""
    return CollectionError(f"cannot write to the collection: {reason}{where}; what is finished is kept")


def _flush_path(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
