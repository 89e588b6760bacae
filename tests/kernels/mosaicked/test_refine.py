from __future__ import annotations

import numpy as np
import pytest

from lfflow.conventions import CFA_NONE
from lfflow.kernels.colour.completion import complete_centre
from lfflow.kernels.mosaicked.refine import evidence

SHAPE = (40, 46)


def told(slab, start, threads=1):
    picture, _ = complete_centre(slab, np.full(SHAPE, 0.3, "f4"), np.full(SHAPE, 0.01, "f4"))
    return evidence(slab, picture, start, views=slab.views(), noise=0.01, threads=threads)


@pytest.mark.parametrize("off", [-0.03, 0.03])
def test_steps_go_to_the_true_disparity(slab, off):
    start = np.full(SHAPE, 0.3 + off, dtype="f4")
    once = told(slab, start).disparity
    twice = told(slab, once).disparity
    errors = [float(np.median(np.abs(d - 0.3)[6:-6, 6:-6])) for d in (start, once, twice)]
    assert errors[1] < errors[0] / 2
    assert errors[2] < 0.01


def test_threads_do_not_change_a_bit(slab):
    start = np.full(SHAPE, 0.3, dtype="f4")
    for one, other in zip(told(slab, start), told(slab, start, threads=3), strict=True):
        np.testing.assert_array_equal(one, other)


def test_carriers_are_the_samples_that_have_texture(slab):
    start = np.full(SHAPE, 0.3, dtype="f4")
    inner = (slice(8, -8), slice(8, -8))
    everything = np.median(told(slab, start).carriers[inner])
    assert 0.2 < everything < 1
    plain = [slab.cfa == colour for colour in (0, 2)]
    mosaic = slab.mosaic.copy()
    for where in plain:
        mosaic[where] = mosaic[where].mean()
    green = np.median(told(slab._replace(mosaic=mosaic), start).carriers[inner])
    share = (slab.cfa == 1).sum() / (slab.cfa != CFA_NONE).sum()
    assert green / everything == pytest.approx(share, abs=0.1)
