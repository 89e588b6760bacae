from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.mosaicked.edge_place import place_edges

OFFSET = 0.5 * (np.arange(30) % 2).astype("f4")
X = np.arange(40)[None, :] + OFFSET[:, None]


def picture(texture=0.0):
    near = (X < 20)[None]
    noise = texture * np.random.default_rng(0).standard_normal((3, 30, 40))
    return (np.where(near, 0.7, 0.3) + noise).astype("f4")


@pytest.mark.parametrize("wide", [-1.0, 1.0])
def test_a_step_goes_to_where_the_colour_changes(wide):
    matched = np.where(20 + wide > X, 0.3, -0.2).astype("f4")
    found = place_edges(matched, picture(0.01), OFFSET, 0.866)
    assert (np.abs(matched - np.where(X < 20, 0.3, -0.2)) > 0.1).sum() == 30
    np.testing.assert_allclose(found, np.where(X < 20, 0.3, -0.2), atol=1e-6)


def test_colours_that_do_not_tell_the_sides_apart_move_nothing():
    matched = np.where(X < 21, 0.3, -0.2).astype("f4")
    np.testing.assert_array_equal(place_edges(matched, np.full((3, 30, 40), 0.5, "f4"), OFFSET, 0.866), matched)
    np.testing.assert_array_equal(place_edges(matched, picture(0.5), OFFSET, 0.866), matched)


def test_a_slope_is_no_step():
    slope = (0.02 * X).astype("f4")
    np.testing.assert_array_equal(place_edges(slope, picture(), OFFSET, 0.866), slope)
