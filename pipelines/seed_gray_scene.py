"""The seed's camera in front of a gray scene, simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lfflow.kernels.sensor.equalise import equalise
from lfflow.lattice import Lattice
from lfflow.simulate.optics import Optics, frame_of
from lfflow.simulate.rays import illuminate
from lfflow.simulate.sensor import Sensor

SIZE = 3280
TABLE_3 = Lattice(dh=10.00947, dv=10.01187, theta=0.00141, cx=0.0, cy=0.0)
"""Printed for the global method, on one photo."""
AFTER_ALGORITHM_1 = Lattice(dh=10.00861, dv=10.01028, theta=0.00143, cx=0.0, cy=0.0)
"""Printed for the local method, on another photo."""
SUBIMAGES = Optics(aperture=0.833, softness=1.98, droop=0.205)
"""Three numbers that were fitted, once, to the fifteen of the seed's Table 2 (with its scale and its two lost
constants): the light falls to half at 4.2 px and to nothing at 6.2 px, beyond the lens."""
GAINS = {"R": 0.62, "G": 1.0, "B": 0.55}
BLACK = 168.0


@dataclass(frozen=True, slots=True)
class Gray:
    """Photo of a gray scene.

    Parameters
    ----------
    lattice
        Truth, numbered from a lens near the middle.
    colours
        (raw − black) / (white − black): the colours as unequal as the sensor sees them, shape (y, x).
    equal
        The same with the mean of every Bayer site at 1.
    """

    lattice: Lattice
    colours: npt.NDArray[np.float32]
    equal: npt.NDArray[np.float32]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.equal.shape[0], self.equal.shape[1]

    def only(self, colour: str) -> npt.NDArray[np.float32]:
        """I_red, I_green or I_blue of seed 6.2.2: the samples of one colour, 0 elsewhere."""
        alone = np.zeros_like(self.colours)
        for row, column in {"red": [(1, 1)], "green": [(0, 1), (1, 0)], "blue": [(0, 0)]}[colour]:
            alone[row::2, column::2] = self.colours[row::2, column::2]
        return alone


def photograph(lattice: Lattice, size: int = SIZE, seed: int = 0) -> Gray:
    """Photo of an even light by a BGGR sensor with noise; `lattice` gives pitches and rotation."""
    x, y = np.random.default_rng([seed, 6]).uniform(-5, 5, 2) + size / 2
    lattice = Lattice(lattice.dh, lattice.dv, lattice.theta, float(x), float(y))
    light = np.empty((size, size), np.float32)
    illuminate(light, 0, frame_of(lattice, size, size), SUBIMAGES.profile(lattice, size, size))
    tile = np.array([[GAINS["B"], GAINS["G"]], [GAINS["G"], GAINS["R"]]], np.float32)
    sensor = Sensor()
    raw = sensor.digitise(0.8 * light * np.tile(tile, (size // 2, size // 2)), np.random.default_rng(seed))
    colours = ((raw - np.float32(BLACK)) / np.float32(sensor.white - BLACK)).astype(np.float32)
    return Gray(lattice, colours, equalise(raw, np.full((2, 2), BLACK))[0])
