"""One gray image from a Bayer mosaic: black level off, the gains of the four sites made equal."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]


@numba.njit(nogil=True, cache=True)
def site_means(raw: npt.NDArray[np.uint16], black: npt.NDArray[np.float64]) -> npt.NDArray[np.floating]:
    """Mean above black of each site of the 2×2 tile.

    Parameters
    ----------
    raw
        Counts, shape (y, x).
    black
        Black level of the tile's sites, counts, shape (2, 2).
    """
    height, width = raw.shape[0] // 2 * 2, raw.shape[1] // 2 * 2
    total = np.zeros((2, 2))
    for y in range(height):
        even, odd = 0, 0
        for x in range(0, width, 2):
            even += raw[y, x]
            odd += raw[y, x + 1]
        total[y % 2, 0] += even
        total[y % 2, 1] += odd
    return total / np.float64(height * width / 4) - black


@numba.njit(nogil=True, cache=True)
def apply_gains(
    raw: npt.NDArray[np.uint16], black: npt.NDArray[np.float64], gains: npt.NDArray[np.float64]
) -> FloatImage:
    """(raw − black) · gain of the pixel's site, float32, shape (y, x)."""
    out = np.empty(raw.shape, np.float32)
    for y in range(raw.shape[0]):
        for parity in range(2):
            offset, gain = np.float32(black[y % 2, parity]), np.float32(gains[y % 2, parity])
            for x in range(parity, raw.shape[1], 2):
                out[y, x] = (np.float32(raw[y, x]) - offset) * gain
    return out


def equalise(raw: npt.NDArray[np.uint16], black: npt.NDArray[np.float64]) -> tuple[FloatImage, npt.NDArray[np.float64]]:
    """Gray image with mean 1 in each of the four sites, and the gains that made it.

    An even lens pitch makes the colour pattern beat against the lattice, so that unequal gains move the centres.

    Parameters
    ----------
    raw
        Counts, shape (y, x).
    black
        Black level of the 2×2 tile, counts, shape (2, 2).

    Returns
    -------
    image, gains
        float32 (y, x), and (2, 2) in 1 / count; sites without light get gain 0.
    """
    means = site_means(raw, black)
    gains = np.where(means > 0, 1.0 / np.where(means > 0, means, 1.0), 0.0)
    return apply_gains(raw, black, gains), gains


def weighted(image: FloatImage, weights: npt.NDArray[np.float64]) -> FloatImage:
    """Image (y, x) times the weight of each pixel's site, shape (2, 2); itself where all are 1."""
    if (weights == 1).all():
        return image
    out = image.copy()
    for row in range(2):
        for column in range(2):
            out[row::2, column::2] *= np.float32(weights[row, column])
    return out
