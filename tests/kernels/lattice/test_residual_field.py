"""Bent lattices: pictures drawn lens by lens where a lens distortion puts them, found and put straight."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from white_discs import white_discs

from lfflow.distortion import STRAIGHT, TERMS, Distortion, products
from lfflow.kernels.lattice.centres import measure_centres
from lfflow.kernels.lattice.fit import fit
from lfflow.kernels.lattice.likelihood import refine
from lfflow.kernels.lattice.residual_field import Bend, bend, judge, residual_field
from lfflow.kernels.lattice.spectrum import start
from lfflow.lattice import Lattice

LATTICE = Lattice(9.95, 9.96, 0.004, 3.0, 4.0)
SHAPE = (700, 760)
Warp = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def radial(third: float, fifth: float = 0.0, middle: tuple[float, float] = (0.5, 0.5)) -> Warp:
    """Displacement along the radius; `third` and `fifth` are pixels in the corners of the sensor."""
    height, width = SHAPE
    corner = np.hypot(height, width) / 2

    def displace(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        across, down = (x - middle[0] * width) / corner, (y - middle[1] * height) / corner
        square = across**2 + down**2
        size = third * square + fifth * square**2
        return size * across, size * down

    return displace


def error(lattice: Lattice, distortion: Distortion, places: np.ndarray) -> tuple[float, float]:
    """Rms and largest distance of the lens centres from their true places (n, 2) within the sensor."""
    height, width = SHAPE
    inside = (places > 6).all(axis=1) & (places[:, 0] < width - 7) & (places[:, 1] < height - 7)
    x, y = places[inside].T
    found_x, found_y = distortion.moved(lattice.centres(*lattice.nearest(x, y)))
    away = np.hypot(found_x - x, found_y - y)
    return float(np.sqrt((away**2).mean())), float(away.max())


def judged(image: np.ndarray) -> tuple[Lattice, Bend]:
    first = start(image)
    found, state = refine(image, fit(measure_centres(image, first), first, (image.shape[0], image.shape[1])))
    return found.lattice, judge(image, np.zeros(image.shape, np.uint8), state)


@pytest.mark.parametrize(
    "warp",
    [radial(0.3), radial(1.0), radial(-1.0), radial(0.6, 0.5), radial(1.5, -1.5), radial(1.0, middle=(0.6, 0.45))],
    ids=["weak", "barrel", "cushion", "fifth", "moustache", "decentred"],
)
def test_a_bent_lattice_is_put_straight(warp: Warp) -> None:
    image, places = white_discs(LATTICE, SHAPE, warp)
    lattice, found = judged(image)
    assert not found.distortion.straight
    assert error(lattice, STRAIGHT, places)[0] > 0.03
    rms, largest = error(found.lattice, found.distortion, places)
    assert rms < 0.01
    assert largest < 0.03


@pytest.mark.parametrize("draw", range(20))
def test_a_straight_lattice_gets_no_correction(draw: int) -> None:
    rng = np.random.default_rng([draw, 8])
    pitch = rng.uniform(7, 16)
    lattice = Lattice(pitch, pitch * rng.uniform(0.999, 1.001), rng.uniform(-0.05, 0.05), *rng.uniform(0, 9, 2))
    image, _ = white_discs(lattice, (420, 440), radial(0), noise=rng.uniform(0.01, 0.1), seed=draw)
    _, found = judged(image)
    assert found.distortion.straight
    assert found.rms < 0.015


def test_the_field_holds_the_residuals_and_their_noise() -> None:
    rng = np.random.default_rng(5)
    t, s = np.mgrid[0:80, 0:75]
    x, y = (values.ravel() for values in LATTICE.centres(t, s))
    right, down = radial(1.0)(x, y)
    centres = np.stack([x + right, y + down], axis=1) + rng.normal(0, 0.05, (x.size, 2))
    centres[::97] += 3
    field = residual_field(LATTICE, centres, SHAPE)
    known = np.isfinite(field.dx)
    expected, _ = radial(1.0)(field.x[known], field.y[known])
    assert np.abs(field.dx[known] - expected).max() < 0.06
    assert np.median(field.std[known] * np.sqrt(field.count[known])) == pytest.approx(0.05, rel=0.15)
    assert field.excess > 10
    straight = residual_field(LATTICE, np.stack([x, y], axis=1) + rng.normal(0, 0.05, (x.size, 2)), SHAPE)
    assert straight.excess == pytest.approx(1, abs=0.25)


def test_noise_alone_is_found_as_often_as_its_probability_says() -> None:
    rng = np.random.default_rng(6)
    t, s = np.mgrid[0:80, 0:75]
    places = np.stack([values.ravel() for values in LATTICE.centres(t, s)], axis=1)
    chances = [
        bend(LATTICE, residual_field(LATTICE, places + rng.normal(0, 0.05, places.shape), SHAPE), SHAPE).chance
        for _ in range(60)
    ]
    assert 0.2 < np.median(chances) < 0.6, "the smaller of two probabilities lies below one half"
    assert min(chances) > 1e-4


def test_terms_leave_the_lattice_alone() -> None:
    height, width = 101, 121
    y, x = np.mgrid[:height, :width]
    half = np.array([width - 1, height - 1]) / 2
    terms = products(x, y, half).reshape(-1, len(TERMS))
    rigid = np.stack([np.ones(x.size), x.ravel() / half[0] - 1, y.ravel() / half[1] - 1], axis=1)
    assert np.abs(rigid.T @ terms[:, 2:] / x.size).max() < 0.03


def test_nothing_told_is_straight() -> None:
    numbers = np.full(STRAIGHT.numbers.shape, np.nan)
    assert Distortion(numbers).straight
    assert Distortion(numbers).displacement([1.0, 2.0], 3.0)[0].tolist() == [0, 0]
