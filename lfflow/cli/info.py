"""`lfflow info`: what a file is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter


def info(
    file: str,
    *,
    json: Annotated[bool, Parameter(negative="")] = False,
    accept_damaged: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Say what a file is: kind, camera, sizes, sections and whether they are whole, metadata.

    Parameters
    ----------
    file
        A file, a member of a calibration archive (data.C.0::MOD_0002.RAW), a folder of views, or any folder: then a
        table of what lies in it.
    json
        Print one JSON document.
    accept_damaged
        Show also what differs from its SHA-1, without calling it an error.
    """
    from json import dumps

    from lfflow.formats.describe import describe, describe_folder
    from lfflow.formats.views import is_view_folder

    if Path(file).is_dir() and not is_view_folder(file):
        rows = describe_folder(file, accept_damaged=accept_damaged)
        sys.stdout.write(dumps(rows, indent=2) + "\n" if json else _table(rows))
        broken = [row for row in rows if row["kind"] == "broken" or (row.get("damaged") and not accept_damaged)]
        return 2 if broken else 0
    described = describe(file, accept_damaged=accept_damaged)
    sys.stdout.write(dumps(described, indent=2) + "\n" if json else _text(described))
    damaged = described.get("damaged") or []
    if damaged and not accept_damaged:
        sys.stderr.write(f"lfflow: {file}: {'; '.join(damaged)}\n")
        return 1
    return 0


def _text(described: dict[str, Any]) -> str:
    lines = []
    for key, value in described.items():
        if key in ("sections", "images", "metadata"):
            continue
        lines.append(f"{key:16} {_shown(value)}")
    for key in ("sections", "images"):
        rows = described.get(key)
        if rows:
            lines += ["", *_columns(rows)]
    if "metadata" in described:
        lines += ["", *(f"  {key:18} {_shown(value)}" for key, value in described["metadata"].items())]
    return "\n".join(lines) + "\n"


def _table(rows: list[dict[str, Any]]) -> str:
    short = [
        {
            "name": Path(row["path"]).name,
            "kind": row["kind"],
            "frame": row.get("kind_of_frame"),
            "camera": row.get("camera_model"),
            "serial": row.get("camera_serial"),
            "zoom": row.get("zoom_step"),
            "focus": row.get("focus_step"),
            "sizes": row.get("sizes"),
            "state": row.get("error") or "; ".join(row.get("damaged") or []) or "right",
        }
        for row in rows
    ]
    return "\n".join(_columns(short)) + "\n" if short else "nothing\n"


def _columns(rows: list[dict[str, Any]]) -> list[str]:
    table = [list(rows[0])] + [[_shown(value) for value in row.values()] for row in rows]
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]


def _shown(value: Any) -> str:
    if value is None or value == [] or value == "":
        return "-"
    if isinstance(value, dict):
        return " ".join(f"{key} {size}" for key, size in value.items())
    if isinstance(value, list):
        return ", ".join(_shown(item) for item in value)
    # Texts come from the file: control characters are spelt out.
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in str(value))
