"""Black and white levels of a Bayer sensor, site by site (seed 5.3.1), and which colour each site has."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_B, CFA_G, CFA_R

SITE_R, SITE_GR, SITE_GB, SITE_B = range(4)
COLOUR_OF_SITE = np.array([CFA_R, CFA_G, CFA_G, CFA_B], dtype=np.uint8)

Float32Array = npt.NDArray[np.float32]


def site_tile(pattern: str) -> npt.NDArray[np.int64]:
    """Index into (r, gr, gb, b) of the top-left 2×2 sensor pixels, shape (2, 2).

    ``pattern`` names their colours row by row, such as "BGGR"; gr is the green site in the rows of the red one.
    """
    if len(pattern) != 4 or sorted(pattern.upper()) != ["B", "G", "G", "R"]:
        raise ValueError(f"cfa_pattern {pattern!r}: expected the colours of a 2×2 Bayer tile, such as 'BGGR'")
    colours = np.array(list(pattern.upper())).reshape(2, 2)
    if (colours[0] == "G").all() or (colours[1] == "G").all() or (colours[:, 0] == "G").all():
        raise ValueError(f"cfa_pattern {pattern!r}: the two green sites of a Bayer tile lie on a diagonal")
    red_row = int(np.nonzero(colours == "R")[0][0])
    tile = np.where(colours == "R", SITE_R, SITE_B)
    green_rows = np.where(np.arange(2) == red_row, SITE_GR, SITE_GB)[:, np.newaxis]
    sites: npt.NDArray[np.int64] = np.where(colours == "G", green_rows, tile).astype(np.int64)
    return sites


def colour_tile(pattern: str) -> npt.NDArray[np.uint8]:
    """Colour codes (0 R, 1 G, 2 B) of the top-left 2×2 sensor pixels, shape (2, 2)."""
    return COLOUR_OF_SITE[site_tile(pattern)]


def level_tiles(
    black: npt.NDArray[np.float64], white: npt.NDArray[np.float64], pattern: str
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Black level, gain 1/(white − black) and white level of the top-left 2×2 pixels, each (2, 2) float32.

    ``black`` and ``white`` are (4,) counts at the sites (r, gr, gb, b).
    """
    if not (np.asarray(white) > np.asarray(black)).all():
        raise ValueError(f"white levels {white} must lie above the black levels {black}")
    tile = site_tile(pattern)
    gain = 1.0 / (np.asarray(white, dtype=np.float64) - black)
    return (
        np.asarray(black)[tile].astype(np.float32),
        gain[tile].astype(np.float32),
        np.asarray(white)[tile].astype(np.float32),
    )


@numba.njit(nogil=True, cache=True)
def normalise_levels(
    raw: npt.NDArray[np.uint16], black: Float32Array, gain: Float32Array
) -> npt.NDArray[np.float32]:  # pragma: no cover - compiled
    """Radiance (raw − black)·gain of a frame (y, x), float32; the tiles of levels and gains are (2, 2) (seed 5.1)."""
    height, width = raw.shape
    radiance = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            radiance[y, x] = (np.float32(raw[y, x]) - black[y & 1, x & 1]) * gain[y & 1, x & 1]
    return radiance
