"""Where a cost volume tells a disparity, and the range it tells."""

from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.mosaicked.clarity import is_clear, noise_level, told_range

LABELS = np.arange(-2, 2.01, 0.125)
SHAPE = (60, 70)
FITS = 0.1


def volume(disparity: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    """Cost (hypothesis, t, s) with noise: FITS at the disparity, more by `contrast` one lens away."""
    away = np.minimum(np.abs(LABELS[:, None, None] - disparity), 1)
    noise = np.random.default_rng(3).normal(0, 0.3 * FITS, (len(LABELS), *SHAPE))
    return (FITS + contrast * away + np.abs(noise)).astype(np.float32)


def scene(faint: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cost, true disparity and place of a textured disc before a wall of contrast `faint`."""
    t, s = np.mgrid[: SHAPE[0], : SHAPE[1]]
    disc = np.hypot(t - 30, s - 35) < 12
    disparity = np.where(disc, 0.5, -1.25)
    return volume(disparity, np.where(disc, 1.0, faint)), disparity, disc


def range_of(cost: np.ndarray, found: np.ndarray) -> tuple[float, float] | None:
    return told_range(cost, LABELS, found, clear=is_clear(cost), among=np.ones(SHAPE, bool), row_pitch=0.866)


def test_only_texture_is_clear() -> None:
    cost, _, disc = scene(faint=0.1)
    assert (is_clear(cost) == disc).mean() > 0.99
    assert noise_level(cost) == pytest.approx(FITS, rel=0.2)


def test_a_faint_wall_belongs_to_the_range() -> None:
    cost, disparity, _ = scene(faint=0.1)
    told = range_of(cost, disparity)
    assert told is not None
    assert -1.65 < told[0] < -1.25
    assert 0.5 < told[1] < 0.9


def test_a_wall_without_texture_does_not() -> None:
    cost, disparity, _ = scene(faint=0.0)
    told = range_of(cost, disparity)
    assert told is not None
    assert 0.0 < told[0] < 0.5 < told[1] < 1.0


def test_noise_tells_no_range() -> None:
    cost = volume(np.zeros(SHAPE), np.zeros(SHAPE))
    assert range_of(cost, np.zeros(SHAPE)) is None


def test_undefined_costs_are_left_out() -> None:
    cost, disparity, _ = scene(faint=0.1)
    cost[:, :, :30] = np.nan
    told = range_of(cost, disparity)
    assert told is not None
    assert -1.65 < told[0] < -1.25
