"""A page that shows a whole collection: self-contained HTML, readable without a network."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from urllib.parse import quote

THUMBNAIL_WIDTH = 460
STAGES = ("calibration", "lightfield", "disparity")

_STYLE = """
:root { --ink: #22262b; --soft: #6a7078; --line: #e3e5e8; --paper: #fff; --ground: #f5f6f7; --good: #1b7f4b;
        --bad: #b3261e; --wait: #9a6b00; }
@media (prefers-color-scheme: dark) { :root { --ink: #e7e9ec; --soft: #9aa1a9; --line: #343a41; --paper: #1d2125;
        --ground: #15181b; --good: #5cc98f; --bad: #ff8a80; --wait: #e0b64f; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink); font: 15px/1.45 system-ui, sans-serif; }
main { max-width: 1280px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { font-size: 28px; margin: 0 0 4px; } h2 { font-size: 19px; margin: 36px 0 12px; }
.soft { color: var(--soft); } code { font-size: 13px; overflow-wrap: anywhere; }
.numbers { display: flex; flex-wrap: wrap; gap: 12px; margin: 20px 0 0; }
.numbers div { background: var(--paper); border: 1px solid var(--line); border-radius: 8px; padding: 10px 16px; }
.numbers b { display: block; font-size: 22px; font-variant-numeric: tabular-nums; }
.wide { overflow-x: auto; background: var(--paper); border: 1px solid var(--line); border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; }
th, td { text-align: left; padding: 7px 12px; border-bottom: 1px solid var(--line); white-space: nowrap;
         font-variant-numeric: tabular-nums; }
td.reason { white-space: normal; min-width: 16em; }
th { color: var(--soft); font-weight: 600; } tr:last-child td { border-bottom: 0; }
.done { color: var(--good); } .failed, .unreadable { color: var(--bad); } .pending, .duplicate { color: var(--wait); }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(360px, 1fr)); gap: 16px; }
.cards figure { margin: 0; background: var(--paper); border: 1px solid var(--line); border-radius: 8px;
                overflow: hidden; }
.cards img { display: block; width: 100%; background: #fff; } figcaption { padding: 8px 14px; font-weight: 600; }
"""


@dataclass(frozen=True, slots=True)
class ReportRow:
    """One input file in a report.

    Parameters
    ----------
    capture, kind
        Id; scene, white, dark, or empty when it cannot be read.
    camera
        Model and serial number.
    values
        What else is known, as text by column heading; lattice numbers come here too.
    states, seconds
        State and duration of every stage.
    reason
        Why it failed.
    picture, link
        What reads its quicklook, a PNG; where the page links to.
    """

    capture: str
    kind: str
    camera: str
    values: Mapping[str, str] = field(default_factory=dict)
    states: Mapping[str, str] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""
    picture: Callable[[], bytes] | None = None
    link: str = ""


def report_page(title: str, where: str, rows: Sequence[ReportRow], *, made: str = "") -> str:
    """HTML page with the numbers of a collection, its pictures, and a table of its captures.

    Parameters
    ----------
    title, where
        Heading, and the place of the collection.
    rows
        One per input file.
    made
        Versions and time, for the foot of the page.
    """
    shown = [row for row in rows if row.picture is not None]
    cards = "".join(_card(row) for row in shown)
    body = [
        f"<h1>{html.escape(title)}</h1><div class=soft><code>{html.escape(where)}</code></div>",
        _numbers(rows),
        f"<h2>Captures</h2><div class=cards>{cards}</div>" if shown else "",
        "<h2>Files and stages</h2>",
        _table(rows),
        f"<p class=soft>{html.escape(made)}</p>" if made else "",
    ]
    return (
        "<!doctype html>\n<html lang=en><head><meta charset=utf-8>"
        '<meta name=viewport content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><main>{''.join(body)}</main></body></html>\n"
    )


def thumbnail(picture: bytes, width: int = THUMBNAIL_WIDTH) -> str:
    """A PNG as a small JPEG in a data URL; empty when it is no picture."""
    import cv2
    import numpy as np

    image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR) if picture else None
    if image is None:
        return ""
    height = round(image.shape[0] * width / image.shape[1])
    small = cv2.resize(image, (2 * width, 2 * height), interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 82])[1].tobytes()
    return f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"


def _numbers(rows: Sequence[ReportRow]) -> str:
    scenes = [row for row in rows if row.kind == "scene"]
    done = sum(row.states.get("disparity") == "done" for row in scenes)
    failed = sum(bool(row.reason) for row in rows)
    seconds = sum(sum(row.seconds.values()) for row in rows)
    numbers = (
        (len(rows), "files"),
        (sum(row.kind == "white" for row in rows), "white images"),
        (f"{done} of {len(scenes)}", "disparity maps"),
        (failed, "failed"),
        (f"{seconds:.1f} s", "of work"),
    )
    return f"<div class=numbers>{''.join(f'<div><b>{value}</b>{name}</div>' for value, name in numbers)}</div>"


def _card(row: ReportRow) -> str:
    assert row.picture is not None  # noqa: S101 - only rows with a picture come here
    picture = f'<img alt="{html.escape(row.capture, quote=True)}" src="{thumbnail(row.picture())}">'
    if row.link:
        picture = f'<a href="{html.escape(quote(row.link), quote=True)}">{picture}</a>'
    return f"<figure>{picture}<figcaption>{html.escape(row.capture)}</figcaption></figure>"


def _table(rows: Sequence[ReportRow]) -> str:
    columns = list(dict.fromkeys(name for row in rows for name in row.values))
    reasons = any(row.reason for row in rows)
    head = ["capture", "kind", "camera", *columns, *STAGES, *(["reason"] if reasons else [])]
    lines = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    body = "".join(f"<tr>{_cells(row, columns, reasons=reasons)}</tr>" for row in rows)
    return f"<div class=wide><table><thead><tr>{lines}</tr></thead><tbody>{body}</tbody></table></div>"


def _cells(row: ReportRow, columns: Sequence[str], *, reasons: bool) -> str:
    plain = [row.capture, row.kind, row.camera, *(row.values.get(name, "") for name in columns)]
    cells = [f"<td>{html.escape(text)}</td>" for text in plain]
    for stage in STAGES:
        state, seconds = row.states.get(stage, ""), row.seconds.get(stage)
        text = html.escape(state) + (f" <span class=soft>{seconds:.2f} s</span>" if seconds is not None else "")
        cells.append(f'<td class="{html.escape(state, quote=True)}">{text}</td>')
    if reasons:
        cells.append(f'<td class="reason failed">{html.escape(row.reason)}</td>')
    return "".join(cells)
