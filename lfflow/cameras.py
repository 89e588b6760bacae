"""The camera models that lfflow knows by name, and the one shape that all light fields of a model share."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfflow.lattice import Lattice

MAX_ROTATION = 0.01
"""Largest rotation (rad) at which the grid of a camera model still covers the corners of its sensor."""


@dataclass(frozen=True, slots=True)
class CameraModel:
    """What is the same for all cameras of one model.

    Parameters
    ----------
    name
        Model name in the camera's own metadata ("F01", "B01").
    height, width
        Sensor size in pixels.
    pitch
        Nominal lens pitch in sensor pixels: lens pitch / pixel pitch, rounded down over the known cameras.
    """

    name: str
    height: int
    width: int
    pitch: float

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns (t, s) of every light field of this model."""
        return Lattice(self.pitch, self.pitch, MAX_ROTATION, 0.0, 0.0).grid_shape(self.height, self.width)

    @property
    def view_radius(self) -> int:
        """Views run over −r…r in u and v."""
        return view_radius(self.pitch)


def view_radius(pitch: float) -> int:
    """Largest view offset, sensor pixels, that lies inside a subimage of the given pitch."""
    return math.floor(pitch / 2 + 0.5)


F01 = CameraModel("F01", height=3280, width=3280, pitch=9.92)
ILLUM = CameraModel("B01", height=5368, width=7728, pitch=14.28)
KNOWN_CAMERAS = {camera.name: camera for camera in (F01, ILLUM)}
