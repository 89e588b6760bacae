from __future__ import annotations

import numpy as np

from lfflow.kernels.colour.completion import complete_centre
from tests.mosaic_fields import waves

SHAPE = (40, 46)


def test_the_completed_view_is_the_picture(slab):
    picture, weight = complete_centre(slab, np.full(SHAPE, 0.3, "f4"), np.full(SHAPE, 0.01, "f4"))
    X = np.arange(SHAPE[1])[None, :] + slab.offset[:, None]
    Y = np.arange(SHAPE[0])[:, None] * slab.row_pitch + 0 * X
    for colour in range(3):
        truth = waves(4, sharpest=0.2)(X, Y, np.full(X.shape, colour))
        error = (picture[colour] - truth)[6:-6, 6:-6]
        assert np.sqrt(np.mean(error**2)) < 0.15 * truth.std()
    assert (weight[:, 6:-6, 6:-6] > 0.05).mean() > 0.95
