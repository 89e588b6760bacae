"""Which white image calibrates which scene.

Zoom and focus move the exit pupil and with it the subimages, whose pitch is p·(1 + f/Z) (METHOD 6.2.3). Over the zoom
ranges of both known cameras that moves the lens centres by at most 9.5e-4 px rms a zoom step, and by 2.1e-5 px a focus
step (`tests/collection/test_whites.py` derives both). A picture's own lattice is good to about 0.1 px rms, so a white
image serves while its lattice is off by less: `MAX_STEPS` zoom steps, of which a focus step makes `FOCUS_SHARE`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

SELF = "self"
_CAMERA = ["camera_serial", "group"]
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
    whites = _usable_whites(table, excluded)
    whites = whites[(whites[_CAMERA] == scene[_CAMERA]).all(axis=1)]
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
    scenes = (table["kind"] == "scene") & (table["reason"] == "")
    chosen = np.where(scenes, SELF, "").astype(object)
    distances = np.full(len(table), math.nan)
    usable = _usable_whites(table, excluded)
    whites = dict(iter(usable.groupby(_CAMERA)))
    for camera, members in table[scenes].groupby(_CAMERA):
        if camera in whites:
            for place, (index, distance) in zip(np.flatnonzero(table.index.isin(members.index)),
                                                _nearest(members, whites[camera], max_steps), strict=True):  # fmt: skip
                if index >= 0:
                    chosen[place] = str(whites[camera]["id"].iloc[index])
                    distances[place] = distance
    table["white"] = pd.Series(chosen, dtype="str", index=table.index)
    table["white_distance"] = pd.Series(distances, dtype="float64", index=table.index)
    return table


def _usable_whites(table: pd.DataFrame, excluded: Collection[str]) -> pd.DataFrame:
    """White images that could be read and whose calibration has not failed."""
    usable = (table["kind"] == "white") & (table["reason"] == "") & (table["duplicate_of"] == "")
    return table[usable & ~table["id"].isin(list(excluded))]


def _nearest(scenes: pd.DataFrame, whites: pd.DataFrame, max_steps: float) -> Iterator[tuple[int, float]]:
    """For every scene the place of its white image (-1: none is near enough) and its distance; as `candidates` ranks.

    Ten thousand scenes with a hundred white images take a second: hence no `Candidate` for each pair.
    """
    settings = [
        (scenes[name].to_numpy(), whites[name].to_numpy()) for name in ("zoom_step", "focus_step", "temperature")
    ]
    seconds = [table["time"].astype("int64").where(table["time"].notna()).to_numpy(float) for table in (scenes, whites)]
    ids = whites["id"].astype("str").to_numpy(dtype=object).argsort(kind="stable").argsort()
    for scene in range(len(scenes)):
        known = [np.abs(of_whites - of_scenes[scene]) for of_scenes, of_whites in [*settings, tuple(seconds)]]
        zoom, focus, temperature, time = (np.where(np.isnan(numbers), math.inf, numbers) for numbers in known)
        steps = np.nan_to_num(known[0]) + FOCUS_SHARE * np.nan_to_num(known[1])
        order = np.lexsort((ids, time, temperature, focus, zoom))
        near = order[steps[order] <= max_steps]
        if not near.size:
            yield -1, math.nan
            continue
        pair = np.array([known[0][near[0]], known[1][near[0]]])
        yield int(near[0]), math.nan if np.isnan(pair).all() else float(np.sqrt(np.nansum(pair**2)))


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
