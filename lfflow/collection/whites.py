"""Which white image calibrates which scene.

Zoom and focus move the exit pupil and with it the subimages, whose pitch is p·(1 + f/Z) (METHOD 6.2.3). Over the zoom
ranges of both known cameras that moves the lens centres by at most 9.5e-4 px rms a zoom step, and by 2.1e-5 px a focus
step (`tests/collection/test_whites.py` derives both). A picture's own lattice is good to about 0.1 px rms, so a white
image serves while its lattice is off by less: `MAX_STEPS` zoom steps, of which a focus step makes `FOCUS_SHARE`.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import pandas as pd

SELF = "self"
MAX_STEPS = 100.0
"""Zoom steps beyond which a white image's lattice is worse than that of the picture itself."""
FOCUS_SHARE = 1 / 45
"""How far a focus step moves the lens centres, in zoom steps."""


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

    @property
    def lattice_steps(self) -> float:
        """How far the lens centres have moved, in zoom steps; what is not known is taken to be equal."""
        zoom, focus = (0.0 if math.isnan(number) else number for number in (self.zoom, self.focus))
        return zoom + FOCUS_SHARE * focus

    def __str__(self) -> str:
        zoom, focus, temperature, hours = (
            "unknown" if math.isnan(number) else f"{round(number, 1):g}"
            for number in (self.zoom, self.focus, self.temperature, self.hours)
        )
        return f"{self.capture}: zoom {zoom} and focus {focus} steps away, {temperature} K, {hours} h"


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


def choose(table: pd.DataFrame, *, max_steps: float = MAX_STEPS, excluded: Collection[str] = ()) -> pd.DataFrame:
    """Catalogue with the columns `white` and `white_distance` set for every scene.

    Parameters
    ----------
    max_steps
        How far the settings of a white image may be from the scene's, in zoom steps (a focus step counts
        `FOCUS_SHARE`); beyond, the scene calibrates itself.
    excluded
        White images whose own calibration failed.
    """
    table = table.copy()
    chosen, distances = [], []
    for _, row in table.iterrows():
        usable = row["kind"] == "scene" and not row["reason"]
        found = candidates(row, table, excluded) if usable else []
        near = next((candidate for candidate in found if candidate.lattice_steps <= max_steps), None)
        chosen.append(near.capture if near else (SELF if usable else ""))
        distances.append(near.distance if near else math.nan)
    table["white"] = pd.Series(chosen, dtype="str", index=table.index)
    table["white_distance"] = pd.Series(distances, dtype="float64", index=table.index)
    return table


def reason(scene: pd.Series, found: list[Candidate]) -> str:
    """Why a scene is calibrated as the catalogue says: one sentence for `lfflow status --why`."""
    white = str(scene["white"])
    chosen = next((candidate for candidate in found if candidate.capture == white), None)
    if chosen is not None:
        if chosen is found[0]:
            return f"the nearest of {len(found)} white images of this camera"
        return f"{found[0].capture} is nearer, but too far in focus or its own calibration failed"
    if white != SELF:
        return "not chosen yet"
    if not found:
        return f"calibrated on itself: no readable white image of camera {scene['camera_serial'] or 'unknown'}"
    steps = found[0].lattice_steps
    return (f"calibrated on itself: the nearest white image, {found[0].capture}, is {steps:.0f} zoom steps away "
            "(focus counted), farther than [whites] max_steps, or its own calibration failed")  # fmt: skip
