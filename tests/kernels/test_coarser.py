"""The coarser grids: a symmetric, positive map that moves whole regions, whatever the rows' offset."""

from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.coarser import levels, precondition

BRICK, SQUARE = 0.5 * (np.arange(37) % 2), np.zeros(37)


def one(place, shape=(37, 42)):
    out = np.zeros(shape, "f4")
    out[place] = 1
    return out


@pytest.mark.parametrize("offset", [BRICK, SQUARE], ids=["brick", "square"])
def test_the_map_is_symmetric_and_positive(offset):
    held, bending = np.random.default_rng(1).uniform(0.5, 2, (2, 37, 42)).astype("f4")
    grids = levels(held, bending, offset)
    a, b = np.random.default_rng(2).normal(size=(2, 37, 42)).astype("f4")
    there, back = (np.vdot(x.astype("f8"), precondition(grids, y)) for x, y in ((a, b), (b, a)))
    assert there == pytest.approx(back, rel=1e-4)
    assert np.vdot(a, precondition(grids, a)) > 0


@pytest.mark.parametrize("place", [(0, 0), (18, 20), (36, 41), (17, 41)])
def test_every_place_moves_with_the_region_around_it(place):
    nothing = np.full((37, 42), 1e-6, "f4")
    moved = precondition(levels(nothing, np.ones((37, 42), "f4"), SQUARE), one(place))
    assert (moved > 0).mean() > 0.25
