"""Whether a sensor frame shows a scene, an even light (a white image) or no light at all, judged from its samples.

Behind every lens an even light looks the same, so that the mean of a tile of some lenses changes only as the vignetting
does: slowly, alike in all colours, symmetrically about the middle. A scene changes from tile to tile. The statistic
knows nothing of the lattice. Tiles are compared in logarithms: a step of 0.01 is one percent. White images of both
simulated cameras have steps of 0.0004 to 0.005 (median) and 0.016 at most, scenes 0.04 and 0.4 or more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

TILE = 60
"""Edge of a tile, sensor pixels: six lenses of an F01, four of an Illum, so that nearly whole ones fill it."""
MIN_TILES = 10
"""Rows and columns of tiles in the smallest frame that is judged: fewer leave a smooth scene nothing to betray it."""
_BRIGHT = 0.8
"""Quantile of a tile: on the plateau of the subimages, off the dark gaps between them and off hot pixels."""
_LIT = 0.1
"""Tiles darker than this share of the brightest say little about the light: corners that the lens vignettes."""

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Flatness:
    """How even a frame is; changes are relative, levels are shares of the white level.

    Parameters
    ----------
    level, peak
        Median and largest bright level of the tiles.
    spread
        Range of the mean levels of all tiles.
    sparkle
        How far the few brightest samples of a tile rise above its middle, more than in most other tiles.
    lit
        Share of the tiles that get light.
    step_typical, step_most, step_largest
        Difference of a tile from its neighbours, beside tilt and vignetting: median, 99th percentile, largest.
    colour_most, colour_largest
        Change of the colour over the frame: 99th percentile, largest.
    tilt
        Change from one side to the other that is not symmetrical about the middle.
    shape
        99th percentile of what neither the tilt nor a smooth, symmetrical vignetting explains.
    """

    level: float
    peak: float
    spread: float
    sparkle: float
    lit: float
    step_typical: float = np.inf
    step_most: float = np.inf
    step_largest: float = np.inf
    colour_most: float = np.inf
    colour_largest: float = np.inf
    tilt: float = np.inf
    shape: float = np.inf

    @property
    def may_be_even(self) -> bool:
        """Whether a part of a frame leaves it open that the whole shows an even light, or none."""
        return self.level < 0.04 or self.lit < 0.9 or (self.step_typical < 0.02 and self.step_most < 0.05)

    @property
    def kind(self) -> Literal["scene", "white", "dark"]:
        """What the frame shows; a scene where it is in doubt."""
        if abs(self.level) < 0.01 and self.spread < 0.0015 and self.sparkle < 0.004:
            return "dark"
        exposed = self.level > 0.04 and self.peak < 0.97 and self.lit > 0.7
        even = self.step_typical < 0.01 and self.step_most < 0.025 and self.step_largest < 0.05
        coloured_alike = self.colour_most < 0.06 and self.colour_largest < 0.1
        vignetted_only = self.tilt < 0.2 and self.shape < 0.06
        return "white" if exposed and even and coloured_alike and vignetted_only else "scene"


def flatness(raw: npt.NDArray[np.uint16], black: Floats, white: Floats) -> Flatness | None:
    """Evenness of a frame.

    Parameters
    ----------
    raw
        Samples (y, x) from an even row on; rows may be left out in multiples of `TILE`.
    black, white
        Levels of the four places of the Bayer tile, row by row.

    Returns
    -------
    Flatness or None
        None where the frame is too small to say.
    """
    if raw.shape[0] < 3 * TILE or raw.shape[1] < MIN_TILES * TILE:
        return None
    sites = _sites(raw)
    scale = (np.asarray(white, np.float32) - np.asarray(black, np.float32))[:, None, None]
    offset = np.asarray(black, np.float32)[:, None, None]
    place = round(_BRIGHT * (sites.shape[3] - 1))
    few = round(0.98 * (sites.shape[3] - 1))
    sites = np.partition(sites, (place, few), axis=3)
    bright = (sites[..., place].astype(np.float32) - offset) / scale
    # Without the brightest samples, among them the hot pixels.
    means = (sites[..., :place].mean(axis=3, dtype=np.float32) - offset) / scale
    level, peak = float(np.median(bright)), float(bright.max())
    spread = float(means.max() - means.min())
    brightest = (sites[..., few].astype(np.float32) - offset) / scale - bright
    sparkle = float(brightest.max() - 1.5 * np.median(brightest))
    gains = np.median(bright, axis=(1, 2), keepdims=True)
    lit = np.all(bright > _LIT * np.quantile(bright, 0.99, axis=(1, 2), keepdims=True), axis=0)
    share = float(lit.mean())
    if level < 0.01 or share < 0.5:
        return Flatness(level, peak, spread, sparkle, share)
    # A colour meets the lenses at few phases, so that it beats with the tiles; all colours together hardly do.
    balanced = (sites[..., :few].mean(axis=3, dtype=np.float32) - offset) / (scale * gains)
    light = np.where(lit, np.log(np.maximum(balanced.mean(axis=0), 1e-6)), np.nan)
    tilt, left_over = _vignetting_removed(light)
    typical, most, largest = (float(value) for value in np.nanquantile(_steps(left_over), (0.5, 0.99, 1.0)))
    shape = float(np.nanquantile(np.abs(left_over), 0.99))
    logs = _pooled(np.where(lit, np.log(np.maximum(bright, 1e-6)), np.nan))
    colour = logs - logs.mean(axis=0)
    colour = np.abs(colour - np.nanmedian(colour, axis=(1, 2), keepdims=True))
    return Flatness(
        level, peak, spread, sparkle, share, typical, most, largest,
        float(np.nanquantile(colour, 0.99)), float(np.nanmax(colour)), tilt, shape,
    )  # fmt: skip


def _sites(raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
    """Samples (site, tile row, tile column, sample) of the four places of the Bayer tile."""
    rows, columns = raw.shape[0] // TILE, raw.shape[1] // TILE
    tiles = raw[: rows * TILE, : columns * TILE].reshape(rows, TILE // 2, 2, columns, TILE // 2, 2)
    return np.ascontiguousarray(tiles.transpose(2, 5, 0, 3, 1, 4)).reshape(4, rows, columns, -1)


def _steps(light: Floats) -> Floats:
    """Distance of each tile from the middle of its two neighbours in its row, and from that in its column."""
    across = np.abs(light[:, 1:-1] - (light[:, :-2] + light[:, 2:]) / 2)
    down = np.abs(light[1:-1] - (light[:-2] + light[2:]) / 2)
    return np.concatenate([across.ravel(), down.ravel()])


def _pooled(logs: Floats) -> Floats:
    """Means of four tiles that meet in a corner."""
    pooled: Floats = (logs[:, 1:, 1:] + logs[:, :-1, 1:] + logs[:, 1:, :-1] + logs[:, :-1, :-1]) / 4
    return pooled


def _vignetting_removed(light: Floats) -> tuple[float, Floats]:
    """Tilt across the frame beside a vignetting of even powers, and the light without both."""
    rows, columns = light.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    r2 = x * x + y * y
    parts = np.stack([x, y, np.ones_like(x), x * x, x * y, y * y, r2**2, r2**3, r2**4], axis=-1)
    known = np.isfinite(light)
    found = np.linalg.lstsq(parts[known], light[known], rcond=None)[0]
    return float(2 * np.hypot(found[0], found[1])), light - parts @ found
