"""Whether a sensor frame shows a scene, an even light (a white image) or no light at all, judged from its samples.

Behind every lens an even light looks the same, so that the bright part of a tile of a few lenses changes only as the
vignetting does: slowly, alike in all colours, symmetrically about the middle. A scene changes from tile to tile. The
statistic knows nothing of the lattice. Tiles are compared in logarithms: a change of 0.01 is one percent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

TILE = 48
"""Edge of a tile, sensor pixels: three lenses of an Illum, five of an F01."""
_MIN_TILES = 4
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
    lit
        Share of the tiles that get light.
    step_typical, step_most, step_largest
        Difference of a tile from its neighbours: median, 99th percentile, largest.
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
        return self.level < 0.04 or self.lit < 0.9 or (self.step_typical < 0.02 and self.step_most < 0.08)

    @property
    def kind(self) -> Literal["scene", "white", "dark"]:
        """What the frame shows; a scene where it is in doubt."""
        if abs(self.level) < 0.01 and self.peak < 0.03 and self.spread < 0.004:
            return "dark"
        exposed = self.level > 0.04 and self.peak < 0.97 and self.lit > 0.7
        even = self.step_typical < 0.012 and self.step_most < 0.04 and self.step_largest < 0.08
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
    if min(raw.shape) < _MIN_TILES * TILE:
        return None
    sites = _sites(raw)
    rows, columns = sites.shape[1:3]
    scale = (np.asarray(white, np.float32) - np.asarray(black, np.float32))[:, None, None]
    offset = np.asarray(black, np.float32)[:, None, None]
    means = (sites.mean(axis=3, dtype=np.float32) - offset) / scale
    place = round(_BRIGHT * (sites.shape[3] - 1))
    bright = (np.partition(sites, place, axis=3)[..., place].astype(np.float32) - offset) / scale
    level, peak = float(np.median(bright)), float(bright.max())
    # Fine structure of the light is in no mean: photon noise and defects average out, weak scenes do not.
    spread = float(np.quantile(means, 0.99) - np.quantile(means, 0.01))
    lit = np.all(bright > _LIT * np.quantile(bright, 0.99, axis=(1, 2), keepdims=True), axis=0)
    share = float(lit.mean())
    if level < 0.01 or share < 0.5:
        return Flatness(level, peak, spread, share)
    logs = np.where(lit, np.log(np.maximum(bright, 1e-6)), np.nan)
    steps = _steps(logs)
    colour = logs - logs.mean(axis=0)
    colour = np.abs(colour - np.nanmedian(colour, axis=(1, 2), keepdims=True))
    typical, most, largest = (float(value) for value in np.nanquantile(steps, (0.5, 0.99, 1.0)))
    tilt, shape = _symmetry(logs.mean(axis=0), rows, columns)
    return Flatness(
        level, peak, spread, share, typical, most, largest,
        float(np.nanquantile(colour, 0.99)), float(np.nanmax(colour)), tilt, shape,
    )  # fmt: skip


def _sites(raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
    """Samples (site, tile row, tile column, sample) of the four places of the Bayer tile."""
    rows, columns = raw.shape[0] // TILE, raw.shape[1] // TILE
    tiles = raw[: rows * TILE, : columns * TILE].reshape(rows, TILE // 2, 2, columns, TILE // 2, 2)
    return np.ascontiguousarray(tiles.transpose(2, 5, 0, 3, 1, 4)).reshape(4, rows, columns, -1)


def _steps(logs: Floats) -> Floats:
    """Distance of each tile from the line through its two neighbours in its row, and from that in its column."""
    across = np.abs(logs[:, :, 1:-1] - (logs[:, :, :-2] + logs[:, :, 2:]) / 2)
    down = np.abs(logs[:, 1:-1] - (logs[:, :-2] + logs[:, 2:]) / 2)
    return np.concatenate([across.ravel(), down.ravel()])


def _symmetry(logs: Floats, rows: int, columns: int) -> tuple[float, float]:
    """Tilt across the frame beside a vignetting of even powers, and 99th percentile of what is left over."""
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    r2 = x * x + y * y
    parts = np.stack([x, y, np.ones_like(x), x * x, x * y, y * y, r2**2, r2**3, r2**4], axis=-1)
    known = np.isfinite(logs)
    found = np.linalg.lstsq(parts[known], logs[known], rcond=None)[0]
    left_over = np.abs(logs[known] - parts[known] @ found)
    return float(2 * np.hypot(found[0], found[1])), float(np.quantile(left_over, 0.99))
