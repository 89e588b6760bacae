"""The whole lattice as the metadata predict it (METHOD 6.2.3): the lens array projected from the exit pupil."""

from __future__ import annotations

import math
from dataclasses import dataclass

import xarray as xr

from lfflow.lattice import Lattice

SENTINEL = 1000.0
"""Early firmware writes an exit pupil 10000 m away where it knows none: no magnification."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """What the metadata say of a lattice.

    Parameters
    ----------
    lattice
        Pitches, rotation and the place (cx, cy) of the array's own middle, sensor pixels; NaN where they are silent.
    gap, pupil
        f and Z: distances of the array from the sensor and of the exit pupil from the array, metres; the pupil is NaN
        where it is not known.
    """

    lattice: Lattice
    gap: float
    pupil: float

    @property
    def magnification(self) -> float:
        """1 + f/Z, or 1 where Z is not known."""
        return 1 + self.gap / self.pupil if math.isfinite(self.pupil) and math.isfinite(self.gap) else 1.0


def predict(raw: xr.Dataset) -> Prediction:
    """Lattice from `mla` and lens data: pitch p·(1 + f/Z), rotation, and the array's offset, magnified as the pitch.

    The projection magnifies about the optical axis, which is taken to meet the middle of the sensor.
    """

    def given(name: str) -> float:
        return float(raw[name]) if name in raw.coords else math.nan

    pupil = given("exit_pupil_offset")
    known = pupil if math.isfinite(pupil) and 0 < abs(pupil) < SENTINEL else math.nan
    frame = Prediction(Lattice(1, 1, 0, 0, 0), given("mla_offset_z"), known)
    pitch = given("lens_pitch") / given("pixel_pitch") * frame.magnification
    pixels = frame.magnification / given("pixel_pitch")
    lattice = Lattice(
        dh=pitch * given("mla_scale_x"),
        dv=pitch * given("mla_scale_y"),
        theta=given("mla_rotation"),
        cx=(raw.sizes["x"] - 1) / 2 + given("mla_offset_x") * pixels,
        cy=(raw.sizes["y"] - 1) / 2 + given("mla_offset_y") * pixels,
    )
    return Prediction(lattice, frame.gap, known)


def off_centre(estimate: Lattice, predicted: Lattice) -> tuple[float, float]:
    """Distance (right, down) of the nearest lens centre from the predicted place of one: C up to whole lenses."""
    if not (math.isfinite(predicted.cx) and math.isfinite(predicted.cy)):
        return math.nan, math.nan
    x, y = estimate.centres(*estimate.nearest(predicted.cx, predicted.cy))
    return float(x) - predicted.cx, float(y) - predicted.cy


def implied_pupil(pitch: float, gap: float, magnification: float, predicted_pitch: float) -> float:
    """Z, metres, that the magnification of a measured pitch asks for; inf where there is none."""
    excess = pitch / (predicted_pitch / magnification) - 1
    return gap / excess if excess != 0 else math.inf
