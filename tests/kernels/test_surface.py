"""The surface joins what the lenses tell: planes stay, steps stay, and what tells nothing continues around it."""

from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.surface import fit_surface, lattice_axes, square_axes

ROWS, COLUMNS = 30, 34
BRICK, SQUARE = 0.5 * (np.arange(ROWS) % 2), np.zeros(ROWS)
LOOSE, TIGHT = {"stiffness": 2e4, "jump": 0.3, "edge": 0.02}, {"stiffness": 2e4, "jump": 0.03, "edge": 0.02}
NONE, FLAT = np.zeros((ROWS, COLUMNS)), np.full((ROWS, COLUMNS, 3), 0.5)
INNER = (slice(3, -3), slice(3, -3))


def slope(offset):
    return (0.01 * (np.arange(COLUMNS)[None] + offset[:, None]) - 0.02 * np.arange(ROWS)[:, None]).astype("f4")


@pytest.mark.parametrize("offset", [BRICK, 0.5 - BRICK, SQUARE], ids=["brick", "brick from the other row", "square"])
def test_a_noisy_plane_becomes_that_plane(offset):
    plane = slope(offset)
    noisy = plane + np.random.default_rng(1).normal(0, 0.03, plane.shape).astype("f4")
    known = np.full(plane.shape, 1 / 0.03**2, "f4")
    found = fit_surface(noisy, known, noisy, FLAT, lattice_axes(offset), **LOOSE, iterations=200)
    assert np.abs(found - plane)[INNER].mean() < np.abs(noisy - plane)[INNER].mean() / 4


@pytest.mark.parametrize("offset", [BRICK, SQUARE], ids=["brick", "square"])
def test_what_tells_nothing_continues_the_plane_around_it(offset):
    plane = slope(offset)
    start, known = plane.copy(), np.full(plane.shape, 1e5, "f4")
    start[10:20, 12:22] += 0.02
    known[10:20, 12:22] = 0
    found = fit_surface(start, known, start, FLAT, lattice_axes(offset), **LOOSE, iterations=300)
    assert np.abs(found - plane).max() < 0.004


def test_a_step_stays_where_it_is():
    step = np.where(np.arange(COLUMNS) < 17, -0.2, 0.3).astype("f4") * np.ones((ROWS, 1), "f4")
    known = np.full(step.shape, 1e3, "f4")
    found = fit_surface(step, known, step, FLAT, lattice_axes(BRICK), **TIGHT)
    assert np.abs(found - step).max() < 0.05


def test_unknown_places_stay_unknown_and_tell_nothing():
    plane = slope(BRICK)
    start = plane.copy()
    start[:4] = np.nan
    found = fit_surface(start, np.full(plane.shape, 1e4, "f4"), start, FLAT, lattice_axes(BRICK), **TIGHT)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(start))
    assert np.nanmax(np.abs(found - plane)[6:]) < 0.01


@pytest.mark.parametrize(("doubt", "kept"), [(0.0, True), (0.3, False)])
def test_a_step_of_what_does_not_know_its_disparity_gives_way(doubt, kept):
    step = np.where(np.arange(COLUMNS) < 17, 0.0, 0.2).astype("f4") * np.ones((ROWS, 1), "f4")
    known = np.full(step.shape, 1e3, "f4")
    found = fit_surface(step, known, step, FLAT, lattice_axes(BRICK), **TIGHT | {"jump": np.hypot(0.03, NONE + doubt)})
    assert (np.abs(np.diff(found[INNER], axis=1)).max() > 0.1) == kept


@pytest.mark.parametrize(("known_by_itself", "heals"), [(10, True), (1000, False)])
def test_a_patch_heals_from_its_rim_unless_it_knows_better(known_by_itself, heals):
    start, known = slope(BRICK), np.full((ROWS, COLUMNS), 1e4, "f4")
    start[10:18, 12:20] += 0.3
    known[10:18, 12:20] = known_by_itself
    once, often = (fit_surface(start, known, start, FLAT, lattice_axes(BRICK), **TIGHT, rounds=n) for n in (1, 8))
    off = np.abs(np.array([once, often]) - slope(BRICK)).max(axis=(1, 2))
    assert off[0] > 0.2
    assert (off[1] < 0.01) if heals else (off[1] > 0.25)


def test_a_plane_known_at_few_places_is_continued_over_the_rest():
    t, s = np.mgrid[:20, :24].astype(np.float64)
    truth = 0.3 + 0.004 * s - 0.003 * t
    known = np.random.default_rng(1).random(truth.shape) < 0.3
    target = np.where(known, truth, 5.0).astype(np.float32)
    start = (np.round(truth / 0.05) * 0.05).astype(np.float32)
    guide = np.zeros((20, 24, 1), dtype=np.float32)
    found = fit_surface(target, known * np.float32(1e4), start, guide, square_axes(20), stiffness=2e4,
                        jump=0.08, edge=0.05, rounds=2, iterations=300)  # fmt: skip
    assert np.abs(found - truth)[2:-2, 2:-2].max() < 2e-3


def test_a_noisy_step_stays_where_the_picture_has_its_edge():
    t, s = np.mgrid[:20, :24].astype(np.float64)
    truth = 0.3 + 0.004 * s - 0.003 * t
    truth[:, 12:] += 1
    guide = np.where(np.arange(24) < 12, 0.2, 0.8)[None, :, None].astype(np.float32) * np.ones((20, 1, 1), "float32")
    noise = np.random.default_rng(0).normal(0, 0.02, truth.shape)
    target = (truth + noise).astype(np.float32)
    found = fit_surface(target, np.full_like(target, 1 / 0.02**2), target, guide, square_axes(20), stiffness=5e4,
                        jump=0.08, edge=0.05, rounds=2)  # fmt: skip
    assert np.abs(found - truth)[2:-2, 2:-2].max() < 0.03
    assert (found - truth)[2:-2, 2:-2].std() < 0.4 * noise.std()


@pytest.mark.parametrize("offset", [0.5 * (np.arange(200) % 2), np.zeros(200)], ids=["brick", "square"])
def test_a_plane_known_only_far_away_arrives(offset):
    plane = (0.01 * (np.arange(220)[None] + offset[:, None]) - 0.02 * np.arange(200)[:, None]).astype("f4")
    start, known = plane.copy(), np.full(plane.shape, 1e4, "f4")
    start[60:140, 60:160], known[60:140, 60:160] = plane.mean(), 0
    guide = np.zeros((*plane.shape, 1), "f4")
    found = fit_surface(start, known, start, guide, lattice_axes(offset), stiffness=2e4, jump=1e3, edge=0.05,
                        iterations=160)  # fmt: skip
    assert np.abs(found - plane).max() < np.abs(start - plane).max() / 16
