from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import lfflow
from lfflow.errors import SchemaError
from tests.conftest import raise_if_dask_computes
from tests.mosaic_fields import lightfield, plane


def flats(X, Y, a, b, colour):
    return np.array([0.2, 0.5, 0.9])[np.minimum(colour, 2)]


def dark(X, Y, a, b, colour):
    return 0.0 * X


def test_three_flat_colours_cost_exactly_nothing():
    lf = lightfield(flats)
    costs = lfflow.pair_costs(lf, pairs=[(2, 0), (-4, 0), (1, 0), (0, 2), (0, 3), (2, 2)])
    assert float(costs.max()) == 0.0
    assert int(costs.sel(pair_u=2, pair_v=0).notnull().sum()) > 0


def test_odd_steps_along_a_row_of_an_f01_never_meet_their_colour():
    lf = lightfield(flats)
    costs = lfflow.pair_costs(lf, pairs=[(1, 0), (2, 0)], hypotheses=[0.0])
    assert costs.sel(pair_u=1).isnull().all()
    assert costs.sel(pair_u=2).notnull().mean() > 0.98


@pytest.mark.parametrize(("pair", "d"), [((2, 0), 0.25), ((-2, 0), 0.25), ((0, 2), 0.866 / 2), ((0, -2), 0.866 / 2),
                                         ((2, 0), -0.5), ((0, 4), -0.866 / 2)])  # fmt: skip
def test_a_point_moves_against_the_view(pair, d):
    """One bright lens at X in view 0 is found at X − d·a: sign and row pitch, in all four directions."""
    lf = lightfield(dark, with_rho=False).load()
    lf["cfa"][:] = 1
    t, s = 24, 30
    from lfflow.schema import lattice_of

    lattice = lattice_of(lf)
    down = round(-d * pair[1] / lattice.row_pitch)
    across = -d * pair[0] + 0.5 * (t % 2) - 0.5 * ((t + down) % 2)
    lf["mosaic"].loc[{"u": 0, "v": 0, "t": t, "s": s}] = 1.0
    for part, share in ((np.floor(across), 1 - across % 1), (np.floor(across) + 1, across % 1)):
        lf["mosaic"].loc[{"u": pair[0], "v": pair[1], "t": t + down, "s": s + int(part)}] = share
    costs = lfflow.pair_costs(lf, pairs=[pair], hypotheses=[-d, 0.0, d], sigma=0.6).isel(pair=0, t=t, s=s)
    assert int(costs.argmin("hypothesis")) == 2


def test_costs_are_sliced_by_label():
    lf = lightfield(flats, shape=(20, 24))
    costs = lfflow.pair_costs(lf)
    row = costs.sel(pair_u=2).isel(t=10)
    assert row.dims == ("pair_v", "hypothesis", "s")
    assert float(costs.hypothesis.min()) == -1.0
    assert float(costs.hypothesis.max()) == 1.0
    assert float(costs.hypothesis.diff("hypothesis")[0]) == pytest.approx(0.5 / 4)


def test_lazy_and_the_same_under_other_chunks_and_orders(tilted):
    options = {"pairs": [(2, 0), (0, 2)], "hypotheses": [0.0, 0.25, 0.5]}
    expected = lfflow.pair_costs(tilted, **options)
    for chunks in ({"v": 1, "u": 1}, {"t": 13, "s": 17}):
        with raise_if_dask_computes():
            lazy = lfflow.pair_costs(tilted.chunk(chunks), **options)
        assert lazy.chunks is not None
        xr.testing.assert_identical(lazy.compute(), expected)
    turned = lfflow.pair_costs(tilted.transpose("s", "v", "t", "u", ...), **options)
    xr.testing.assert_identical(turned, expected)
    pile = xr.concat([tilted, tilted], dim=xr.IndexVariable("capture", ["a", "b"]))
    xr.testing.assert_equal(lfflow.pair_costs(pile, **options).isel(capture=1, drop=True), expected)


def test_the_input_stays_as_it_was(tilted):
    before = tilted.copy(deep=True)
    lfflow.pair_costs(tilted, pairs=[(2, 0)], hypotheses=[0.0])
    xr.testing.assert_identical(before, tilted)


def test_a_block_with_too_little_support_has_no_cost():
    lf = lightfield(flats)
    lf["cfa"].loc[{"u": 2, "v": 0}] = 255
    assert lfflow.pair_costs(lf, pairs=[(2, 0)], hypotheses=[0.0]).isnull().all()


def test_samples_beyond_a_wrap_of_the_rounding_are_no_partners():
    """With rho in the samples and no texture across colours, the true disparity costs least in every row."""
    lf = lightfield(plane(0.25, sharpest=0.2), shape=(40, 100))
    costs = lfflow.pair_costs(lf, pairs=[(4, 0)]).isel(pair=0)
    best = costs.hypothesis[costs.fillna(np.inf).argmin("hypothesis")].where(costs.notnull().any("hypothesis"))
    inner = best.isel(t=slice(5, -5), s=slice(8, -8))
    assert float(abs(inner - 0.25).max()) <= 0.13


def test_what_is_no_light_field_is_refused(tilted):
    with pytest.raises(SchemaError, match="cfa"):
        lfflow.pair_costs(tilted.drop_vars("cfa"))
    with pytest.raises(ValueError, match="leaves"):
        lfflow.pair_costs(tilted, pairs=[(9, 0)])
    with pytest.raises(ValueError, match="bilinear"):
        lfflow.pair_costs(tilted, interpolation="bilinear")
