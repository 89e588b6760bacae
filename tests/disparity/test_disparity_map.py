from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import lfflow
from tests.conftest import raise_if_dask_computes
from tests.disparity.conftest import lightfield, plane


@pytest.mark.parametrize("d", [-0.4, 0.0, 0.17])
def test_a_plane_has_one_disparity(d):
    out = lfflow.disparity(lightfield(plane(d)))
    inner = out.disparity.isel(t=slice(6, -6), s=slice(6, -6))
    assert float(abs(inner - d).median()) < 0.01
    assert float((abs(inner - d) > 0.1).mean()) < 0.02


def test_threads_do_not_change_a_bit(tilted):
    xr.testing.assert_identical(lfflow.disparity(tilted, threads=3), lfflow.disparity(tilted))


def test_lazy_and_the_same_under_other_chunks_and_orders(tilted):
    expected = lfflow.disparity(tilted)
    with raise_if_dask_computes():
        lazy = lfflow.disparity(tilted.chunk({"v": 1, "u": 1, "t": 20}))
    xr.testing.assert_identical(lazy.compute(), expected)
    xr.testing.assert_identical(lfflow.disparity(tilted.transpose("s", "u", "t", "v", ...)), expected)
    assert expected.disparity.dims == ("t", "s")
    assert int(expected.u) == int(expected.v) == 0
    assert np.issubdtype(expected.flags.dtype, np.uint8)
