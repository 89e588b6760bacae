from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.colour.completion import complete_centre
from lfflow.kernels.mosaicked.mosaic_field import MosaicField
from lfflow.kernels.mosaicked.sides import choose_sides

ROWS, COLUMNS, PITCH = 40, 44, 0.866
OFFSET = (0.5 * (np.arange(ROWS) % 2)).astype("f4")
X = np.arange(COLUMNS) + OFFSET[:, None]
Y = PITCH * np.arange(ROWS)[:, None] + 0 * X
NEAR, FAR = 0.4, -0.1
LEFT, RIGHT = 16.75, 26.75
TRUTH = np.where((X > LEFT) & (X < RIGHT), NEAR, FAR).astype("f4")
VIEWS = np.arange(-4, 5)
NOISE = 0.005


def colours(x, y, phase):
    return [0.5 + 0.2 * np.sin(1.1 * x + c + phase) * np.cos(0.9 * y - 2 * c) for c in range(3)]


@pytest.fixture(scope="module")
def bar():
    """A bar with a texture of its own before a textured ground, with every sample where and what a formula says."""
    rng = np.random.default_rng(3)
    shape = (len(VIEWS), len(VIEWS), ROWS, COLUMNS)
    cfa = rng.integers(0, 3, shape).astype("u1")
    mosaic = np.empty(shape, "f4")
    for j, v in enumerate(VIEWS):
        for i, u in enumerate(VIEWS):
            x, y = X + NEAR * u, Y + NEAR * v
            near = np.choose(cfa[j, i], colours(x, y, 2.0))
            far = np.choose(cfa[j, i], colours(X + FAR * u, Y + FAR * v, 0.0))
            mosaic[j, i] = np.where((x > LEFT) & (x < RIGHT), near, far)
    mosaic += (NOISE * rng.standard_normal(shape)).astype("f4")
    rho = np.zeros((2, ROWS, COLUMNS), "f4")
    return MosaicField(mosaic, cfa, np.ones(shape, "f4"), VIEWS, VIEWS, OFFSET, PITCH, rho)


def chosen(field, start, threads=1):
    picture, _ = complete_centre(field, start, np.full(start.shape, 0.02, "f4"))
    return choose_sides(start, picture, field, NOISE, threads)


@pytest.mark.parametrize("wide", [-1.0, 0.0, 1.0])
def test_a_bar_too_wide_or_too_narrow_gets_its_width(bar, wide):
    start = np.where((LEFT - wide < X) & (RIGHT + wide > X), NEAR, FAR).astype("f4")
    whole = np.minimum(np.abs(X - LEFT), np.abs(X - RIGHT)) > 0.5
    whole[:4] = whole[-4:] = False
    assert (start != TRUTH)[whole].sum() == (32 if wide else 0)
    np.testing.assert_array_equal(chosen(bar, start)[whole], TRUTH[whole])


def test_unknown_places_stay_unknown_and_a_map_without_jumps_as_it_is(bar):
    some = np.where(X < 12, np.nan, TRUTH).astype("f4")
    np.testing.assert_array_equal(np.isnan(chosen(bar, some)), np.isnan(some))
    slope = (0.02 * X).astype("f4")
    np.testing.assert_array_equal(chosen(bar, slope), slope)


def test_threads_do_not_change_a_bit(bar):
    start = np.where((X > LEFT - 1) & (X < RIGHT + 1), NEAR, FAR).astype("f4")
    np.testing.assert_array_equal(chosen(bar, start), chosen(bar, start, threads=3))
