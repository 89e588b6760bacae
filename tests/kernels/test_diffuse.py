from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.diffuse import diffuse

SHAPE = (26, 30)


@pytest.mark.parametrize("brick", [False, True])
def test_a_hole_in_a_plane_is_filled_with_the_plane(brick):
    offset = (0.5 * (np.arange(SHAPE[0]) % 2) * brick).astype("f4")
    plane = 0.01 * (np.arange(SHAPE[1])[None, :] + offset[:, None]) - 0.02 * np.arange(SHAPE[0])[:, None]
    trusted = np.ones(SHAPE, dtype=bool)
    trusted[8:18, 9:21] = False
    start = np.where(trusted, plane, 3.0).astype("f4")
    found = diffuse(start, trusted, np.zeros(SHAPE, "f4"), np.zeros((*SHAPE, 1), "f4"), offset, edge=0.1)
    assert np.abs(found - plane).max() < 2e-3
    np.testing.assert_array_equal(found[trusted], start[trusted])


def test_each_side_of_an_edge_is_filled_from_itself():
    offset = (0.5 * (np.arange(SHAPE[0]) % 2)).astype("f4")
    left = np.broadcast_to(np.arange(SHAPE[1]) < 15, SHAPE)
    truth = np.where(left, 0.4, -0.3).astype("f4")
    trusted = np.zeros(SHAPE, dtype=bool)
    trusted[:, :3] = trusted[:, -3:] = True
    start = np.where(trusted, truth, 0).astype("f4")
    found = diffuse(start, trusted, np.zeros(SHAPE, "f4"), np.where(left, 0.2, 0.8)[..., None].astype("f4"), offset,
                    edge=0.05)  # fmt: skip
    assert np.abs(found - truth).max() < 0.05


def test_what_a_place_tells_itself_counts_by_its_weight():
    trusted = np.zeros(SHAPE, dtype=bool)
    trusted[0] = True
    start = np.ones(SHAPE, "f4")
    start[0] = 0
    heavy = diffuse(start, trusted, np.full(SHAPE, 100, "f4"), np.zeros((*SHAPE, 1), "f4"), np.zeros(26, "f4"), edge=1)
    light = diffuse(start, trusted, np.full(SHAPE, 0.01, "f4"), np.zeros((*SHAPE, 1), "f4"), np.zeros(26, "f4"), edge=1)
    assert heavy[1].mean() > 0.95
    assert light[1].mean() < 0.2


def test_unknown_places_stay_unknown_and_say_nothing():
    start = np.full(SHAPE, 0.25, "f4")
    start[5:8, 5:8] = np.nan
    trusted = np.isfinite(start) & (np.arange(30) % 4 == 0)
    found = diffuse(start, trusted, np.zeros(SHAPE, "f4"), np.zeros((*SHAPE, 1), "f4"), np.zeros(26, "f4"), edge=1)
    assert np.isnan(found[5:8, 5:8]).all()
    np.testing.assert_allclose(found[np.isfinite(found)], 0.25, atol=1e-5)
