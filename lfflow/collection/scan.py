"""From files on the disk to rows of the catalogue: incremental, and never stopped by a broken file."""

from __future__ import annotations

import glob
import logging
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from lfflow.cameras import KNOWN_CAMERAS
from lfflow.collection.catalogue import NUMBERS, frame
from lfflow.collection.storage import file_digest
from lfflow.errors import CollectionError, LfflowError

SUFFIXES = frozenset({".lfp", ".lfr", ".raw"})
_READERS = 4
_log = logging.getLogger(__name__)

OpenRaw = Callable[[str], xr.Dataset]
Row = dict[str, Any]


def find_files(inputs: Iterable[str | Path]) -> list[Path]:
    """Absolute paths, sorted: files as named, folders walked for captures, globs expanded.

    Raises CollectionError for an input that is not there.
    """
    found: set[Path] = set()
    for item in inputs:
        path = Path(item).absolute()
        if path.is_dir():
            found |= {entry for entry in path.rglob("*") if entry.suffix.lower() in SUFFIXES and entry.is_file()}
        elif path.exists():
            found.add(path)
        else:
            matches = [Path(match).absolute() for match in glob.glob(str(item), recursive=True)]  # noqa: PTH207 - the pattern may be absolute
            if not matches:
                raise CollectionError(f"no such input: {item}")
            found |= set(find_files(matches))
    return sorted(found)


def scan(
    files: Sequence[Path],
    known: pd.DataFrame,
    open_raw: OpenRaw,
    *,
    white: Sequence[Path] = (),
    dark: Sequence[Path] = (),
    again: bool = False,
) -> pd.DataFrame:
    """Catalogue with a row for each of `files` beside the rows that were there.

    A file whose size and time are as the catalogue has them is not read again; `white` and `dark` are told to be so,
    whatever their metadata say; with `again`, files that could not be read before are tried anew.
    """
    told = {**dict.fromkeys(map(str, white), "white"), **dict.fromkeys(map(str, dark), "dark")}
    rows: dict[str, Row] = {row["path"]: row for row in _rows(known)}
    trusted = {path: row for path, row in rows.items() if not (again and row["reason"])}
    ids = {row["id"] for row in rows.values()}
    paths = sorted({str(path) for path in (*files, *white, *dark)})
    with ThreadPoolExecutor(_READERS) as readers:
        fresh = list(readers.map(lambda path: _refresh(path, trusted.get(path), open_raw, told.get(path, "")), paths))
    for path, row in zip(paths, fresh, strict=True):
        row["id"] = rows[path]["id"] if path in rows else _new_id(path, ids)
        ids.add(row["id"])
        rows[path] = row
    old = {row["id"] for row in _rows(known)}
    return frame(_mark_duplicates(sorted(rows.values(), key=lambda row: (row["id"] not in old, row["id"]))))


def _rows(table: pd.DataFrame) -> list[Row]:
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


def _new_id(path: str, taken: set[str]) -> str:
    stem = Path(path).stem
    name, number = stem, 1
    while name in taken:
        number += 1
        name = f"{stem}_{number}"
    return name


def _mark_duplicates(rows: list[Row]) -> list[Row]:
    """Rows with `duplicate_of` set; of equal files, the one that comes first is the original."""
    first: dict[str, str] = {}
    for row in rows:
        digest = row.get("sha256") or ""
        row["duplicate_of"] = first.get(digest, "") if digest else ""
        if digest:
            first.setdefault(digest, row["id"])
    return rows


def _refresh(path: str, known: Row | None, open_raw: OpenRaw, told: str) -> Row:
    """Row of a file: the known one when nothing changed, else read anew."""
    row: Row = {"path": path, "told_kind": told or (known or {}).get("told_kind", "")}
    try:
        state = Path(path).stat()
        row |= {"size": state.st_size, "mtime_ns": state.st_mtime_ns}
        same = known is not None and (known["size"], known["mtime_ns"]) == (state.st_size, state.st_mtime_ns)
        if known is not None and same and known["sha256"] and row["told_kind"] == known["told_kind"]:
            return dict(known)
        row["sha256"] = file_digest(path)
    except OSError as error:
        return row | {"sha256": "", "reason": f"cannot be read: {error.strerror or error}"}
    if known is not None and known["sha256"] == row["sha256"] and row["told_kind"] == known["told_kind"]:
        return {**known, "mtime_ns": row["mtime_ns"]}
    try:
        return row | _metadata(open_raw(path), row["told_kind"])
    except (LfflowError, OSError, ValueError, KeyError, TypeError) as error:
        _log.warning("%s: %s", path, error)
        return row | {"reason": f"{type(error).__name__}: {error}"}


def _metadata(raw: xr.Dataset, told: str) -> Row:
    row: Row = {name: float(raw[name]) for name in NUMBERS if name in raw.variables}
    for name in ("camera_model", "camera_serial"):
        row[name] = str(raw[name].item()) if name in raw.variables else ""
    row["time"] = raw["time"].values if "time" in raw.variables else np.datetime64("NaT", "ns")
    row["kind"] = told or str(raw["kind"].item())
    row["height"], row["width"] = int(raw.sizes["y"]), int(raw.sizes["x"])
    row["group"] = group_name(row["camera_model"], row["height"], row["width"])
    raw.close()
    return row


def group_name(model: str, height: int, width: int) -> str:
    """Group of a camera model in the stores; sensors of another size than the model's own have their own group."""
    name = "".join(letter if letter.isalnum() else "_" for letter in model) or "unknown"
    camera = KNOWN_CAMERAS.get(model)
    same = camera is not None and (camera.height, camera.width) == (height, width)
    return name if same else f"{name}-{height}x{width}"
