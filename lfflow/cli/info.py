"""`lfflow info`: what a file is."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

_WORDS = {
    "kind_of_frame": "frame", "byte_order": "byte order", "camera_model": "camera", "camera_serial": "serial number",
    "zoom_step": "zoom step", "focus_step": "focus step",
}  # fmt: skip
_TABLES = ("sections", "images", "metadata")


def info(
    file: str,
    *,
    json: Annotated[bool, Parameter(negative="")] = False,
    accept_damaged: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Say what a file is: kind, camera, sizes, sections and whether they are whole, metadata.

    Exit code 0 when all is well, 1 when the file is broken; for a folder 2 when something in it is.

    Parameters
    ----------
    file
        A file, a member of a calibration archive (data.C.0::MOD_0002.RAW), a folder of views, or any folder: then a
        table of what lies in it.
    json
        Print one JSON document.
    accept_damaged
        Show also what differs from its SHA-1, and what stands before a cut, without calling it an error.
    """
    from json import dumps

    from lfflow.formats.describe import describe, describe_folder
    from lfflow.formats.views import is_view_folder

    if Path(file).is_dir() and not is_view_folder(file):
        rows = list(describe_folder(file, accept_damaged=accept_damaged))
        sys.stdout.write(dumps(rows, indent=2) + "\n" if json else _table(rows))
        broken = [row for row in rows if row["kind"] == "broken" or (row.get("damaged") and not accept_damaged)]
        return 2 if broken else 0
    described = describe(file, accept_damaged=accept_damaged)
    sys.stdout.write(dumps(described, indent=2) + "\n" if json else _text(described))
    damaged = described.get("damaged") or []
    if damaged and not accept_damaged:
        sys.stderr.write(f"lfflow: {_shown(file)}: {_shown('; '.join(damaged))}\n")
        return 1
    return 0


def _text(described: dict[str, Any]) -> str:
    told = {key: value for key, value in described.items() if key not in _TABLES}
    if "holds" in told:
        told.pop("sizes", None)
    if told.get("damaged") == []:
        told["damaged"] = "no" if described.get("sections") else None
    lines = [
        f"{_WORDS.get(key, key):14} {_shown(value, key)}"
        for key, value in told.items()
        if value is not None and value != ""
    ]
    for key in ("sections", "images"):
        if described.get(key):
            lines += ["", *_columns(described[key])]
    if "metadata" in described:
        lines += ["", *_metadata(described["metadata"])]
    return "\n".join(lines) + "\n"


def _metadata(values: dict[str, Any]) -> list[str]:
    from lfflow.schema import RAW

    rows = []
    for name, value in values.items():
        variable = RAW[name]
        units = "" if variable.units in ("", "1") or value is None else f" {variable.units}"
        matrix = isinstance(value, list) and isinstance(value[0], list)
        first, *others = [_shown(row) for row in value] if matrix else [_shown(value, name)]
        rows.append({"metadata": name, "value": first + units, "meaning": variable.long_name})
        rows += [{"metadata": " ", "value": row, "meaning": " "} for row in others]
    return _columns(rows)


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
            "size": row.get("holds") or row.get("sizes"),
            "state": _state(row),
        }
        for row in rows
    ]
    return "\n".join(_columns(short)) + "\n" if short else "nothing\n"


def _state(row: dict[str, Any]) -> str:
    if "error" in row:
        # The error begins with the path, which the row shows already.
        return str(row["error"]).removeprefix(f"{row['path']}: ")
    unreadable = (row.get("holds") or {}).get("unreadable")
    if unreadable:
        return f"{unreadable} unreadable"
    return "; ".join(row.get("damaged") or []) or ("-" if row["kind"] == "folder" else "right")


def _columns(rows: Sequence[dict[str, Any]]) -> list[str]:
    table = [list(rows[0])] + [[_shown(value, key) for key, value in row.items()] for row in rows]
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]


def _shown(value: Any, key: str = "") -> str:
    if value is None or value == [] or value == "" or value == {}:
        return "-"
    if isinstance(value, dict):
        return ", ".join(_pair(name, item) for name, item in value.items())
    if isinstance(value, list):
        return _joined([_shown(item) for item in value])
    if isinstance(value, float):
        return f"{value:.7g}"
    text = str(value)
    if key == "time":
        text = text.partition(".")[0].replace("T", " ") + " UTC"
    if key == "bytes":
        text = f"{value} ({value / 1e6:.1f} MB)" if value >= 1e6 else text
    # Texts come from the file: control characters are spelt out.
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


def _pair(name: str, item: Any) -> str:
    if isinstance(item, dict):
        return f"{name} ({_shown(item)})"
    return f"{_shown(name)} {_shown(item)}"


def _joined(parts: list[str]) -> str:
    """Parts side by side; said once where all are the same."""
    return f"{parts[0]} (each)" if len(parts) > 1 and len(set(parts)) == 1 else ", ".join(parts)
