"""Which white image calibrates which scene."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import pandas as pd

SELF = "self"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A white image and how far its settings are from the scene's; unknown differences are NaN."""

    capture: str
    zoom: float
    focus: float
    temperature: float
    hours: float

    @property
    def rank(self) -> tuple[float, float, float, float, str]:
        """Sort key: zoom first, then focus, temperature and time; the unknown last."""
        numbers = (self.zoom, self.focus, self.temperature, self.hours)
        zoom, focus, temperature, hours = (math.inf if math.isnan(number) else number for number in numbers)
        return zoom, focus, temperature, hours, self.capture

    @property
    def distance(self) -> float:
        """Distance in motor steps, zoom and focus together; NaN when neither is known."""
        known = [number for number in (self.zoom, self.focus) if not math.isnan(number)]
        return math.hypot(*known) if known else math.nan

    def __str__(self) -> str:
        return (f"{self.capture}: zoom {self.zoom:g} and focus {self.focus:g} steps away, {self.temperature:g} K, "
                f"{self.hours:.1f} h")  # fmt: skip


def candidates(scene: pd.Series, table: pd.DataFrame, excluded: Collection[str] = ()) -> list[Candidate]:
    """White images of the scene's camera that could be read, nearest settings first."""
    whites = table[
        (table["kind"] == "white")
        & (table["reason"] == "")
        & (table["duplicate_of"] == "")
        & (table["camera_serial"] == scene["camera_serial"])
        & (table["group"] == scene["group"])
        & ~table["id"].isin(list(excluded))
    ]
    found = [
        Candidate(
            str(white["id"]),
            abs(white["zoom_step"] - scene["zoom_step"]),
            abs(white["focus_step"] - scene["focus_step"]),
            abs(white["temperature"] - scene["temperature"]),
            abs((white["time"] - scene["time"]).total_seconds()) / 3600,
        )
        for _, white in whites.iterrows()
    ]
    return sorted(found, key=lambda candidate: candidate.rank)


def choose(table: pd.DataFrame, *, max_steps: float = math.inf, excluded: Collection[str] = ()) -> pd.DataFrame:
    """Catalogue with the columns `white` and `white_distance` set for every scene.

    Parameters
    ----------
    max_steps
        Largest distance in motor steps at which a white image still serves; beyond, the scene calibrates itself.
    excluded
        White images whose own calibration failed.
    """
    table = table.copy()
    chosen, distances = [], []
    for _, row in table.iterrows():
        usable = row["kind"] == "scene" and not row["reason"]
        found = candidates(row, table, excluded) if usable else []
        near = bool(found) and not found[0].distance > max_steps
        chosen.append(found[0].capture if near else (SELF if usable else ""))
        distances.append(found[0].distance if near else math.nan)
    table["white"] = pd.Series(chosen, dtype="str", index=table.index)
    table["white_distance"] = pd.Series(distances, dtype="float64", index=table.index)
    return table
