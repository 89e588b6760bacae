"""Dark images: the bad pixels that they show are left out of every picture of their camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

MOST = 8
"""More dark images than this tell nothing new about a sensor."""


@dataclass(frozen=True, slots=True)
class Dark:
    """The file of a dark image as it was scanned."""

    path: str
    size: int
    mtime_ns: int
    sha256: str


def darks_by_camera(table: pd.DataFrame) -> Mapping[tuple[str, str], tuple[Dark, ...]]:
    """Dark images of every (group, serial number) of a catalogue."""
    usable = table[(table["kind"] == "dark") & (table["reason"] == "") & (table["duplicate_of"] == "")]
    found: dict[tuple[str, str], tuple[Dark, ...]] = {}
    for (group, serial), rows in usable.reset_index(drop=True).sort_values("id").groupby(["group", "camera_serial"]):
        files = rows[["path", "size", "mtime_ns", "sha256"]].head(MOST).itertuples(index=False)
        found[str(group), str(serial)] = tuple(Dark(str(p), int(s), int(m), str(h)) for p, s, m, h in files)
    return found
