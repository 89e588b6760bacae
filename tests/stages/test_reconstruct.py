from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from analytic_field import make_field, scene

from lfflow.errors import SchemaError
from lfflow.schema import VIEWS
from lfflow.stages.reconstruct import reconstruct_views

BORDER = slice(6, -6)


def psnr(found: xr.DataArray, truth: xr.DataArray) -> float:
    error = (found - truth).isel(t=BORDER, s=BORDER)
    return float(-10 * np.log10((error**2).mean()))


@pytest.mark.parametrize(("d", "least"), [(0.0, 100.0), (0.05, 50.0), (0.3, 47.0), (-0.8, 47.0)])
def test_a_plane_comes_back_in_every_colour(d: float, least: float) -> None:
    lf, disp, truth = make_field([(d, -99.0)])
    lf = lf.assign_coords(color_matrix=(("channel", "channel_in"), np.eye(3)))
    views = reconstruct_views(lf, disp, views={"v": [0], "u": [0, 2]})
    assert psnr(views["rgb"], truth["rgb"].sel(v=[0], u=[0, 2])) > least
    assert views["color_matrix"].dims == ("channel", "channel_in")
    assert VIEWS.issues(views) == []


def test_rows_that_see_no_red_take_it_from_beside_and_say_so() -> None:
    lf, disp, truth = make_field([(1.4, -99.0)], noise=0.01)
    disp["disparity_std"][:] = 0.1
    some = {"v": [-2, 0, 2], "u": [-2, 0, 2]}
    views = reconstruct_views(lf, disp, views=some)
    inside = {"t": slice(9, -9), "s": slice(9, -9), "v": 1, "u": 1}
    error = (views["rgb"] - truth["rgb"].sel(some)).isel(inside)
    assert float(abs(error).max()) < 0.06
    filled = views["filled"].isel(inside)
    assert 0.2 < float(((filled & 5) > 0).mean()) < 0.9
    assert not (filled & 8).any()


def test_both_sides_of_an_occlusion_edge_come_back() -> None:
    lf, disp, truth = make_field([(-0.2, -99.0), (0.4, 20.3)])
    views = reconstruct_views(lf, disp, views={"v": [0], "u": [-2, 0]})
    assert psnr(views["rgb"], truth["rgb"].sel(v=[0], u=[-2, 0])) > 44


def test_the_square_grid_at_any_scale_shows_the_same_scene() -> None:
    lf, disp, _ = make_field([(0.3, -99.0)])
    for scale in (1.0, 2.0, 1.5):
        views = reconstruct_views(lf, disp, views={"v": [0], "u": [0]}, scale=scale)
        y, x = np.meshgrid(views["t"] / scale, views["s"] / scale, indexing="ij")
        truth, _ = scene(x, y, np.zeros_like(x), np.zeros_like(x), [(0.3, -99.0)])
        assert psnr(views["rgb"].isel(v=0, u=0), xr.DataArray(truth, dims=("t", "s", "channel"))) > 43
        assert int(views["arrangement"]) == 1
        assert float(views["scale"]) == scale


def test_a_viewpoint_between_the_views() -> None:
    lf, disp, _ = make_field([(0.3, -99.0)])
    views = reconstruct_views(lf, disp, views={"v": [0.5], "u": [-1.25]})
    t, s = np.meshgrid(np.arange(48), np.arange(44), indexing="ij")
    x, y = s + 0.5 * (t % 2), t * np.sqrt(3) / 2 * 10.01028 / 10.00861
    truth, _ = scene(x, y, np.full(x.shape, -1.25), np.full(x.shape, 0.5), [(0.3, -99.0)])
    assert psnr(views["rgb"].isel(v=0, u=0), xr.DataArray(truth, dims=("t", "s", "channel"))) > 47


def test_lazy_and_eager_agree_in_any_order_and_nothing_is_computed_early(no_compute: None) -> None:
    lf, disp, _ = make_field([(0.2, -99.0)], shape=(20, 18), radius=2)
    eager = reconstruct_views(lf, disp)
    two = xr.concat([lf, lf], "capture").assign_coords(capture=["a", "b"])
    chunked = two.chunk({"capture": 1, "t": 7, "u": 1}).transpose("s", "capture", "u", "v", "t", ...)
    lazy = reconstruct_views(chunked, disp.chunk({"v": 2}))
    assert lazy["rgb"].chunksizes["v"] == (1,) * 5
    one = lazy.sel(capture="b", u=1, v=[-1])["rgb"].compute(scheduler="synchronous")
    np.testing.assert_array_equal(one, eager["rgb"].sel(u=1, v=[-1]))


def test_a_slice_of_the_field_keeps_its_geometry() -> None:
    lf, disp, truth = make_field([(0.3, -99.0)])
    part = {"t": slice(5, None), "s": slice(3, None)}
    views = reconstruct_views(lf.isel(part), disp.isel(part), views={"v": [0], "u": [0]})
    assert psnr(views["rgb"], truth["rgb"].sel(v=[0], u=[0]).isel(part)) > 47


def test_places_without_disparity_are_filled_from_their_neighbours_and_flagged() -> None:
    lf, disp, truth = make_field([(0.0, -99.0)])
    hole = disp.copy(deep=True)
    hole["disparity"][:, :, 20, 20] = np.nan
    views = reconstruct_views(lf, hole, views={"v": [0], "u": [0]}).isel(v=0, u=0)
    assert int(views["filled"][20, 20]) == 7
    assert int((views["filled"].isel(t=BORDER, s=BORDER) != 0).sum()) == 1
    np.testing.assert_allclose(views["rgb"][20, 20], truth["rgb"].sel(v=0, u=0)[20, 20], atol=0.05)


def test_disparity_of_one_view_is_refused() -> None:
    lf, disp, _ = make_field([(0.0, -99.0)], shape=(8, 8), radius=1)
    with pytest.raises(SchemaError, match="transpose_disparity"):
        reconstruct_views(lf, disp.sel(v=0, u=0))
