"""Sensor pixels that lie: hot and dead ones, which stick out of their eight same-colour neighbours, and clipped ones.

Neighbours of one colour are two pixels apart, where the light of a subimage differs by far more than any threshold
could bear. So a pixel is compared with what its neighbours would read at its own place: their values, divided by the
vignetting there and multiplied by that of the pixel.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

HOT, DEAD, SATURATED = 1, 2, 4

FAINT = 0.05
"""Vignetting below which a pixel says nothing about its neighbours, nor they whether it is dead."""
STEPS = {"white": 0.04, "scene": 0.12}
"""By how much, in radiance, a hot pixel must exceed what its neighbours suggest: even light, or detail."""
GRAIN = 4.0
"""The same in units of the typical difference of a pixel from what its neighbours suggest."""
SIGMAS = 5.0
"""By how many standard deviations the neighbours of a dead pixel must stand out of the dark."""

Float32Array = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]


def aberrant_pixels(
    radiance: Float32Array, vignetting: Float32Array, *, step: float = STEPS["scene"]
) -> tuple[ByteArray, npt.NDArray[np.bool_]]:
    """Pixels that stick out of their 8 same-colour neighbours, and those that were tested for being dead.

    A hot pixel exceeds the largest reading that its neighbours suggest by a tenth and a step, or the second largest
    by a tenth and two steps; where the picture is full of detail, a step is four typical differences of pixels from
    their neighbours. A dead one lies below a tenth of the second smallest, where that stands out of the noise of the
    dark: there nothing can be told. So one neighbour may be a defect as well, and a second pass leaves out those that
    the first has marked.

    Parameters
    ----------
    radiance
        Frame (y, x), 0 black level, 1 white level, not devignetted.
    vignetting
        Relative illumination (y, x), 1 at its peak.
    step
        Least excess of a hot pixel, radiance (`STEPS`).

    Returns
    -------
    flags, tested
        uint8 (y, x), 1 hot, 2 dead; bool (y, x), whether a dead pixel would have shown.
    """
    frame = np.ascontiguousarray(radiance, np.float32)
    shade = np.ascontiguousarray(vignetting, np.float32)
    flags, tested = np.zeros(frame.shape, np.uint8), np.zeros(frame.shape, np.bool_)
    even = np.full((frame.shape[0] + 4, frame.shape[1] + 4), np.nan, np.float32)
    _flatten(frame, shade, even)
    dark, grain = spread(frame, shade, even)
    least, tolerance = np.float32(SIGMAS * dark), np.float32(GRAIN * grain)
    for _ in range(2):
        _mark(frame, shade, even, np.float32(step), tolerance, least, flags, tested)
        even[2:-2, 2:-2][flags != 0] = np.nan
    return flags, tested


def spread(radiance: Float32Array, vignetting: Float32Array, even: Float32Array) -> tuple[float, float]:
    """Typical difference of pixels from what their neighbours suggest, as standard deviations of a normal law.

    Radiance, for the darkest tenth of the lit pixels; and as a share of the level, for the brighter half.
    """
    inside = (slice(2, -2, 7), slice(2, -2, 5))
    y, x = np.nonzero(vignetting[inside] >= 2 * FAINT)
    y, x = 7 * y + 4, 5 * x + 4
    around = np.stack([even[y + dy, x + dx] for dy in (-2, 0, 2) for dx in (-2, 0, 2) if dx or dy])
    known = np.isfinite(around)
    enough = known.sum(axis=0) >= 3
    if enough.sum() < 100:
        return float(radiance.max(initial=1.0)), 1.0
    level = np.where(known, around, 0).sum(axis=0)[enough] / known.sum(axis=0)[enough]
    level = level * vignetting[y - 2, x - 2][enough]
    difference = radiance[y - 2, x - 2][enough] - level
    dark = np.abs(difference[level <= np.quantile(level, 0.1)])
    bright = level > max(float(np.median(level)), 1e-6)
    grain = np.abs(difference[bright]) / level[bright]
    return 1.4826 * float(np.median(dark)), 1.4826 * float(np.median(grain)) if bright.any() else 1.0


def hot_in_dark(radiance: Float32Array, *, threshold: float = 0.03, sigmas: float = 8.0) -> ByteArray:
    """Flags (y, x), 1 where a dark frame is brighter than its median by `threshold` and by `sigmas` of its noise."""
    median = float(np.median(radiance))
    noise = 1.4826 * float(np.median(np.abs(radiance - median)))
    return (radiance > median + max(threshold, sigmas * noise)).astype(np.uint8)


@numba.njit(nogil=True, cache=True)
def _flatten(radiance, shade, even):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Radiance over vignetting into the inside of `even` (y + 2, x + 2), NaN where there is hardly any light."""
    for y in range(radiance.shape[0]):
        for x in range(radiance.shape[1]):
            if shade[y, x] >= np.float32(FAINT):
                even[y + 2, x + 2] = max(radiance[y, x], np.float32(0)) / shade[y, x]


@numba.njit(nogil=True, cache=True)
def _mark(radiance, shade, even, step, tolerance, least, flags, tested):  # type: ignore[no-untyped-def]  # pragma: no cover
    for y in range(radiance.shape[0]):
        for x in range(radiance.shape[1]):
            lowest, low, high, second = np.float32(np.inf), np.float32(np.inf), np.float32(0), np.float32(0)
            number = 0
            for i in range(y, y + 5, 2):
                for j in range(x, x + 5, 2):
                    reading = even[i, j]
                    if reading >= 0 and (i != y + 2 or j != x + 2):
                        number += 1
                        low = min(low, max(lowest, reading))
                        lowest = min(lowest, reading)
                        second = max(second, min(high, reading))
                        high = max(high, reading)
            value, mine = radiance[y, x], shade[y, x]
            most = np.float32(1.1) * max(mine, np.float32(2 * FAINT))
            bound = high * most + max(step, tolerance * high * mine)
            if number >= 3:
                bound = min(bound, second * most + 2 * max(step, tolerance * second * mine))
                tested[y, x] = mine >= np.float32(FAINT) and low * mine > least
            if value > bound:
                flags[y, x] = HOT
            elif tested[y, x] and value < np.float32(0.1) * low * mine:
                flags[y, x] = DEAD
