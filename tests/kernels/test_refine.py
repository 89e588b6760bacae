from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.completion import complete_centre
from lfflow.kernels.refine import refine

SHAPE = (40, 46)


@pytest.mark.parametrize("off", [-0.03, 0.03])
def test_steps_go_to_the_true_disparity(slab, off):
    start = np.full(SHAPE, 0.3 + off, dtype="f4")
    picture, _ = complete_centre(slab, np.full(SHAPE, 0.3, "f4"), np.full(SHAPE, 0.01, "f4"))
    once = refine(slab, picture, start).disparity
    twice = refine(slab, picture, once).disparity
    errors = [float(np.median(np.abs(d - 0.3)[6:-6, 6:-6])) for d in (start, once, twice)]
    assert errors[1] < errors[0] / 2
    assert errors[2] < 0.007
