"""`lfflow report`."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

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
_LATTICE = (
    ("dh", "dh, px", 1.0, "{:.5f}"),
    ("dv", "dv, px", 1.0, "{:.5f}"),
    ("theta", "θ, mrad", 1e3, "{:.5f}"),
    ("residual_rms", "rms, px", 1.0, "{:.4f}"),
)


def report(
    collection: Path,
    *,
    out: Path | None = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Write a page that shows the whole collection.

    Parameters
    ----------
    collection
        Folder of the collection.
    out
        The page to write; report.html in the collection by default.
    json_
        Print one JSON document.
    """
    import lfflow
    from lfflow.cli.pictures import draw_collection
    from lfflow.collection import open_collection
    from lfflow.viz.report import report_page

    opened = open_collection(collection)
    pictures, failed = draw_collection(collection)
    rows = report_rows(opened, {path.stem: path for path in pictures})
    page = out or collection / "report.html"
    made = f"lfflow {lfflow.__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    page.write_text(report_page(collection.resolve().name, str(collection), rows, made=made), encoding="utf-8")
    if json_:
        sys.stdout.write(json.dumps({"report": str(page), "captures": len(rows), "failed": failed}) + "\n")
    else:
        sys.stdout.write(f"{page}\n")
    for capture, reason in failed.items():
        sys.stderr.write(f"lfflow: no picture of {capture}: {reason}\n")
    return 0


def report_rows(collection: Collection, pictures: Mapping[str, Path]) -> list[ReportRow]:
    """Rows of the report from the catalogue and the ledger."""
    from lfflow.viz.report import STAGES, ReportRow

    records = {stage: collection.ledger.records(stage) for stage in STAGES}
    rows = []
    for entry in collection.catalogue().to_dict("records"):
        capture = str(entry["id"])
        mine = {stage: found[capture] for stage, found in records.items() if capture in found}
        rows.append(
            ReportRow(
                capture=capture,
                kind=str(entry["kind"]) or "unreadable",
                camera=" ".join(filter(None, (str(entry["camera_model"]), str(entry["camera_serial"])))),
                values={**_metadata(entry), **_lattice(mine)},
                states={stage: str(entry[f"{stage}_state"]) for stage in STAGES},
                seconds={stage: float(record.seconds) for stage, record in mine.items()},
                reason=str(entry["failure"]),
                picture=pictures.get(capture),
            )
        )
    return rows


def _metadata(entry: Mapping[Any, Any]) -> dict[str, str]:
    import pandas as pd

    time = entry["time"]
    shown = {"time (UTC)": "" if pd.isna(time) else f"{time:%Y-%m-%d %H:%M}"}
    for name, heading, form in _METADATA:
        shown[heading] = "" if pd.isna(entry[name]) else form.format(float(entry[name]))
    return {**shown, "white image": str(entry["white"])}


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
