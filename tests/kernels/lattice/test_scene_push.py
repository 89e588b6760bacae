"""A scene's gradient pushes the peaks of its subimages; the lattice is found all the same."""

from __future__ import annotations

import numpy as np

from lfflow.kernels.lattice.fit import fit
from lfflow.kernels.lattice.scene_push import scene_slope, unpushed
from lfflow.lattice import Lattice

SHAPE = (1200, 1300)
TRUTH = Lattice(9.93, 9.94, -0.005, 3.0, 4.0).anchored(*SHAPE)


def brightness(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bright in the middle, with detail: all of it is scene."""
    far = ((x - 650) / 650) ** 2 + ((y - 600) / 600) ** 2
    return np.exp(-far + 0.5 * np.sin(x / 70 + y / 110) + 0.4 * np.sin(x / 95 - y / 60))


def places() -> np.ndarray:
    rows, columns = TRUTH.grid_shape(*SHAPE)
    x, y = (part.ravel() for part in TRUTH.centres(*np.mgrid[:rows, :columns]))
    inside = (x > 8) & (x < SHAPE[1] - 9) & (y > 8) & (y < SHAPE[0] - 9)
    return np.stack([x[inside], y[inside]], axis=1)


def test_slope_is_that_of_the_logarithm() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    found = scene_slope(np.exp(x / 300 - y / 500).astype(np.float32), places()[200:-200:17], 10.0)
    np.testing.assert_allclose(np.median(found, axis=0), [10 / 300, -10 / 500], rtol=0.02)


def test_a_push_that_changes_with_the_disparity_is_taken_out() -> None:
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    image, true = brightness(x, y).astype(np.float32), places()
    push = 3 + 2 * np.sign(np.sin(true[:, 0] / 200))  # two depths
    slope = scene_slope(image, true, TRUTH.dh)
    measured = true + push[:, np.newaxis] * slope + 0.1 * rng.standard_t(3, true.shape)
    pushed = fit(measured, TRUTH, SHAPE)
    found = unpushed(image, measured, pushed)
    assert pushed.lattice.distance_to(TRUTH, *SHAPE) > 0.03
    assert found.lattice.distance_to(TRUTH, *SHAPE) < 0.01
    error = found.lattice.dh - TRUTH.dh, found.lattice.dv - TRUTH.dv
    assert (np.abs(error) < 3 * np.sqrt(np.diag(found.covariance))[:2]).all()


def test_without_a_push_the_lattice_stays() -> None:
    rng = np.random.default_rng(4)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    measured = places() + rng.normal(0, 0.1, places().shape)
    first = fit(measured, TRUTH, SHAPE)
    found = unpushed(brightness(x, y).astype(np.float32), measured, first)
    assert found.lattice.distance_to(TRUTH, *SHAPE) < 0.006
