"""The command that writes a page of a whole collection."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Collection as Names
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfflow.cli.options import Json, Stored

if TYPE_CHECKING:
    from lfflow.collection.collection import Collection
    from lfflow.collection.records import Record
    from lfflow.viz.report import ReportRow

_METADATA = (
    ("iso", "ISO", "{:.0f}"),
    ("exposure_time", "exposure", "{:.4g} s"),
    ("focal_length", "focal length", "{:.4g} m"),
    ("zoom_step", "zoom", "{:.0f}"),
    ("focus_step", "focus", "{:.0f}"),
)
_PAGE = "report.html"
_LATTICE = (
    ("dh", "dh, px", 1.0, "{:.5f}"),
    ("dv", "dv, px", 1.0, "{:.5f}"),
    ("theta", "θ, mrad", 1e3, "{:.5f}"),
    ("residual_rms", "rms, px", 1.0, "{:.4f}"),
)


def report(
    collection: Stored,
    *,
    out: Path | None = None,
    json_: Json = False,
) -> int:
    """Write a page that shows the whole collection.

    Parameters
    ----------
    out
        The page to write; report.html in the collection by default.
    """
    import lfflow
    from lfflow.collection import open_collection
    from lfflow.collection.storage import explain
    from lfflow.run.pictures import draw_missing
    from lfflow.viz.report import report_page

    opened = open_collection(collection)
    drawn, failed = draw_missing(opened)
    rows = report_rows(opened, drawn, _way_to(opened, out))
    made = f"lfflow {lfflow.__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    url = opened.storage.url
    text = report_page(url.rpartition("/")[2], url, rows, made=made)
    try:
        if out is None:
            opened.storage.write(_PAGE, text.encode())
        else:
            out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise explain(error) from error
    page = f"{url}/{_PAGE}" if out is None else str(out)
    document = json.dumps({"report": page, "captures": len(rows), "failed": failed})
    sys.stdout.write(f"{document if json_ else page}\n")
    for capture, reason in failed.items():
        sys.stderr.write(f"lfflow: no picture of {capture}: {reason}\n")
    return 0


def _way_to(collection: Collection, page: Path | None) -> str | None:
    """Relative path from a page to its collection; None where no browser would find it."""
    if page is None:
        return "."
    return None if "://" in collection.storage.url else os.path.relpath(collection.storage.url, page.parent)


def report_rows(collection: Collection, drawn: Names[str], way: str | None) -> list[ReportRow]:
    """Rows of the report from the catalogue and the ledger; `way` leads from the page to the collection."""
    from lfflow.run.pictures import picture_name
    from lfflow.viz.report import STAGES, ReportRow

    records = {stage: collection.ledger.records(stage) for stage in STAGES}
    rows = []
    for entry in collection.catalogue().to_dict("records"):
        capture = str(entry["id"])
        mine = {stage: found[capture] for stage, found in records.items() if capture in found}
        picture = picture_name(capture)
        rows.append(
            ReportRow(
                capture=capture,
                kind=str(entry["kind"]) or "unreadable",
                camera=" ".join(filter(None, (str(entry["camera_model"]), str(entry["camera_serial"])))),
                values={**_metadata(entry), **_lattice(mine)},
                states={stage: str(entry[f"{stage}_state"]) for stage in STAGES},
                seconds={stage: float(record.seconds) for stage, record in mine.items()},
                reason=str(entry["failure"]),
                picture=partial(collection.storage.read, picture) if capture in drawn else None,
                link=f"{way}/{picture}" if way is not None else "",
            )
        )
    return rows


def _metadata(entry: Mapping[Any, Any]) -> dict[str, str]:
    import pandas as pd

    time = entry["time"]
    shown = {"time (UTC)": "" if pd.isna(time) else f"{time:%Y-%m-%d %H:%M}"}
    for name, heading, form in _METADATA:
        shown[heading] = "" if pd.isna(entry[name]) else form.format(float(entry[name]))
    damage = {"damage that was accepted": str(entry["damaged"])} if entry["damaged"] else {}
    return {**shown, "white image": str(entry["white"]), **damage}


def _lattice(records: Mapping[str, Record]) -> dict[str, str]:
    """Lattice numbers of the calibration, or of the light field where the calibration is a white image's."""
    for stage in ("calibration", "lightfield"):
        if stage in records:
            scalars = records[stage].scalars
            return {heading: _number(scalars.get(name), factor, form) for name, heading, factor, form in _LATTICE}
    return {heading: "" for _, heading, _, _ in _LATTICE}


def _number(value: Any, factor: float, form: str) -> str:
    """Number of a ledger record as text; a record has null for NaN."""
    return "" if value is None else form.format(float(value) * factor)
