"""The surface joins what the lenses tell: planes stay, steps stay, and what tells nothing continues around it."""

from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.mosaicked.surface import lattice_surface

ROWS, COLUMNS = 30, 34
BRICK, SQUARE = 0.5 * (np.arange(ROWS) % 2), np.zeros(ROWS)
NONE, FLAT = np.zeros((ROWS, COLUMNS)), np.full((ROWS, COLUMNS, 3), 0.5)
INNER = (slice(3, -3), slice(3, -3))


def slope(offset):
    return (0.01 * (np.arange(COLUMNS)[None] + offset[:, None]) - 0.02 * np.arange(ROWS)[:, None]).astype("f4")


@pytest.mark.parametrize("offset", [BRICK, 0.5 - BRICK, SQUARE], ids=["brick", "brick from the other row", "square"])
def test_a_noisy_plane_becomes_that_plane(offset):
    plane = slope(offset)
    noisy = plane + np.random.default_rng(1).normal(0, 0.03, plane.shape).astype("f4")
    known = np.full(plane.shape, 1 / 0.03**2, "f4")
    found = lattice_surface(noisy, known, noisy, FLAT, offset, doubt=NONE, edge=0.02, jump=0.3, iterations=200)
    assert np.abs(found - plane)[INNER].mean() < np.abs(noisy - plane)[INNER].mean() / 4


@pytest.mark.parametrize("offset", [BRICK, SQUARE], ids=["brick", "square"])
def test_what_tells_nothing_continues_the_plane_around_it(offset):
    plane = slope(offset)
    start, known = plane.copy(), np.full(plane.shape, 1e5, "f4")
    start[10:20, 12:22] += 0.02
    known[10:20, 12:22] = 0
    found = lattice_surface(start, known, start, FLAT, offset, doubt=NONE, edge=0.02, jump=0.3, iterations=300)
    assert np.abs(found - plane).max() < 0.004


def test_a_step_stays_where_it_is():
    step = np.where(np.arange(COLUMNS) < 17, -0.2, 0.3).astype("f4") * np.ones((ROWS, 1), "f4")
    known = np.full(step.shape, 1e3, "f4")
    found = lattice_surface(step, known, step, FLAT, BRICK, doubt=NONE, edge=0.02)
    assert np.abs(found - step).max() < 0.05


def test_unknown_places_stay_unknown_and_tell_nothing():
    plane = slope(BRICK)
    start = plane.copy()
    start[:4] = np.nan
    found = lattice_surface(start, np.full(plane.shape, 1e4, "f4"), start, FLAT, BRICK, doubt=NONE, edge=0.02)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(start))
    assert np.nanmax(np.abs(found - plane)[6:]) < 0.01


@pytest.mark.parametrize(("doubt", "kept"), [(0.0, True), (0.3, False)])
def test_a_step_of_what_does_not_know_its_disparity_gives_way(doubt, kept):
    step = np.where(np.arange(COLUMNS) < 17, 0.0, 0.2).astype("f4") * np.ones((ROWS, 1), "f4")
    known = np.full(step.shape, 1e3, "f4")
    found = lattice_surface(step, known, step, FLAT, BRICK, doubt=NONE + doubt, edge=0.02)
    assert (np.abs(np.diff(found[INNER], axis=1)).max() > 0.1) == kept
