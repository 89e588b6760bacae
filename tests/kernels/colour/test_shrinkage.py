from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.colour.shrinkage import sample_noise, steady_colours

PITCH = (0.866, 1.0)
RESTS_ON = np.array([7, 14, 7], np.float32)


def painted(noise: float, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Two paints beside each other under the same fine shading: truth, picture with noise, its weight and variance."""
    rng = np.random.default_rng(seed)
    shade = 1 + 0.2 * rng.standard_normal((60, 60, 1))
    paint = np.where(np.arange(60)[:, None] < 30, [0.4, 0.3, 0.2], [0.15, 0.3, 0.35])
    truth = (shade * paint).astype(np.float32)
    weight = np.broadcast_to(RESTS_ON, truth.shape).astype(np.float32)
    variance = noise * truth / weight
    picture = truth + np.sqrt(variance) * rng.standard_normal(truth.shape)
    return truth, picture.astype(np.float32), weight, variance


def test_noise_of_the_colours_falls_and_detail_stays() -> None:
    truth, noisy, weight, variance = painted(0.003)
    found = steady_colours(noisy, weight, sample_noise(noisy, weight, variance), PITCH)
    before, after = (np.mean((picture - truth)[4:-4, 4:-4] ** 2) for picture in (noisy, found))
    assert after < 0.5 * before
    edge = (slice(4, -4), slice(28, 32))
    assert np.mean((found - truth)[edge] ** 2) < np.mean((noisy - truth)[edge] ** 2)


def test_a_colour_that_rests_on_little_follows_the_others() -> None:
    truth, noisy, weight, variance = painted(0.001)
    poor = (slice(10, 50, 5), slice(10, 26, 5), 0)
    weight[poor] = 0.1
    noisy[poor] += 0.1
    found = steady_colours(noisy, weight, sample_noise(noisy, weight, variance), PITCH)
    assert np.abs(found - truth)[poor].mean() < 0.25 * 0.1


def test_without_scatter_of_the_samples_nothing_changes() -> None:
    _, picture, weight, variance = painted(0.0)
    assert sample_noise(picture, weight, variance) == 0
    np.testing.assert_array_equal(steady_colours(picture, weight, 0.0, PITCH), picture)


def test_a_flat_picture_stays_flat() -> None:
    flat = np.full((12, 12, 3), [0.3, 0.4, 0.2], np.float32)
    np.testing.assert_allclose(steady_colours(flat, np.full_like(flat, 5), 0.002, PITCH), flat, atol=1e-5)


def test_the_noise_of_a_sample_is_told_by_the_quiet_places() -> None:
    _, picture, weight, variance = painted(0.003)
    variance[:20] *= 10
    assert sample_noise(picture, weight, variance) == pytest.approx(0.003, rel=0.2)


def test_unknown_places_stay_unknown_and_tell_nothing() -> None:
    truth, noisy, weight, variance = painted(0.003)
    noisy[20:23, 20:23, 1] = np.nan
    noisy[20:23, 20:23, 0] = 50.0
    found = steady_colours(noisy, weight, sample_noise(noisy, weight, variance), PITCH)
    np.testing.assert_array_equal(found[20:23, 20:23], noisy[20:23, 20:23])
    assert np.abs(found - truth)[18:20, 18:20].max() < 0.1


def test_a_picture_without_any_known_place() -> None:
    nothing = np.full((5, 5, 3), np.nan, np.float32)
    np.testing.assert_array_equal(steady_colours(nothing, 0 * nothing, 0.1, PITCH), nothing)
