"""Maximum likelihood on pictures drawn here from closed forms: accurate, and with an honest covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from lfflow.kernels.lattice.centres import flatten_scene, measure_centres
from lfflow.kernels.lattice.fit import Fit, fit
from lfflow.kernels.lattice.likelihood import measure_lenses, refine
from lfflow.kernels.lattice.spectrum import start
from lfflow.kernels.sensor.equalise import equalise
from lfflow.lattice import Lattice

SHAPE = (400, 440)
TRUTH = Lattice(9.9346, 9.9395, -0.0048, 3.3, 4.4).anchored(*SHAPE)
NAMES = ("dh", "dv", "theta", "cx", "cy")
MIDDLE = (np.array(SHAPE[::-1]) - 1) / 2
NOTHING = np.zeros(SHAPE, np.uint8)


def under_lenses() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Offset (right, down) of every pixel from its lens, and that lens's place (−1…1 at the corners' distance)."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    centre_x, centre_y = TRUTH.centres(*TRUTH.nearest(x, y))
    far = np.hypot(*MIDDLE)
    return x - centre_x, y - centre_y, (centre_x - MIDDLE[0]) / far, (centre_y - MIDDLE[1]) / far


def soft(radius: np.ndarray, edge: float) -> np.ndarray:
    return 1 / (1 + np.exp((radius - edge) / 0.4))


def light(edge, falloff: float = 0.0, cat_eye: float = 0.0) -> np.ndarray:
    dx, dy, u, v = under_lenses()
    radius = 0.46 * TRUTH.dh
    drawn = edge(np.hypot(dx, dy), radius) * (1 - 0.2 * (dx**2 + dy**2) / radius**2)
    if cat_eye:
        drawn *= edge(np.hypot(dx + cat_eye * radius * u, dy + cat_eye * radius * v), 1.06 * radius)
    return drawn / (1 + falloff * (u**2 + v**2)) ** 2


def expose(drawn: np.ndarray, seed: int) -> np.ndarray:
    """Gray image of a sensor of its own: Poisson photons, 1 % fixed pattern, read noise, unequal colours."""
    rng = np.random.default_rng(seed)
    electrons = 3000 * drawn * np.tile([[0.6, 1.0], [1.0, 0.5]], (SHAPE[0] // 2, SHAPE[1] // 2))
    electrons = rng.poisson(electrons * (1 + 0.01 * rng.standard_normal(SHAPE)))
    raw = np.rint(electrons * 0.8 + rng.normal(0, 3, SHAPE) + 168).clip(0, 4095).astype(np.uint16)
    return equalise(raw, np.full((2, 2), 168.0))[0]


def refined(image: np.ndarray, *, scene: bool = False, precise: bool = True) -> tuple[Fit, np.ndarray]:
    """Fit, and the error of its parameters."""
    guess = start(image)
    flat = flatten_scene(image, guess.dh) if scene else image
    peaks = fit(measure_centres(flat, guess), guess, SHAPE)
    found, _ = refine(image, peaks, scene=flat if scene else None, precise=precise)
    x, y = TRUTH.centres(*TRUTH.nearest(found.lattice.cx, found.lattice.cy))
    truth = replace(TRUTH, cx=float(x), cy=float(y))
    return found, np.array([getattr(found.lattice, name) - getattr(truth, name) for name in NAMES])


def test_covariance_covers_the_truth() -> None:
    draws, drawn = 20, light(soft, 0.3)
    results = [refined(expose(drawn, seed)) for seed in range(draws)]
    squares = sum(error @ np.linalg.solve(found.covariance, error) for found, error in results)
    assert chi2.ppf(0.005, 5 * draws) < squares < chi2.ppf(0.995, 5 * draws)
    scores = np.array([error / np.sqrt(np.diag(found.covariance)) for found, error in results])
    squares = (scores**2).sum(axis=0)
    assert (squares > chi2.ppf(0.0005, draws)).all()
    assert (squares < chi2.ppf(0.9995, draws)).all()
    assert np.mean([found.lattice.distance_to(TRUTH, *SHAPE) for found, _ in results]) < 0.001


@pytest.mark.parametrize("precise", [False, True])
@pytest.mark.heavy
def test_covariance_neither_promises_too_much_nor_too_little(precise: bool) -> None:
    draws, drawn = 60, light(soft, 0.3)
    found = [refined(expose(drawn, 100 + seed), precise=precise) for seed in range(draws)]
    squares = sum(error @ np.linalg.solve(fit.covariance, error) for fit, error in found)
    assert chi2.ppf(0.005, 5 * draws) < squares < chi2.ppf(0.995, 5 * draws)


def test_quick_fit_is_near_and_its_covariance_covers_the_truth() -> None:
    drawn, draws = light(soft, 0.3), 20
    results = [refined(expose(drawn, seed), precise=False) for seed in range(draws)]
    assert np.mean([found.lattice.distance_to(TRUTH, *SHAPE) for found, _ in results]) < 0.001
    squares = sum(error @ np.linalg.solve(found.covariance, error) for found, error in results)
    assert chi2.ppf(0.005, 5 * draws) < squares < chi2.ppf(0.995, 5 * draws)


def sharp(radius: np.ndarray, edge: float) -> np.ndarray:
    return (radius < edge).astype(float)


def blurred(radius: np.ndarray, edge: float) -> np.ndarray:
    return 1 / (1 + np.exp(np.clip((radius - edge) / 1.0, -50, 50)))


def gathered(edge, cat_eye: float, larger: float, *, fine: int = 6, second=None) -> np.ndarray:
    """Subimages that a second disc clips towards the corners, gathered over the area of each pixel.

    A point of a pixel beyond the border of a cell shows the next lens.
    """
    dx, dy, u, v = under_lenses()
    radius, total = 0.46 * TRUTH.dh, np.zeros(SHAPE)
    places = (np.arange(fine) + 0.5) / fine - 0.5
    for a in places:
        for b in places:
            x, y = dx + a, dy + b
            other = np.hypot(x + cat_eye * radius * u, y + cat_eye * radius * v)
            light = edge(np.hypot(x, y), radius) * (second or edge)(other, larger * radius)
            total += light * (1 - 0.2 * (x**2 + y**2) / radius**2)
    return total / fine**2 / (1 + 0.3 * (u**2 + v**2)) ** 2


CLIPPED = [(sharp, 0.5, 1.06), (soft, 0.5, 1.06), (sharp, 0.9, 1.15), (soft, 0.9, 1.06), (sharp, 1.2, 1.2)]


def check_clipped(edge, cat_eye: float, larger: float, draws: int) -> None:
    drawn = gathered(edge, cat_eye, larger)
    image = expose(drawn, 0)
    guess = start(image)
    assert fit(measure_centres(image, guess), guess, SHAPE).lattice.distance_to(TRUTH, *SHAPE) > 0.2
    results = [refined(expose(drawn, seed)) for seed in range(draws)]
    rms = [found.lattice.distance_to(TRUTH, *SHAPE) for found, _ in results]
    assert np.sqrt(np.mean(np.square(rms))) < 0.01
    # How far the model of two edges holds counts in the covariance, and is no chance: only too much is told.
    squares = sum(error @ np.linalg.solve(found.covariance, error) for found, error in results)
    assert squares < chi2.ppf(0.995, 5 * draws)


@pytest.mark.parametrize(("edge", "cat_eye", "larger"), CLIPPED[::2])
def test_a_disc_that_clips_the_corners_does_not_move_the_lattice(edge, cat_eye: float, larger: float) -> None:
    check_clipped(edge, cat_eye, larger, 2)


@pytest.mark.heavy
@pytest.mark.parametrize(("edge", "cat_eye", "larger"), CLIPPED)
def test_covariance_of_clipped_subimages_covers_the_truth(edge, cat_eye: float, larger: float) -> None:
    check_clipped(edge, cat_eye, larger, 20)


def test_a_second_disc_may_have_a_softer_edge() -> None:
    drawn = gathered(soft, 0.6, 1.1, second=blurred)
    for seed in range(2):
        found, error = refined(expose(drawn, seed))
        assert found.lattice.distance_to(TRUTH, *SHAPE) < 0.01
        assert error @ np.linalg.solve(found.covariance, error) < chi2.ppf(0.9995, 5)


@pytest.mark.parametrize(("edge", "cat_eye"), [(soft, 0.12), (sharp, 0.2)])
def test_a_weak_clipping_does_not_move_the_lattice(edge, cat_eye: float) -> None:
    drawn = gathered(edge, cat_eye, 1 + 0.15 * cat_eye)
    for seed in range(3):
        found, error = refined(expose(drawn, seed))
        assert found.lattice.distance_to(TRUTH, *SHAPE) < 0.01
        assert error @ np.linalg.solve(found.covariance, error) < chi2.ppf(0.9995, 5)


def test_a_clipping_too_weak_to_be_seen_is_stated() -> None:
    drawn = gathered(soft, 0.06, 1.01)
    for seed in range(3):
        found, error = refined(expose(drawn, seed))
        assert error @ np.linalg.solve(found.covariance, error) < chi2.ppf(0.9995, 5)


def test_pixels_that_gather_light_do_not_move_the_lattice() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    places, total = (np.arange(6) + 0.5) / 6 - 0.5, np.zeros(SHAPE)
    for a, b in np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2):
        centre_x, centre_y = TRUTH.centres(*TRUTH.nearest(x + a, y + b))
        u, v = (
            (centre - middle) / np.hypot(*MIDDLE) for centre, middle in zip((centre_x, centre_y), MIDDLE, strict=True)
        )
        radius = np.hypot(x + a - centre_x, y + b - centre_y)
        total += soft(radius, 0.47 * TRUTH.dh) / (1 + 0.5 * (u**2 + v**2)) ** 2
    raw = (0.8 * 3000 * total / 36 * np.tile([[0.6, 1.0], [1.0, 0.5]], (SHAPE[0] // 2, SHAPE[1] // 2))).astype(
        np.float32
    )
    found, _ = refined(equalise(raw, np.zeros((2, 2)))[0])
    assert found.lattice.distance_to(TRUTH, *SHAPE) < 1e-4


def test_scene_content_does_not_move_the_lattice() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    texture = 0.5 + 0.3 * np.sin(x / 17 + y / 31) + 0.15 * np.sin(x / 5.3 - y / 7.1)
    errors = []
    for seed in range(4):
        found, error = refined(expose(light(soft) * texture * (1.3 - x / SHAPE[1]), seed), scene=True)
        assert found.lattice.distance_to(TRUTH, *SHAPE) < 0.03
        errors.append(error @ np.linalg.solve(found.covariance, error))
    assert np.median(errors) < chi2.ppf(0.9999, 5)


def test_single_lenses_lie_within_their_deviation() -> None:
    image = expose(light(soft, 0.3), 3)
    guess = start(image)
    _, state = refine(image, fit(measure_centres(image, guess), guess, SHAPE))
    centres, std = measure_lenses(image, NOTHING, state)
    x, y = TRUTH.centres(*TRUTH.nearest(centres[:, 0], centres[:, 1]))
    score = (centres - np.stack([x, y], axis=1)) / std
    assert np.isfinite(score).all()
    assert 0.9 < np.sqrt(np.mean(score**2)) < 1.15
    assert np.abs(score.mean(axis=0)).max() < 4 / np.sqrt(len(score))
