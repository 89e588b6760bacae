"""Accuracy and CPU time of the calibration against known lattices: ``python benchmarks/calibration.py [size]``."""

from __future__ import annotations

import sys
import time

import numpy as np

from lfflow.kernels.centres import flatten_scene, measure_centres
from lfflow.kernels.equalise import equalise
from lfflow.kernels.lattice_fit import Fit, fit
from lfflow.kernels.likelihood import refine
from lfflow.kernels.spectrum import start
from lfflow.lattice import Lattice
from lfflow.simulate.optics import Optics, frame_of
from lfflow.simulate.rays import illuminate
from lfflow.simulate.sensor import Sensor

LATTICES = {
    "F01": Lattice(9.93456, 9.9412, -0.0047, 3.3, 4.4),
    "F01, pitch 10": Lattice(10.00861, 10.01028, 0.00143, 3.3, 4.4),
    "Illum": Lattice(14.29, 14.297, 0.0012, 3.3, 4.4),
    "square 20": Lattice(20.2, 20.2, 0.01, 3.3, 4.4, "square"),
}


def white_image(lattice: Lattice, size: int, seed: int, cat_eye: float = 0.0) -> np.ndarray:
    light = np.empty((size, size), np.float32)
    illuminate(light, 0, frame_of(lattice, size, size), Optics(cat_eye=cat_eye).profile(lattice, size, size))
    light *= 0.7 * np.tile(np.array([[0.55, 1.0], [1.0, 0.8]], np.float32), (size // 2, size // 2))
    return Sensor().digitise(light, np.random.default_rng(seed))


def fast_path(raw: np.ndarray, *, scene: bool = False) -> tuple[np.ndarray, Fit]:
    image, _ = equalise(raw, np.full((2, 2), 168.0))
    guess = start(image)
    flat = flatten_scene(image, guess.dh) if scene else image
    return image, fit(measure_centres(flat, guess), guess, raw.shape)


def main(size: int) -> None:
    for warm in (True, False):
        for name, lattice in list(LATTICES.items())[: 1 if warm else None]:
            for cat_eye in (0.0, 0.6):
                raw = white_image(lattice, 400 if warm else size, 1, cat_eye)
                begin = time.process_time()
                image, found = fast_path(raw)
                middle = time.process_time()
                best = refine(image, found)
                end = time.process_time()
                if warm:
                    continue
                errors = [fitted.lattice.distance_to(lattice, size, size) for fitted in (found, best)]
                print(
                    f"{name:<14} cat's eye {cat_eye:.1f}: fast {errors[0]:.5f} px {middle - begin:.2f} CPU s, "
                    f"likelihood {errors[1]:.5f} px {end - middle:.2f} CPU s"
                )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3280)
