"""Which row of the catalogue is which capture: ids that last, files that were renamed or removed, duplicates.

An id is the stem of the file; where two collide, the later one gets a suffix made of its content, which is the same
whatever else is scanned and wherever the folder lies. An id once given stays: with its capture, the content, not with
the path. So a renamed file is the same capture, and so is a copy whose original was removed.
"""

from __future__ import annotations

import hashlib
import unicodedata
from collections.abc import Collection, Mapping
from pathlib import Path
from urllib.parse import quote

from lfflow.collection.catalogue import Row
from lfflow.collection.inputs import name_of, root_of

_LONGEST = 120
"""Longest id in bytes as it stands in the names of files (records, pictures)."""
_SUFFIX = 6


def settle(
    rows: Mapping[str, Row], gone: Mapping[str, Row], before: Mapping[str, Row], finished: Collection[str]
) -> list[Row]:
    """Rows of the catalogue with their ids and `duplicate_of`.

    Parameters
    ----------
    rows
        By path: the pictures that are there.
    gone
        By path: the rows of pictures that are not there any more.
    before
        By path: the catalogue as it was.
    finished
        Captures with results; their rows stay, marked as missing.
    """
    settled = {path: {**row, "id": before[path]["id"]} if path in before else dict(row) for path, row in rows.items()}
    left = _follow_moves(settled, gone, before)
    kept = [{**row, "missing": True, "duplicate_of": ""} for row in left if _stays(row, finished)]
    taken = {str(row["id"]).casefold() for row in [*kept, *settled.values()] if row.get("id")}
    for path in sorted(settled):
        row = settled[path]
        if not row.get("id"):
            row["id"] = _new_id(row, taken)
            taken.add(row["id"].casefold())
    originals = {row["id"] for row in before.values() if not row["duplicate_of"]}
    known = {row["id"] for row in before.values()}
    order = sorted(settled.values(), key=lambda row: (row["id"] not in originals, row["id"] not in known, row["path"]))
    return [*_with_duplicates(order), *kept]


def _follow_moves(settled: dict[str, Row], gone: Mapping[str, Row], before: Mapping[str, Row]) -> list[Row]:
    """Give the captures whose files are gone to files of the same content; returns those for which there is none."""
    heirs: dict[str, list[str]] = {}
    for path in sorted(settled, key=lambda path: (path in before, path)):
        if settled[path].get("sha256") and (path not in before or before[path]["duplicate_of"]):
            heirs.setdefault(settled[path]["sha256"], []).append(path)
    present = {row["sha256"] for row in settled.values() if row.get("sha256")}
    left = []
    for _, row in sorted(gone.items()):
        paths = heirs.get(row["sha256"], []) if row["sha256"] and not row["duplicate_of"] else []
        if paths:
            path = paths.pop(0)
            place = {name: settled[path].get(name) for name in ("path", "size", "mtime_ns")}
            told = settled[path].get("told_kind") or row["told_kind"]
            settled[path] = {**row, **(settled[path] if told != row["told_kind"] else {}), **place, "id": row["id"],
                             "missing": False}  # fmt: skip
        elif row["sha256"] not in present or not row["sha256"]:
            left.append(row)
    return left


def _stays(row: Row, finished: Collection[str]) -> bool:
    """Whether the row of a file that is gone is worth keeping: it has results, or its whole folder is out of reach."""
    return not row["duplicate_of"] and (row["id"] in finished or not Path(root_of(row["path"])).is_dir())


def _new_id(row: Row, taken: Collection[str]) -> str:
    name = _readable(Path(name_of(row["path"])).stem)
    place = hashlib.sha256(row["path"].encode()).hexdigest()
    content = row.get("sha256") or place
    for suffix in ("", f"-{content[:_SUFFIX]}", f"-{place[:_SUFFIX]}", f"-{place}"):
        if name + suffix and (name + suffix).casefold() not in taken:
            return name + suffix
    raise AssertionError("two rows of one path")


def _readable(stem: str) -> str:
    """Stem that can be typed and be part of a file's name: composed letters, nothing that does not print, not long."""
    text = "".join(letter if letter.isprintable() else "_" for letter in unicodedata.normalize("NFC", stem))
    if text.startswith("."):
        text = "_" + text.lstrip(".")
    if len(quote(text, safe="")) <= _LONGEST:
        return text
    mark = hashlib.sha256(text.encode()).hexdigest()[:_SUFFIX]
    while len(quote(text, safe="")) > _LONGEST - len(mark) - 1:
        text = text[:-1]
    return f"{text}-{mark}"


def _with_duplicates(rows: list[Row]) -> list[Row]:
    """Rows with `duplicate_of` set; of equal pictures, the one that comes first is the original."""
    first: dict[str, str] = {}
    for row in rows:
        content = row.get("sha256") or ""
        row["duplicate_of"] = first.get(content, "") if content else ""
        if content:
            first.setdefault(content, row["id"])
    return rows
