"""How much memory a task needs: a model of what its stages hold, from the size of the camera and the parameters.

Measured against real runs by benchmarks/collection.py; a test holds the measured peak below 1.2 times the estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lfflow.collection.scalars import is_region
from lfflow.schema import Schema

if TYPE_CHECKING:
    from lfflow.run.chain import Grid

SLACK = 40 << 20
"""What no size explains: the interpreter's own objects, and what the allocator does not give back."""
WRITE_COPIES = 3
"""Copies of the largest array while it is written: rounded, compressed, and the shard that is put together."""
_PAIRS = 8
"""Pairs of views that the first pass of the matching meets on a Bayer sensor: two distances on four sides."""
_PITCH = 10.0
"""Lens pitch that is assumed for a camera without metadata, sensor pixels; the largest subimage costs most."""


@dataclass(frozen=True, slots=True)
class Extent:
    """Size of one capture: sensor pixels, lenses of its grid, views; and whether it is a scene or a white image."""

    pixels: int
    lenses: int
    views: int
    scene: bool = True

    @property
    def samples(self) -> int:
        """Samples of the light field."""
        return self.lenses * self.views


def extent_of(height: int, width: int, grid: Grid | None, *, scene: bool) -> Extent:
    """Extent of a capture; of an unknown camera, that of a common lens pitch."""
    if grid is None:
        lenses = height * width / (_PITCH * _PITCH * 0.866)
        return Extent(height * width, round(lenses), 11 * 11, scene)
    return Extent(height * width, grid.rows * grid.columns, (2 * grid.radius + 1) ** 2, scene)


def result_bytes(schema: Schema, extent: Extent) -> int:
    """Bytes of a result in memory."""
    return sum(_array_bytes(schema, extent))


def writing_bytes(schema: Schema, extent: Extent) -> int:
    """Bytes that writing a result takes beside the result itself."""
    return WRITE_COPIES * max(_array_bytes(schema, extent), default=0)


def _array_bytes(schema: Schema, extent: Extent) -> list[int]:
    return [
        np.dtype(variable.dtype).itemsize * (extent.pixels if "y" in variable.dims else extent.samples)
        for variable in schema.variables
        if is_region(variable)
    ]


def calibration_work(extent: Extent, parameters: Mapping[str, Any]) -> int:  # noqa: ARG001
    """Bytes of the calibration with its result: float images of the sensor, one more where the scene is divided out."""
    return 4 * extent.pixels * (7 if extent.scene else 6)


def lightfield_work(extent: Extent, parameters: Mapping[str, Any]) -> int:  # noqa: ARG001
    """Bytes of the light field alone: mosaic, colour and weight of every sample."""
    return 9 * extent.samples


def disparity_work(extent: Extent, parameters: Mapping[str, Any]) -> int:
    """Bytes of the matching with its result.

    A copy of the field without its gaps and its root, and then the larger of the cost volumes of the first pass (a
    volume per pair, twice while they are put together) and of the second (a volume per side of the aperture, the fused
    one and those of the paths); or the disparity of every view. The range of disparities is not known before: the
    widest that the defaults search is assumed.
    """
    from lfflow.kernels.mosaicked.match_field import LONGEST, SECOND_STEP, WIDEST_RANGE

    given = parameters.get("disparity", {})
    labels = given.get("hypotheses")
    reach = (max(labels) - min(labels)) / 2 if labels else WIDEST_RANGE
    first = len(labels) if labels else round(4 * WIDEST_RANGE * LONGEST) + 1
    pairs = len(given["pairs"]) if given.get("pairs") else _PAIRS
    copies = 2 if given.get("fusion", "opposite") in ("trimmed", "mean", "opposite") else 4
    second = max(first, round((2 * reach + 0.2) / SECOND_STEP) + 1)
    volumes = 4 * extent.lenses * max(copies * pairs * first, (copies + 5) * second)
    return 13 * extent.samples + max(volumes, 9 * extent.samples)
