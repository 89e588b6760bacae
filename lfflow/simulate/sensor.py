"""The simulated sensor: photons, noise, defects and quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]
RawImage = npt.NDArray[np.uint16]

_CHANNEL_OF = {"R": 0, "G": 1, "B": 2}


@dataclass(frozen=True, slots=True)
class Sensor:
    """A Bayer sensor.

    Parameters
    ----------
    pattern
        Colours of the top-left 2×2 pixels, row by row.
    black, white
        Black and white level, counts.
    full_well
        Electrons that make the white level; the photon noise follows from it.
    read_noise
        Standard deviation of the noise without light, electrons.
    hot_share, dead_share
        Share of the pixels that are hot or dead.
    """

    pattern: str = "BGGR"
    black: float = 168.0
    white: float = 4095.0
    full_well: float = 5000.0
    read_noise: float = 4.0
    hot_share: float = 2e-5
    dead_share: float = 5e-6

    @property
    def cfa(self) -> npt.NDArray[np.int64]:
        """Channel (0 R, 1 G, 2 B) of the top-left 2×2 pixels, shape (2, 2)."""
        return np.array([_CHANNEL_OF[colour] for colour in self.pattern]).reshape(2, 2)

    def noise_std(self, level: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """Standard deviation of a sample of linear `level` (0 black, 1 white), in the same unit."""
        electrons = np.maximum(level, 0) * self.full_well
        return np.asarray(np.sqrt(electrons + self.read_noise**2) / self.full_well, dtype=np.float64)

    def digitise(self, level: FloatImage, rng: np.random.Generator | None) -> RawImage:
        """Counts of the linear levels; photon (Gaussian) and read noise unless `rng` is None."""
        counts = level * np.float32(self.white - self.black) + np.float32(self.black)
        if rng is not None:
            spread = np.sqrt(np.maximum(level, 0) * np.float32(self.full_well) + np.float32(self.read_noise**2))
            spread *= np.float32((self.white - self.black) / self.full_well)
            counts += spread * rng.standard_normal(level.shape, dtype=np.float32)
        samples: RawImage = np.clip(np.rint(counts), 0, self.white).astype(np.uint16)
        return samples

    def defects(self, height: int, width: int, seed: int) -> npt.NDArray[np.uint8]:
        """Defect of each pixel, shape (y, x): bit 1 hot, bit 2 dead. The same for all captures of one sensor."""
        flags = np.zeros(height * width, dtype=np.uint8)
        rng = np.random.default_rng((seed, 0xDEFEC7))
        hot, dead = rng.poisson(self.hot_share * flags.size), rng.poisson(self.dead_share * flags.size)
        places = rng.choice(flags.size, hot + dead, replace=False)
        flags[places[:hot]], flags[places[hot:]] = 1, 2
        return flags.reshape(height, width)

    def with_defects(self, raw: RawImage, flags: npt.NDArray[np.uint8], seed: int) -> RawImage:
        """Counts with the hot pixels raised (each by its own amount) and the dead ones at the black level."""
        y, x = np.nonzero(flags & 1)
        excess = np.random.default_rng((seed, 0x407)).uniform(0.3, 1.0, y.size) * (self.white - self.black)
        spoilt = raw.copy()
        spoilt[y, x] = np.clip(raw[y, x] + excess, 0, self.white).astype(np.uint16)
        spoilt[flags == 2] = round(self.black)
        return spoilt
