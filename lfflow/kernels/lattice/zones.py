"""Mean subimages of the zones of a sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.lattice.lens_light import Cell, Flags, FloatArray, FloatImage, border

ZONES = 5
"""Zones along each side of the sensor."""
CELLS = 12
"""Bins of a zone's mean subimage per lens pitch."""


@dataclass(frozen=True, slots=True)
class Zones:
    """Mean subimages of the zones of a sensor: bins that hold light, one row each.

    Parameters
    ----------
    dx, dy, value, weight
        Mean offset from the lens centre (px), mean value, number of pixels: shape (n,).
    zone, bin
        Zone of each bin, and which of those of its subimage it is, (n,).
    centres
        Mean lens centre of each zone, (zones, 2).
    """

    dx: FloatArray
    dy: FloatArray
    value: FloatArray
    weight: FloatArray
    zone: npt.NDArray[np.int64]
    bin: npt.NDArray[np.int64]
    centres: FloatArray


@numba.njit(nogil=True, cache=True)
def _accumulate(
    image: FloatImage,
    flags: Flags,
    centres: FloatArray,
    zones: npt.NDArray[np.int64],
    cell: Cell,
    step: float,
    total: FloatArray,
) -> None:
    half = total.shape[1] // 2
    reach = half * step
    for lens in range(centres.shape[0]):
        x, y = centres[lens, 0], centres[lens, 1]
        for j in range(max(int(y - reach) + 1, 0), min(int(y + reach) + 1, image.shape[0])):
            for i in range(max(int(x - reach) + 1, 0), min(int(x + reach) + 1, image.shape[1])):
                dx, dy = i - x, j - y
                if border(dx, dy, cell)[0] < 0.0 or flags[j, i] != 0:
                    continue
                row, column = int(np.rint(dy / step)) + half, int(np.rint(dx / step)) + half
                if 0 <= row < total.shape[1] and 0 <= column < total.shape[1]:
                    cellsum = total[zones[lens], row, column]
                    cellsum[0] += 1.0
                    cellsum[1] += dx
                    cellsum[2] += dy
                    cellsum[3] += image[j, i]


def zone_means(image: FloatImage, flags: Flags, centres: FloatArray, cell: Cell, zones: int = ZONES) -> Zones:
    """Mean subimage of each of `zones`² zones of the sensor.

    Parameters
    ----------
    image, flags
        Gray image, and the pixels to leave out where not 0, shape (y, x).
    centres
        Lens centres (n, 2).
    cell
        `lfflow.kernels.lattice.lens_light.cell_of`.
    """
    pitch = max(cell[2], cell[3])
    step, half = pitch / CELLS, int(0.6 * CELLS) + 1
    height, width = image.shape
    column = np.clip((centres[:, 0] / width * zones).astype(np.int64), 0, zones - 1)
    row = np.clip((centres[:, 1] / height * zones).astype(np.int64), 0, zones - 1)
    index = row * zones + column
    total = np.zeros((zones * zones, 2 * half + 1, 2 * half + 1, 4))
    _accumulate(image, flags, centres, index, cell, step, total)
    zone, j, i = np.nonzero(total[..., 0])
    weight, dx, dy, value = total[zone, j, i].T
    number = np.maximum(np.bincount(index, minlength=zones * zones), 1)
    means = [np.bincount(index, centres[:, axis], zones * zones) / number for axis in (0, 1)]
    return Zones(
        dx / weight, dy / weight, value / weight, weight, zone, j * (2 * half + 1) + i, np.stack(means, axis=1)
    )
