"""Patches read a picture between its lenses as it was before it was sampled."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from lfflow.kernels.mosaicked.patches import patches, read_patch

ROWS, COLUMNS, PITCH = 40, 44, 0.866
BRICK, SQUARE = (0.5 * (np.arange(ROWS) % 2)).astype("f4"), np.zeros(ROWS, "f4")
WAVES = [(1.05, 0.0), (0.0, 1.05), (0.7, -0.6)]


def wave(x, y, frequency):
    return np.sin(frequency[0] * x + frequency[1] * y * PITCH + 0.3).astype("f4")


@numba.njit
def read(patch, offset, x, y):
    out = np.empty((3, x.size), dtype=np.float32)
    for n in range(x.size):
        out[:, n] = read_patch(patch, offset, np.float32(x[n]), np.float32(y[n]), 0)
    return out


@pytest.mark.parametrize("offset", [BRICK, SQUARE], ids=["brick", "square"])
@pytest.mark.parametrize("frequency", WAVES)
def test_a_wave_of_six_lenses_is_read_between_them(offset, frequency):
    y, x = np.mgrid[:ROWS, :COLUMNS].astype(np.float64)
    x = x + offset[:, None]
    patch = patches(wave(x, y, frequency)[None], offset, PITCH)
    generator = np.random.default_rng(5)
    places = generator.uniform(8, COLUMNS - 9, 500), generator.uniform(8, ROWS - 9, 500)
    value, _, _ = read(patch, offset, *places)
    assert np.abs(value - wave(*places, frequency)).max() < 0.015


@pytest.mark.parametrize("offset", [BRICK, SQUARE], ids=["brick", "square"])
def test_the_slopes_at_the_lenses_are_those_of_the_detail(offset):
    """A wave of six lenses keeps nearly all of its slope, a ramp none: it is no detail."""
    y, x = np.mgrid[:ROWS, :COLUMNS].astype(np.float64)
    x = x + offset[:, None]
    frequency = (1.05, 0.0)
    patch = patches((wave(x, y, frequency) + 0.2 * x.astype("f4"))[None], offset, PITCH)
    inner = (slice(12, -12), slice(12, -12))
    places = x[inner].ravel(), y[inner].ravel()
    _, right, down = read(patch, offset, *places)
    expected = 1.05 * np.cos(frequency[0] * places[0] + 0.3)
    assert np.abs(right - expected).max() < 0.05
    assert np.abs(down).max() < 0.05
