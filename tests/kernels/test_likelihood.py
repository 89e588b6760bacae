"""Maximum likelihood on a closed-form white image: better than the local method, with an honest covariance."""

from __future__ import annotations

import numpy as np

from lfflow.kernels.centres import measure_centres
from lfflow.kernels.equalise import equalise
from lfflow.kernels.lattice_fit import fit
from lfflow.kernels.likelihood import refine
from lfflow.kernels.spectrum import start
from lfflow.lattice import Lattice

SHAPE = (400, 440)
TRUTH = Lattice(9.9346, 9.9395, -0.0048, 3.3, 4.4).anchored(*SHAPE)
NAMES = ("dh", "dv", "theta", "cx", "cy")


def white_image(seed: int) -> np.ndarray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    centre_x, centre_y = TRUTH.centres(*TRUTH.nearest(x, y))
    light = 2500 / (1 + np.exp((np.hypot(x - centre_x, y - centre_y) - 4.4) / 0.5))
    return np.rint(np.random.default_rng(seed).normal(light + 168, np.sqrt(light + 25))).clip(0).astype(np.uint16)


def test_refinement_beats_the_peaks_and_knows_its_error() -> None:
    chi_square = []
    for seed in range(8):
        image, _ = equalise(white_image(seed), np.full((2, 2), 168.0))
        guess = start(image)
        peaks = fit(measure_centres(image, guess), guess, SHAPE)
        refined, _ = refine(image, peaks)
        assert refined.lattice.distance_to(TRUTH, *SHAPE) < 0.001
        error = np.array([getattr(refined.lattice, name) - getattr(TRUTH, name) for name in NAMES])
        chi_square.append(error @ np.linalg.solve(refined.covariance, error))
    # chi² of 5 degrees of freedom: the mean of 8 draws has the standard deviation 1.1.
    assert 2.5 < np.mean(chi_square) < 9
