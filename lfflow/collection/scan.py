"""From pictures on the disk to rows of the catalogue: incremental, and never stopped by a broken file."""

from __future__ import annotations

import errno
import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr

from lfflow.cameras import KNOWN_CAMERAS
from lfflow.collection import identity
from lfflow.collection.catalogue import NUMBERS, Row, frame, rows_of
from lfflow.collection.inputs import contents, digest, file_of, file_state, is_there
from lfflow.collection.judge import CONTENT, judge
from lfflow.errors import FormatError, LfflowError

_READERS = 4
_log = logging.getLogger(__name__)

OpenRaw = Callable[[str], xr.Dataset]


def scan(
    files: Sequence[str],
    known: pd.DataFrame,
    open_raw: OpenRaw,
    *,
    white: Sequence[str] = (),
    dark: Sequence[str] = (),
    again: bool = False,
    finished: Collection[str] = (),
) -> pd.DataFrame:
    """Catalogue with a row for each picture in `files` beside those that were known, all as they are on the disk now.

    Parameters
    ----------
    files
        Absolute paths of files (archives too) and addresses of archive entries.
    known
        The catalogue as it was.
    open_raw
        From a path or address to the lazy raw frame.
    white, dark
        Files that are told to be so, whatever their metadata and content say.
    again
        Try files anew that could not be read before, or of which no sample was read.
    finished
        Captures with results: their rows stay when their files are gone.

    Notes
    -----
    A picture whose size and time are as the catalogue has them is not read again; one with another time but the same
    sha256 is not judged again.
    """
    told = {**dict.fromkeys(white, "white"), **dict.fromkeys(dark, "dark")}
    before = {row["path"]: row for row in rows_of(known)}
    reader = _Reader(before, open_raw, told, again)
    units = sorted({*files, *white, *dark, *before})
    rows = {path: row for path in units if (row := reader.unchanged(path)) is not None}
    with ThreadPoolExecutor(_READERS) as readers:
        for read in readers.map(reader.read, [path for path in units if path not in rows]):
            for row in read:
                rows.setdefault(row["path"], row)
    gone = {path: row for path, row in before.items() if path not in rows}
    return frame(identity.settle(rows, gone, before, finished))


@dataclass(frozen=True, slots=True)
class _Reader:
    """Makes rows of pictures; used by several threads at once, changes nothing."""

    before: Mapping[str, Row]
    open_raw: OpenRaw
    told: Mapping[str, str]
    again: bool = False

    def unchanged(self, path: str) -> Row | None:
        """Known row of a picture that is as it was, else None."""
        known = self.before.get(path)
        if known is None or not self._stands(known):
            return None
        try:
            same = (known["size"], known["mtime_ns"]) == file_state(path)
        except OSError:
            return None
        return {**known, "missing": False} if same and self._told_kind(path) == known["told_kind"] else None

    def _stands(self, known: Row) -> bool:
        """Whether a row says all that its picture would tell now: one that was made from the ledger does not."""
        whole = bool(known["sha256"]) and bool(known["reason"] or known["judged_by"])
        unread = known["kind"] != "scene" and known["judged_by"] != CONTENT
        return whole and not (self.again and (known["reason"] or unread))

    def read(self, path: str) -> list[Row]:
        """Rows of everything in a file: none when it is gone, one of a picture, one for each entry of an archive."""
        if path in self.before and not is_there(path):
            return []
        try:
            pictures = contents(path)
        except (OSError, LfflowError) as error:
            return [self._row(path) | {"reason": _words(error, path), "sha256": ""}]
        return [self.unchanged(picture) or self._picture(picture) for picture in pictures]

    def _told_kind(self, path: str) -> str:
        return self.told.get(path) or self.told.get(file_of(path)) or self.before.get(path, {}).get("told_kind", "")

    def _row(self, path: str) -> Row:
        return {"path": path.encode(errors="backslashreplace").decode(), "told_kind": self._told_kind(path)}

    def _picture(self, path: str) -> Row:
        row, known = self._row(path), self.before.get(path)
        if row["path"] != path:
            return row | {"reason": "its name is no text in UTF-8: rename the file"}
        try:
            row["size"], row["mtime_ns"] = file_state(path)
            row["sha256"] = digest(path)
            same = known is not None and row["sha256"] == known["sha256"] and row["told_kind"] == known["told_kind"]
            if known is not None and same and self._stands(known):
                return {**known, **row, "missing": False}
            with self.open_raw(path) as raw:
                return row | _metadata(raw, path, row["told_kind"])
        except (LfflowError, OSError, ValueError, KeyError, TypeError) as error:
            reason = _words(error, path)
            _log.info("%s: %s", path, reason)
            return row | {"reason": reason}


def _words(error: Exception, path: str) -> str:
    """Reason why a picture cannot be used, in one line for people."""
    if isinstance(error, OSError):
        known = error.errno in (errno.ENOENT, errno.EACCES, errno.EPERM, errno.EIO, errno.ELOOP)
        text = f"cannot be read: {error.strerror if known or error.strerror else error}"
    elif isinstance(error, FormatError):
        text = str(error).removeprefix(f"{path}: ")
    else:
        text = f"{type(error).__name__}: {error}"
    return " ".join(text.split())


def _metadata(raw: xr.Dataset, path: str, told: str) -> Row:
    if "raw" not in raw.variables:
        raise FormatError(f"{path}: found a derived picture ({', '.join(map(str, raw.data_vars))}), expected a raw one")
    row: Row = {name: float(raw.variables[name].values.item()) for name in NUMBERS if name in raw.variables}
    for name in ("camera_model", "camera_serial"):
        row[name] = str(raw.variables[name].values.item()) if name in raw.variables else ""
    row["time"] = raw["time"].values if "time" in raw.variables else np.datetime64("NaT", "ns")
    row["damaged"] = str(raw.attrs.get("damaged", ""))
    row["kind"], row["judged_by"] = judge(raw, told)
    row["height"], row["width"] = int(raw.sizes["y"]), int(raw.sizes["x"])
    row["group"] = group_name(row["camera_model"], row["height"], row["width"])
    return row


def group_name(model: str, height: int, width: int) -> str:
    """Group of a camera model in the stores; sensors of another size than the model's own have their own group."""
    name = "".join(letter if letter.isalnum() else "_" for letter in model) or "unknown"
    camera = KNOWN_CAMERAS.get(model)
    same = camera is not None and (camera.height, camera.width) == (height, width)
    return name if same else f"{name}-{height}x{width}"
