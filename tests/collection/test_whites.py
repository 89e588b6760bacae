"""Which white image a scene gets, and that the limit is where a white image is no better than the picture itself."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from lfflow.collection.catalogue import frame
from lfflow.collection.whites import FOCUS_SHARE, MAX_STEPS, SELF, candidates, choose, reason
from lfflow.simulate.body import BODIES, Body, Setting

OWN_LATTICE_RMS = 0.1
"""Error that is allowed to the lattice of a picture without a white image, pixels."""


def row(name: str, kind: str, zoom: float, focus: float = 500.0, **others: object) -> dict[str, object]:
    known = {"id": name, "kind": kind, "zoom_step": zoom, "focus_step": focus, "camera_serial": "A1", "group": "F01"}
    return {**known, "temperature": 20.0, "time": pd.Timestamp("2020-01-01"), **others}


def chosen(*rows: dict[str, object], **options: float) -> tuple[str, float]:
    table = choose(frame(list(rows)), **options).set_index("id")
    return str(table.loc["S", "white"]), float(table.loc["S", "white_distance"])


def rms_shift(body: Body, one: Setting, other: Setting) -> float:
    """rms over the sensor of how far the lens centres move, from the pitch p·(1 + f/Z) alone."""
    change = body.offset[2] / body.exit_pupil_offset(one) - body.offset[2] / body.exit_pupil_offset(other)
    return abs(change) * math.sqrt((body.model.height**2 + body.model.width**2) / 12)


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_the_limit_is_where_the_lattice_has_moved_by_the_error_of_the_pictures_own(body: Body) -> None:
    ends = sorted((body.wide[0], body.tele[0]))
    zooms = np.arange(ends[0], ends[1] - MAX_STEPS + 1, 10)
    shifts = [rms_shift(body, Setting(zoom), Setting(zoom + MAX_STEPS)) for zoom in zooms]
    assert max(shifts) < OWN_LATTICE_RMS
    assert max(shifts) > 0.7 * OWN_LATTICE_RMS, "no tighter than needed"
    focus = [rms_shift(body, Setting(zoom, 0), Setting(zoom, MAX_STEPS / FOCUS_SHARE)) for zoom in zooms]
    assert max(focus) < OWN_LATTICE_RMS


def test_zoom_counts_before_focus_before_temperature_before_time() -> None:
    scene = row("S", "scene", 500)
    assert chosen(scene, row("A", "white", 510, 500), row("B", "white", 505, 900))[0] == "B"
    assert chosen(scene, row("A", "white", 500, 520), row("B", "white", 500, 510, temperature=40.0))[0] == "B"
    later = {"time": pd.Timestamp("2021-01-01")}
    assert chosen(scene, row("A", "white", 500, temperature=22.0), row("B", "white", 500, **later))[0] == "B"
    assert chosen(scene, row("A", "white", 500, **later), row("B", "white", 500))[0] == "B"


def test_distance_is_recorded_in_motor_steps() -> None:
    assert chosen(row("S", "scene", 500, 500), row("A", "white", 530, 540)) == ("A", 50.0)


def test_only_white_images_of_the_same_camera_serve() -> None:
    scene = row("S", "scene", 500)
    other, broken = row("A", "white", 500, camera_serial="A2"), row("B", "white", 500, reason="cut short")
    assert chosen(scene, other, broken)[0] == SELF
    assert chosen(scene, other, broken, row("C", "white", 590))[0] == "C"


def test_a_white_image_beyond_the_limit_leaves_the_scene_to_itself() -> None:
    scene = row("S", "scene", 500)
    white, distance = chosen(scene, row("A", "white", 500 + MAX_STEPS + 1))
    assert (white, math.isnan(distance)) == (SELF, True)
    assert chosen(scene, row("A", "white", 500 + MAX_STEPS))[0] == "A"
    assert chosen(scene, row("A", "white", 900), max_steps=1000)[0] == "A"
    assert chosen(scene, row("A", "white", 500, 1500))[0] == "A", "focus hardly moves the lattice"
    assert chosen(scene, row("A", "white", 500, 99_000), row("B", "white", 501))[0] == "B"


def test_unknown_settings_are_no_obstacle_but_come_last() -> None:
    scene, unknown = row("S", "scene", 500), row("A", "white", math.nan, math.nan)
    assert chosen(scene, unknown)[0] == "A"
    assert chosen(scene, unknown, row("B", "white", 590))[0] == "B"


def test_reasons_name_what_decided() -> None:
    def told(*rows: dict[str, object]) -> str:
        table = choose(frame(list(rows)))
        scene = table[table["id"] == "S"].iloc[0]
        return reason(scene, candidates(scene, table))

    scene = row("S", "scene", 500)
    assert told(scene, row("A", "white", 510), row("B", "white", 590)) == "the nearest of 2 white images of this camera"
    assert "A, is 300 zoom steps away" in told(scene, row("A", "white", 800))
    assert "no readable white image of camera A1" in told(scene)
    (listed,) = candidates(pd.Series(scene), frame([row("A", "white", 510, math.nan)]))
    assert str(listed) == "A: zoom 10 and focus unknown steps away, 0 K, 0 h"
