from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import lfflow
from lfflow.schema import DISPARITY, lattice_of
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


def test_a_map_without_a_place_is_that_of_the_central_view(scene):
    disp, lf = scene
    xr.testing.assert_identical(
        lfflow.transpose_disparity(disp.drop_vars(["u", "v"]), lf), lfflow.transpose_disparity(disp, lf)
    )


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


def seen_from(scene: tuple[xr.Dataset, xr.Dataset], u: int, v: int) -> xr.Dataset:
    """The map of view (u, v) by formula: the square of the scene lies 0.5·(u, v) lens pitches away there."""
    disp, lf = scene
    row_pitch = lattice_of(lf).row_pitch
    t, s = np.mgrid[:40, :50]
    x, y = s + 0.5 * (t % 2) + 0.5 * u, (t + 0.5 * v / row_pitch)
    near = (x >= 17.9) & (x < 34.1) & (y >= 11.6) & (y < 27.6)
    disparity = np.where(near, np.float32(0.5), np.float32(-0.25))
    return disp.assign(disparity=(("t", "s"), disparity)).assign_coords(u=u, v=v)


def test_what_one_view_does_not_see_is_taken_from_another(scene):
    lf = scene[1]
    views = [(0, 0), (-3, 0), (3, 0)]
    alone = lfflow.transpose_disparity(seen_from(scene, 0, 0), lf).sel(u=4, v=0)
    fused = lfflow.transpose_disparity([seen_from(scene, *view) for view in views], lf).sel(u=4, v=0)
    wanted = seen_from(scene, 4, 0).disparity
    hidden = ((alone.flags & 16) > 0) & (wanted < 0)
    assert int(hidden.sum()) > 20
    inner = {"t": slice(2, -2), "s": slice(4, -4)}
    assert float(((fused.flags & 16) > 0).isel(inner).where(hidden).mean()) < 0.2
    assert float((abs(fused.disparity - wanted) < 0.01).isel(inner).mean()) > 0.98


def test_what_the_other_maps_see_past_is_left_out(scene):
    lf = scene[1]
    views = [(0, 0), (-2, 0), (2, 0), (0, -2), (0, 2)]
    maps = [seen_from(scene, *view) for view in views]
    wrong = maps[0].disparity.copy()
    wrong[3:7, 5:40] = 0.9
    fused = lfflow.transpose_disparity([maps[0].assign(disparity=wrong), *maps[1:]], lf).sel(u=0, v=0)
    inner = {"t": slice(2, -2), "s": slice(2, -2)}
    right = abs(fused.disparity - maps[0].disparity).isel(inner) < 0.01
    assert float(right.mean()) > 0.98
    assert bool(right.sel(t=slice(3, 6)).all())


def test_equal_maps_fuse_to_themselves_and_none_are_refused(scene):
    disp, lf = scene
    fused = lfflow.transpose_disparity([disp, disp], lf).sel(u=0, v=0)
    xr.testing.assert_allclose(fused[list(disp.data_vars)], disp, atol=1e-6)
    with pytest.raises(ValueError, match="no disparity map"):
        lfflow.transpose_disparity([], lf)


def test_full_colour_views_are_places_of_a_square_grid(scene):
    disparity = xr.DataArray(np.where(np.mgrid[:20, :30][1] < 15, 1.0, 0.0).astype("f4"), dims=("t", "s"))
    disp = xr.Dataset({"disparity": disparity, "disparity_std": disparity * 0 + 0.01,
                       "flags": (disparity * 0).astype("u1")}, {"u": 0, "v": 0})  # fmt: skip
    views = xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), np.zeros((3, 3, 20, 30, 3), "f4"))},
                       {"v": [-1, 0, 1], "u": [-1, 0, 1]})  # fmt: skip
    out = lfflow.transpose_disparity(disp, views)
    assert DISPARITY.issues(out) == []
    assert (out.disparity.sel(v=0, u=-1) == 1).sum("s").isin([16]).all()
    assert (out.disparity.sel(v=0, u=1) == 1).sum("s").isin([14]).all()
