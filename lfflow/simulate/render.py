"""From a scene to the light on every sensor pixel, block of rows by block of rows."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from lfflow.lattice import Lattice
from lfflow.simulate import rays as kernels
from lfflow.simulate.optics import Optics, frame_of
from lfflow.simulate.scene import Scene

BLOCK_ROWS = 164
"""Sensor rows that share one stream of noise; part of what a seed means."""
THREADS = 2

FloatImage = npt.NDArray[np.float32]


def illumination(lattice: Lattice, optics: Optics, height: int, width: int) -> FloatImage:
    """Relative illumination (y, x) of an evenly lit sensor, 1 at the peak of the central subimages."""
    frame, profile = frame_of(lattice, height, width), optics.profile(lattice, height, width)
    light = np.empty((height, width), dtype=np.float32)
    over_rows(height, lambda a, b: kernels.illuminate(light[a:b], a, frame, profile))
    return light


def render(
    lattice: Lattice, scene: Scene, optics: Optics, cfa: npt.NDArray[np.int64], height: int, width: int
) -> FloatImage:
    """Linear levels (y, x) of every sensor pixel in its own colour, before noise."""
    frame, arrays, offsets = frame_of(lattice, height, width), scene.arrays(), optics.ray_offsets()
    levels = illumination(lattice, optics, height, width)
    over_rows(height, lambda a, b: kernels.expose(levels[a:b], a, frame, arrays, offsets, cfa))
    return blurred(levels, optics.crosstalk)


def blurred(levels: FloatImage, share: float) -> FloatImage:
    """Levels (y, x) after each pixel has lost `share` of its signal to its four neighbours."""
    if share == 0:
        return levels
    padded = np.pad(levels, 1, mode="edge")
    around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    return np.asarray((1 - share) * levels + share / 4 * around, dtype=np.float32)


def over_rows(height: int, work: Callable[[int, int], Any]) -> None:
    """Call ``work(first, last)`` for every block of rows, on a few threads."""
    starts = range(0, height, BLOCK_ROWS)
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(lambda start: work(start, min(start + BLOCK_ROWS, height)), starts))
