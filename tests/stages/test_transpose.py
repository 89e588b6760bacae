from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import lfflow
from lfflow.schema import DISPARITY
from tests.conftest import raise_if_dask_computes
from tests.mosaic_fields import lightfield, plane


@pytest.fixture(scope="module")
def scene() -> tuple[xr.Dataset, xr.Dataset]:
    """A square at d = 0.5 before a background at d = −0.25."""
    lf = lightfield(plane(0.0), shape=(40, 50))
    d = np.full((40, 50), -0.25, dtype=np.float32)
    d[12:28, 18:34] = 0.5
    coords = {name: lf[name] for name in ("t", "s", "dh", "dv", "theta", "cx", "cy", "arrangement")}
    maps = {"disparity": d, "disparity_std": np.full_like(d, 0.01), "flags": np.zeros(d.shape, dtype=np.uint8)}
    disp = xr.Dataset({name: (("t", "s"), value) for name, value in maps.items()}, coords={**coords, "u": 0, "v": 0})
    return disp, lf


def test_the_schema_and_the_central_view(scene):
    out = lfflow.transpose_disparity(*scene)
    assert DISPARITY.issues(out) == []
    xr.testing.assert_equal(out.disparity.sel(u=0, v=0, drop=True), scene[0].disparity.drop_vars(["u", "v"]))


@pytest.mark.parametrize(("u", "v"), [(4, 0), (-4, 0), (0, 3), (0, -3), (3, 2)])
def test_the_near_square_moves_against_the_view_and_hides_what_is_behind(scene, u, v):
    near = lfflow.transpose_disparity(*scene).disparity.sel(u=u, v=v) > 0
    rows, columns = np.nonzero(near.to_numpy())
    assert (columns + 0.5 * (rows % 2)).mean() == pytest.approx(25.5 + 0.25 - 0.5 * u, abs=0.3)
    assert rows.mean() == pytest.approx(19.5 - 0.5 * v / 0.8662, abs=0.6)
    assert len(rows) == pytest.approx(16 * 16, abs=20)


def test_holes_are_filled_from_the_background_and_flagged(scene):
    out = lfflow.transpose_disparity(*scene).sel(u=4, v=0)
    filled = (out.flags & 16) > 0
    assert int(filled.sum()) > 20
    assert set(np.unique(out.disparity.where(filled).to_numpy()[filled.to_numpy()])) == {np.float32(-0.25)}
    assert ((out.flags & 8) > 0).equals(filled)
    assert out.disparity.notnull().all()


def test_a_slanted_surface_cracks_without_flags(scene):
    disp, lf = scene
    ramp = disp.assign(disparity=disp.disparity * 0 + xr.DataArray(np.linspace(-1, 1, 50, dtype="f4"), dims="s"))
    out = lfflow.transpose_disparity(ramp, lf).sel(u=-3, v=0).isel(s=slice(8, -8))
    assert int(((out.flags & 16) > 0).sum()) == 0


def test_lazy(scene):
    disp, lf = scene
    with raise_if_dask_computes():
        lazy = lfflow.transpose_disparity(disp.chunk({"t": 7}), lf)
    xr.testing.assert_identical(lazy.compute(), lfflow.transpose_disparity(disp, lf))
