"""The costs of the second pass, and the band they are looked at in."""

from __future__ import annotations

import numpy as np

from lfflow.kernels.colour.completion import complete_centre
from lfflow.kernels.mosaicked.model_cost import model_costs
from lfflow.kernels.mosaicked.mosaic_field import mosaic_field
from lfflow.schema import lattice_of
from tests.mosaic_fields import lightfield, plane


def test_the_band_leaves_out_what_lies_outside_and_nothing_else():
    lf = lightfield(plane(0.25), shape=(24, 28))
    arrays = [lf[name].to_numpy() for name in ("mosaic", "cfa", "weight")]
    field = mosaic_field(*arrays, tuple(lf[dim].to_numpy() for dim in ("v", "u", "t", "s")), lattice_of(lf))
    truth = np.full((24, 28), 0.25, np.float32)
    picture, _ = complete_centre(field, truth, 0 * truth)
    labels = np.array([-0.25, 0.0, 0.25, 0.5])
    whole = model_costs(field, picture, labels)
    banded = model_costs(field, picture, labels, band=(truth - 0.3, truth + 0.1))
    assert np.isnan(banded[:, [0, 3]]).all()
    np.testing.assert_array_equal(banded[:, 1:3], whole[:, 1:3])
    inner = whole.mean(axis=0)[:, 6:-6, 6:-6]
    assert (inner.argmin(axis=0) == 2).mean() > 0.95
