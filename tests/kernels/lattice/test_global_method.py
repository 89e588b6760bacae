"""The global method: Υ against a mask drawn by its definition, and the ascent from starts that are far away."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.lattice.ascent import ascend, correlation, global_method
from lfflow.kernels.lattice.quality import SHAPES, Shape, quality, shape_function
from lfflow.lattice import Arrangement, Lattice

SEED_CAMERA = Lattice(dh=10.00861, dv=10.01028, theta=0.00143, cx=3.3, cy=4.1)
SIZE = 480


def gray(lattice: Lattice, size: int, noise: float = 0.1, seed: int = 0) -> np.ndarray:
    """A soft disc about every lens: written from the lattice's definition alone."""
    y, x = np.mgrid[:size, :size].astype(float)
    centre_x, centre_y = lattice.centres(*lattice.nearest(x, y))
    light = 1 / (1 + np.exp((np.hypot(x - centre_x, y - centre_y) - 0.45 * lattice.dh) / (0.05 * lattice.dh)))
    return (light + np.random.default_rng(seed).normal(0, noise, light.shape)).astype(np.float32)


@pytest.mark.parametrize("arrangement", ["hexagonal", "square"])
@pytest.mark.parametrize("shape", SHAPES)
def test_quality_is_the_image_times_the_mask(shape: Shape, arrangement: Arrangement) -> None:
    lattice = Lattice(7.3, 7.4, 0.03, 5.2, 6.1, arrangement)
    image = np.random.default_rng(1).uniform(0, 1, (40, 50)).astype(np.float32)
    y, x = np.mgrid[:40, :50].astype(float)
    mask = np.zeros(image.shape)
    for t in range(-12, 20):
        for s in range(-12, 20):
            centre_x, centre_y = lattice.centres(t, s)
            mask += shape_function(shape, np.hypot(x - centre_x, y - centre_y), 2.3)
    assert quality(image, lattice, shape, 2.3) == pytest.approx(float((mask * image).sum()), rel=1e-5)


def test_shape_functions_are_1_at_the_centre_and_fall() -> None:
    radius = np.linspace(0, 20, 400)
    for shape in SHAPES:
        values = shape_function(shape, radius, 2.0)
        assert values[0] == 1
        assert (np.diff(values) <= 0).all()
        assert values[-1] == 0
    assert shape_function("rectangular", [1.9, 2.1], 2.0).tolist() == [1, 0]


@pytest.mark.parametrize(("shape", "limit"), [("gaussian", 0.012), ("cosine4", 0.012), ("rectangular", 0.15)])
def test_every_shape_finds_the_lattice_without_a_start(shape: Shape, limit: float) -> None:
    found = global_method(gray(SEED_CAMERA, SIZE), shape=shape)
    assert found.distance_to(SEED_CAMERA, SIZE, SIZE) < limit


def test_the_summit_is_one_of_the_quality_itself() -> None:
    image = gray(SEED_CAMERA, SIZE)
    flat = (image - image.mean()).astype(np.float32)
    found = global_method(image, sigma=2.5)
    top = quality(flat, found, "gaussian", 2.5)
    for name, step in {"dh": 0.004, "dv": 0.004, "theta": 4e-4, "cx": 0.1, "cy": 0.1}.items():
        for sign in (-1, 1):
            moved = replace(found, **{name: getattr(found, name) + sign * step})
            assert quality(flat, moved, "gaussian", 2.5) < top, name


def test_the_basin_is_5_percent_of_pitch_and_3_degrees_at_any_offset() -> None:
    surface = correlation(gray(SEED_CAMERA, SIZE), "gaussian", 2.5)
    rng = np.random.default_rng(7)
    starts = [(a, b, c) for a in (-0.05, 0.05) for b in (-0.05, 0.05) for c in (-3.0, 3.0)]
    starts += [(*rng.uniform(-0.05, 0.05, 2), rng.uniform(-3, 3)) for _ in range(12)]
    for dh, dv, degrees in starts:
        first = Lattice(
            SEED_CAMERA.dh * (1 + dh),
            SEED_CAMERA.dv * (1 + dv),
            SEED_CAMERA.theta + math.radians(degrees),
            *rng.uniform(0, SIZE, 2),
        )
        assert ascend(surface, first).distance_to(SEED_CAMERA, SIZE, SIZE) < 0.02, (dh, dv, degrees)


def test_far_outside_the_basin_the_ascent_is_lost() -> None:
    surface = correlation(gray(SEED_CAMERA, SIZE), "gaussian", 2.5)
    first = replace(SEED_CAMERA, dh=1.3 * SEED_CAMERA.dh, dv=1.3 * SEED_CAMERA.dv)
    assert ascend(surface, first).distance_to(SEED_CAMERA, SIZE, SIZE) > 1


def random_lattice(rng: np.random.Generator) -> Lattice:
    pitch, theta = 6 * 10 ** rng.uniform(0, 1), math.radians(rng.uniform(-3, 3))
    arrangement: Arrangement = "hexagonal" if rng.random() < 0.7 else "square"
    return Lattice(pitch, pitch * rng.uniform(0.998, 1.002), theta, *rng.uniform(0, pitch, 2), arrangement)


@pytest.mark.parametrize("draw", range(8))
def test_random_lattices_are_found_without_metadata(draw: int) -> None:
    lattice = random_lattice(np.random.default_rng([draw, 4]))
    size = round(min(max(24 * lattice.dh, 300), 900))
    image = gray(lattice, size, noise=0.1, seed=draw)
    found = global_method(image)
    assert found.arrangement == lattice.arrangement
    assert found.distance_to(lattice, size, size) < 0.005 * lattice.dh


def test_a_flat_picture_is_refused() -> None:
    with pytest.raises(LatticeNotFoundError):
        global_method(np.random.default_rng(0).normal(1, 0.1, (400, 400)).astype(np.float32))
