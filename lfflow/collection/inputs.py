"""From what a person names (files, folders, archives, globs) to pictures: one path each, with its state and digest.

A picture is a file, a .RAW with the .TXT beside it, or an entry of an archive (``archive::entry``).
"""

from __future__ import annotations

import contextlib
import glob
import hashlib
import os
import re
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from lfflow.collection.storage import file_digest
from lfflow.errors import CollectionError, FormatError
from lfflow.formats.archives import SEPARATOR, archive_entries, is_archive
from lfflow.formats.opening import open_frame
from lfflow.formats.raw_pair import pair_of

PICTURES = frozenset({".lfp", ".lfr", ".raw"})
_ARCHIVE = re.compile(r"data\.c\.\d+|.+\.tar", re.IGNORECASE)
_FOREIGN = ("catalogue.parquet", ".zgroup", "zarr.json")


class NotAFileError(OSError):
    """The path leads to a device, a pipe or a folder."""


def find_files(inputs: Iterable[str | os.PathLike[str]]) -> list[str]:
    """Absolute paths, sorted: files and archive entries as named, folders walked, globs (also with ``**``) expanded.

    Raises
    ------
    CollectionError
        For an input that is not there.
    """
    found: set[str] = set()
    for item in inputs:
        path = absolute(item)
        if Path(path).is_dir():
            found.update(_walk(path))
        elif os.path.lexists(path) or _archive_of(path):
            found.add(_picture(path))
        else:
            matches = glob.glob(path, recursive=True)  # noqa: PTH207 - the pattern is absolute
            if not matches:
                raise CollectionError(f"no such input: {item}")
            found.update(find_files(match for match in matches if _wanted(match)))
    return sorted(found)


def absolute(path: str | os.PathLike[str]) -> str:
    """Absolute path without ``..`` resolved, as the working folder has it now."""
    return os.path.abspath(os.path.expanduser(os.fspath(path)))  # noqa: PTH100, PTH111 - globs and addresses too


def file_of(path: str) -> str:
    """File that holds a picture: its own, or the archive of an entry."""
    return _archive_of(path) or path


def name_of(path: str) -> str:
    """Name of a picture without folders: that of its file, or of the entry in its archive."""
    return re.split(r"[\\/]", path.rpartition(SEPARATOR)[2] if _archive_of(path) else path)[-1]


def root_of(path: str) -> str:
    """Folder that must be there for a picture to be known as removed, not as out of reach."""
    return str(Path(file_of(path)).parent)


def is_there(path: str) -> bool:
    """Whether the file of a picture is there, or a link of its name; of an entry: whether its archive still has it."""
    archive = _archive_of(path)
    if not archive:
        return os.path.lexists(path)
    if not is_archive(archive):
        return False
    with contextlib.suppress(FormatError):
        return any(entry.path == path for entry in archive_entries(archive))
    return True


def contents(path: str) -> list[str]:
    """Pictures in a file: its own path, or the address of every entry of an archive.

    Raises
    ------
    FormatError, OSError
        If it is a broken archive, or cannot be read at all.
    """
    if _archive_of(path):
        return [path]
    _check_regular(path)
    if not is_archive(path):
        return [path]
    found = [entry.path for entry in archive_entries(path)]
    if not found:
        raise FormatError(f"{path}: found no picture in the archive, expected MOD_NNNN.RAW")
    return found


def file_state(path: str) -> tuple[int, int]:
    """Bytes and time of change (ns) of the file or files that hold a picture; of an entry, those of its archive.

    Raises
    ------
    OSError
        If a file is not there.
    """
    states = [_check_regular(part) for part in _parts(path)]
    return sum(state.st_size for state in states), max(state.st_mtime_ns for state in states)


def digest(path: str) -> str:
    """Hexadecimal sha256 of a picture: of the file; of a pair or an archive entry, of the samples, then the text.

    Raises
    ------
    FormatError, OSError
        If it cannot be read.
    """
    if not _archive_of(path) and len(_parts(path)) == 1:
        return file_digest(path)
    frame = open_frame(path, accept_damaged=True)
    found = hashlib.sha256(frame.region.unchecked().read())
    found.update(frame.documents["document"].text.encode())
    return found.hexdigest()


def _walk(folder: str) -> Iterator[str]:
    """Pictures and archives below a folder, each folder once however many links lead to it; nothing hidden."""
    seen: set[tuple[int, int]] = set()
    waiting = [folder]
    while waiting:
        here = waiting.pop(0)
        try:
            state = Path(here).stat()
            with os.scandir(here) as listed:
                entries = sorted((entry for entry in listed if not entry.name.startswith(".")), key=lambda e: e.name)
        except OSError:
            continue
        if (state.st_dev, state.st_ino) in seen or any(entry.name in _FOREIGN for entry in entries):
            continue
        seen.add((state.st_dev, state.st_ino))
        folders = [entry for entry in entries if _is_folder(entry)]
        # Links last, so that a folder is known by its own name rather than by that of a link to it.
        waiting = [
            *(entry.path for entry in folders if not entry.is_symlink()),
            *waiting,
            *(entry.path for entry in folders if entry.is_symlink()),
        ]
        yield from (entry.path for entry in entries if _wanted(entry.path) and _is_file(entry))


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


def _is_file(entry: os.DirEntry[str]) -> bool:
    """Whether it is a file, or a link that leads nowhere: that is a picture which cannot be read."""
    try:
        return entry.is_file() or (entry.is_symlink() and not Path(entry.path).exists())
    except OSError:
        return True


def _wanted(path: str) -> bool:
    """Whether a name that was met, not given, is that of a picture, an archive or a folder."""
    base = Path(path)
    return base.suffix.lower() in PICTURES or _ARCHIVE.fullmatch(base.name) is not None or base.is_dir()


def _picture(path: str) -> str:
    """Path of the samples where the text of a pair was named."""
    pair = None if _archive_of(path) else pair_of(path)
    return str(pair[0]) if pair else path


def _parts(path: str) -> tuple[str, ...]:
    archive = _archive_of(path)
    if archive:
        return (archive,)
    pair = pair_of(path) if Path(path).suffix.lower() == ".raw" else None
    return tuple(map(str, pair)) if pair else (path,)


def _archive_of(path: str) -> str:
    """Archive of an ``archive::entry`` address, "" for a file of its own."""
    if SEPARATOR not in path or os.path.lexists(path):
        return ""
    archive = path.rpartition(SEPARATOR)[0]
    return archive if SEPARATOR not in Path(archive).name else ""


def _check_regular(path: str) -> os.stat_result:
    state = Path(path).stat()
    if not stat.S_ISREG(state.st_mode):
        raise NotAFileError(0, "it is no regular file", path)
    return state
