"""The start from nothing: random pitches, rotations, offsets and arrangements, at low signal."""

from __future__ import annotations

import numpy as np
import pytest

from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.lattice.centres import measure_centres
from lfflow.kernels.lattice.fit import algorithm_one, fit, jacobian, lens_indices
from lfflow.kernels.lattice.spectrum import start
from lfflow.kernels.sensor.equalise import equalise
from lfflow.lattice import ARRANGEMENTS, Arrangement, Lattice


def draw(seed: int, widest: float = 45.0) -> tuple[Lattice, np.ndarray]:
    rng = np.random.default_rng(seed)
    pitch = float(np.exp(rng.uniform(np.log(6), np.log(widest))))
    size = int(np.clip(14 * pitch, 360, 840)) // 2 * 2
    lattice = Lattice(
        pitch,
        pitch * rng.uniform(0.995, 1.005),
        float(np.radians(rng.uniform(-3, 3))),
        *rng.uniform(0, size, 2),
        ARRANGEMENTS[seed % 2],
    )
    y, x = np.mgrid[:size, :size].astype(float)
    centre_x, centre_y = lattice.centres(*lattice.nearest(x, y))
    edge = (np.hypot(x - centre_x, y - centre_y) - rng.uniform(0.36, 0.5) * pitch) / (0.05 * pitch)
    light = 1 / (1 + np.exp(np.clip(edge, -50, 50))) * np.tile([[0.6, 1.0], [1.0, 0.5]], (size // 2, size // 2))
    return lattice, (2000 * (light + rng.normal(0, 0.1, light.shape)) + 400).clip(0).astype(np.uint16)


def misses(seeds: range, widest: float) -> list[int]:
    """Seeds whose lattice is not found."""
    missed = []
    for seed in seeds:
        truth, raw = draw(seed, widest)
        image, _ = equalise(raw, np.full((2, 2), 400.0))
        try:
            guess = start(image)
            found = fit(measure_centres(image, guess), guess, raw.shape).lattice
        except LatticeNotFoundError:
            missed.append(seed)
            continue
        if found.arrangement != truth.arrangement or found.distance_to(truth, *raw.shape) > 0.05 * truth.dh:
            missed.append(seed)
    return missed


@pytest.mark.parametrize("first", [0, 10])
def test_random_lattices_are_found(first: int) -> None:
    assert misses(range(first, first + 10), 45) == []


@pytest.mark.heavy
def test_two_hundred_random_lattices_are_found() -> None:
    """Pitch 6 to 60 px, rotation ±3°, any offset, hexagonal and square, signal to noise 10."""
    assert misses(range(1000, 1200), 60) == []


@pytest.mark.parametrize("pitch", [6.9, 7.43, 47.9])
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_harmonics_of_sharp_subimages_are_no_lattice_of_their_own(pitch: float, arrangement: Arrangement) -> None:
    """Beyond the band of the bins they are folded back; half the pitch explains every other one."""
    truth = Lattice(pitch, pitch * 1.002, 0.008, 40.0, 50.0, arrangement)
    size = int(max(360, 14 * pitch)) // 2 * 2
    y, x = np.mgrid[:size, :size].astype(float)
    centre_x, centre_y = truth.centres(*truth.nearest(x, y))
    light = np.clip((0.42 * pitch - np.hypot(x - centre_x, y - centre_y)) / (0.08 * pitch) + 0.5, 0, 1)
    image = (light + np.random.default_rng(1).normal(0, 0.02, light.shape)).astype(np.float32)
    first = start(image)
    assert first.arrangement == arrangement
    assert first.distance_to(truth, size, size) < 0.2 * pitch
    assert fit(measure_centres(image, first), first, (size, size)).lattice.distance_to(truth, size, size) < 0.01 * pitch


def test_algorithm_one_ignores_false_centres() -> None:
    truth = Lattice(10.0, 10.01, 0.003, 2.0, 3.0)
    rng = np.random.default_rng(0)
    t, s = np.meshgrid(np.arange(40), np.arange(40), indexing="ij")
    centres = np.stack([c.ravel() for c in truth.centres(t, s)], axis=1)[rng.random(1600) < 0.8]
    spoilt = np.concatenate([centres, rng.uniform(0, 380, (150, 2))])
    found, used = algorithm_one(spoilt, Lattice(10.03, 10.0, 0.002, 2.4, 2.8))
    assert found.distance_to(truth, 340, 400) < 1e-9
    assert used[: len(centres)].all()


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_jacobian_is_that_of_the_centres(arrangement: str) -> None:
    lattice = Lattice(9.9, 10.1, 0.02, 3.0, 4.0, arrangement)  # type: ignore[arg-type]
    t, s = np.array([3, 8, 11]), np.array([5, 2, 7])
    k = lens_indices(lattice, np.stack(lattice.centres(t, s), axis=1))
    step = 1e-6
    for index, name in enumerate(("dh", "dv", "theta", "cx", "cy")):
        values = {n: getattr(lattice, n) for n in ("dh", "dv", "theta", "cx", "cy")}
        values[name] += step
        change = np.subtract(Lattice(**values, arrangement=lattice.arrangement).centres(t, s), lattice.centres(t, s))
        np.testing.assert_allclose(jacobian(lattice, k)[:, :, index], change / step, atol=1e-4)
