from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.colour.gather import Gathered, Rule, Samples, Targets, gather

ROWS, COLUMNS, RADIUS = 30, 34, 3
PITCH = np.float32(0.866)


def samples_of(d: float, noise: float = 0.0) -> Samples:
    """Square lattice without rounding; a slanted grey plane of disparity d; colours at random."""
    rng = np.random.default_rng(3)
    axis = np.arange(-RADIUS, RADIUS + 1)
    v, u = np.meshgrid(axis, axis, indexing="ij")
    aperture = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)
    y, x = np.indices((ROWS, COLUMNS)).astype(np.float32)
    seen_x, seen_y = x + d * aperture[:, 0, None, None], y * PITCH + d * aperture[:, 1, None, None]
    value = 0.4 + 0.002 * seen_x - 0.003 * seen_y
    value = value + noise * rng.standard_normal(value.shape)
    shape = value.shape
    return Samples(
        value.astype(np.float32),
        np.ones(shape, np.float32),
        np.full(shape, d, np.float32),
        rng.integers(0, 3, shape).astype(np.uint8),
        np.zeros((2, ROWS, COLUMNS), np.float32),
        aperture,
        np.arange(len(aperture)),
        np.array([PITCH, 0.0, 0.0], np.float32),
    )


def targets_of(d: float) -> Targets:
    y, x = np.indices((ROWS - 12, COLUMNS - 12)).astype(np.float32).reshape(2, -1) + 6
    one = np.ones(x.size, np.float32)
    return Targets(x, y * PITCH, 0 * one, 0 * one, d * one, 0.01 * one)


@pytest.mark.parametrize("d", [0.0, 0.3, 0.93, -1.4])
def test_a_slanted_plane(d: float) -> None:
    targets = targets_of(d)
    planes = gather(samples_of(d), targets, Rule()).planes
    truth = 0.4 + 0.002 * targets.x - 0.003 * targets.y
    np.testing.assert_allclose(planes[:, :, 0], np.repeat(truth[:, None], 3, axis=1), atol=2e-3)
    assert (np.sign(np.median(planes[:, 1, 1:], axis=0)) == ([1, -1] if d else [0, 0])).all()


def test_the_stated_variance_is_that_of_the_values() -> None:
    rule, targets = Rule(lift=0), targets_of(0.3)
    found, clean = gather(samples_of(0.3, 0.02), targets, rule), gather(samples_of(0.3), targets, rule)
    true = np.mean((found.planes - clean.planes)[..., 0] ** 2, axis=0)
    np.testing.assert_allclose(np.nanmean(found.variance, axis=0), true, rtol=0.35)
    assert np.nanmax(clean.variance) < 1e-6
    assert (found.weight > 0).all()


@pytest.mark.parametrize("d", [0.3, 0.93])
def test_sums_do_not_depend_on_how_the_targets_are_cut(d: float) -> None:
    samples, targets = samples_of(d, 0.02), targets_of(d)
    targets.disparity[::7] = 0.1
    whole = gather(samples, targets, Rule())
    parts = [gather(samples, Targets(*(field[part] for field in targets)), Rule())
             for part in (slice(0, 61), slice(61, None))]  # fmt: skip
    for field, pieces in zip(whole, zip(*parts, strict=True), strict=True):
        np.testing.assert_allclose(field, np.concatenate(pieces), rtol=1e-4, atol=1e-5)


def test_without_disparity_there_is_nothing() -> None:
    targets = targets_of(0.3)
    targets.disparity[5] = np.nan
    found: Gathered = gather(samples_of(0.3), targets, Rule())
    assert np.isnan(found.planes[5, :, 0]).all()
    assert (found.weight[5] == 0).all()
    assert np.isfinite(found.planes[6]).all()
