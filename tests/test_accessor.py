"""What ``ds.lf`` shows of a light field, on simulated captures."""

from __future__ import annotations

import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

from lfflow.errors import LfflowError
from lfflow.lattice import Lattice
from lfflow.schema import lattice_of
from lfflow.simulate import simulate_white
from lfflow.stages.demultiplex import demultiplex
from lfflow.stages.radiometry import apply_gamma, correct_colour, normalise, white_balance
from lfflow.stages.samples import from_lftoolbox, saturated, usable_views
from lfflow.stages.square import square, upright

mpl.use("Agg")


@pytest.fixture(scope="module")
def white() -> tuple[xr.Dataset, xr.Dataset]:
    raw, truth = simulate_white(height=230, width=260, noise=False)
    truth["pixel_flags"] = truth.defects.astype(np.uint8)
    return raw, truth


@pytest.fixture(scope="module")
def field(white: tuple[xr.Dataset, xr.Dataset]) -> xr.Dataset:
    return demultiplex(*white)


def test_a_gray_scene_is_flat_in_every_view(field: xr.Dataset) -> None:
    bright = field.mosaic.where(field.weight >= 0.3)
    for colour in range(3):
        values = bright.where(field.cfa == colour)
        spread = values.std(("t", "s")) / values.mean()
        assert float(spread.max()) < 0.005
        assert float(abs(values.mean(("t", "s")) / values.mean() - 1).max()) < 0.005


def test_normalise_is_the_levels_of_each_site(white: tuple[xr.Dataset, xr.Dataset]) -> None:
    raw, _ = white
    expected = (raw.raw.astype(float) - 168) / (4095 - 168)
    np.testing.assert_allclose(normalise(raw), expected, atol=1e-6)
    turned = normalise(raw.transpose("x", "y", ...).chunk(x=50))
    assert turned.dims == ("x", "y")
    np.testing.assert_array_equal(turned.transpose("y", "x"), normalise(raw))


def test_white_balance_of_a_mosaic_is_that_of_its_colours(field: xr.Dataset) -> None:
    gains = xr.DataArray([2.0, 1.0, 3.0], dims="channel", coords={"channel": ["R", "G", "B"]})
    balanced = white_balance(field, gains)
    for colour, gain in enumerate(gains.values):
        mine = field.cfa.values == colour
        np.testing.assert_allclose(balanced.mosaic.values[mine], gain * field.mosaic.values[mine], rtol=1e-6)


def test_colour_matrix_and_gamma() -> None:
    rgb = xr.DataArray(np.array([[0.2, 0.5, 0.1]], np.float32), dims=("s", "channel"),
                       coords={"channel": ["R", "G", "B"], "gamma": 0.4167})  # fmt: skip
    matrix = xr.DataArray(np.arange(9.0).reshape(3, 3), dims=("channel", "channel_in"))
    np.testing.assert_allclose(correct_colour(rgb, matrix)[0], matrix.values @ [0.2, 0.5, 0.1], rtol=1e-6)
    np.testing.assert_allclose(apply_gamma(rgb), rgb.values**0.4167, rtol=1e-5)
    with pytest.raises(LfflowError, match="color_matrix"):
        correct_colour(rgb)


def test_views_and_epipolar_images_are_selections(field: xr.Dataset) -> None:
    xr.testing.assert_identical(field.lf.view(u=-2, v=1), field.sel(u=-2, v=1))
    assert field.mosaic.lf.epi(t=7).dims == ("u", "s")
    assert field.lf.epi(s=4, u=2).mosaic.dims == ("v", "t")
    with pytest.raises(LfflowError, match="lens row"):
        field.lf.epi()


def test_the_residual_is_what_rounding_did(field: xr.Dataset) -> None:
    rho = field.lf.residual()
    x, y = lattice_of(field).centres(field.t.values[:, None], field.s.values)
    np.testing.assert_allclose(rho.rho_x + x, np.floor(x + 0.5))
    np.testing.assert_allclose(rho.rho_y + y, np.floor(y + 0.5))
    part = field.isel(t=slice(3, 9), s=slice(2, 5)).lf.residual()
    np.testing.assert_array_equal(part.rho_x, rho.rho_x.isel(t=slice(3, 9), s=slice(2, 5)))


@pytest.mark.parametrize("scale", [1, 2])
def test_a_plane_keeps_its_place_on_the_square_grid(scale: int) -> None:
    lattice = Lattice(10.0, 9.7, 0.01, 3, 4)
    t, s = np.mgrid[:20, :24]
    x, y = s + lattice.row_offset(t), t * lattice.row_pitch
    plane = xr.DataArray((2 + 0.3 * x - 0.7 * y).astype(np.float32), dims=("t", "s"), coords={"t": t[:, 0], "s": s[0]})
    plane = plane.assign_coords(dh=lattice.dh, dv=lattice.dv, theta=lattice.theta, cx=lattice.cx, cy=lattice.cy)
    plane = plane.assign_coords(arrangement=np.uint8(0))
    out = square(plane, scale)
    assert out.sizes["t"] == pytest.approx(19 * lattice.row_pitch * scale + 1, abs=0.5)
    expected = 2 + 0.3 * out.s / scale - 0.7 * out.t / scale
    inner = {"t": slice(2, -2), "s": slice(2, -2)}
    np.testing.assert_allclose(out.isel(inner), expected.transpose("t", "s").isel(inner), atol=2e-5)
    np.testing.assert_array_equal(square(plane.T.chunk(s=5), scale).T, out)


def test_square_colours_are_never_mixed(field: xr.Dataset) -> None:
    flat = field.assign(mosaic=field.mosaic.where(field.cfa == 255, field.cfa.astype(np.float32)))
    rgb = flat.chunk().lf.square(2)
    assert rgb.chunks is not None
    np.testing.assert_allclose(rgb.sel(u=0, v=0).isel(t=slice(8, -8), s=slice(8, -8)).mean(("t", "s")), [0, 1, 2])


@pytest.mark.parametrize("orientation", range(1, 9))
def test_upright_keeps_the_sign_of_disparity(orientation: int) -> None:
    """A point at X − d·u stays a point at X' − d·u' after any turn."""
    v, u, t, s = np.meshgrid([-1, 0, 1], [-1, 0, 1], np.arange(15), np.arange(17), indexing="ij")
    field = ((s == 8 - 2 * u) & (t == 5 - 2 * v)).astype(np.float32)
    da = xr.DataArray(field, dims=("v", "u", "t", "s"), coords={"v": [-1, 0, 1], "u": [-1, 0, 1],
                                                                "t": np.arange(15), "s": np.arange(17)})  # fmt: skip
    turned = upright(da, orientation)
    assert turned.dims == da.dims
    t0, s0 = np.argwhere(turned.sel(u=0, v=0).values)[0]
    for view_v in (-1, 0, 1):
        for view_u in (-1, 0, 1):
            where = np.argwhere(turned.sel(u=view_u, v=view_v).values)
            np.testing.assert_array_equal(where, [[t0 - 2 * view_v, s0 - 2 * view_u]])
    assert np.all(np.diff(turned.u) > 0)
    assert turned.sizes["t"] == (17 if orientation > 4 else 15)


def test_orientation_six_turns_clockwise() -> None:
    da = xr.DataArray([[1, 2, 3], [4, 5, 6]], dims=("t", "s"), coords={"t": [0, 1], "s": [0, 1, 2]})
    np.testing.assert_array_equal(upright(da, 6), np.rot90(da.values, -1))
    np.testing.assert_array_equal(upright(da, 8), np.rot90(da.values, 1))
    np.testing.assert_array_equal(upright(da, 3), np.rot90(da.values, 2))


def test_lftoolbox_and_back(field: xr.Dataset) -> None:
    away = field.lf.to_lftoolbox()
    assert away.mosaic.dims == ("t", "s", "v", "u")
    assert float(away.mosaic.sel(t=0, s=2, v=9, u=8)) == float(field.mosaic.sel(v=0, u=2, t=9, s=8))
    xr.testing.assert_identical(from_lftoolbox(away), field)


@pytest.mark.parametrize(
    "program",
    [
        "import lfflow, xarray; xarray.Dataset().lf",
        "import xarray, lfflow; xarray.DataArray(1).lf",
        "import lfflow.lattice, sys; assert 'xarray' not in sys.modules; import xarray as xr; xr.Dataset().lf",
        "import lfflow; from xarray import Dataset; Dataset().lf; import importlib.resources as r; r.files('xarray')",
    ],
)
def test_the_accessor_is_there_in_any_order_of_imports(program: str) -> None:
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_views_hold_the_samples_of_usable_views_alone(field: xr.Dataset, no_compute: None) -> None:
    usable = field.view_usable.values
    assert 0 < usable.sum() < usable.size
    for given in (field, field.transpose("s", "u", "t", "v", ...), field.expand_dims(capture=["A", "B"])):
        views = given.lf.views
        assert views.mosaic.dims == given.mosaic.dims
        mine = views.transpose(..., "v", "u", "t", "s")
        assert (mine.cfa.values[..., ~usable, :, :] == 255).all()
        assert np.isnan(mine.mosaic.values[..., ~usable, :, :]).all()
        assert (mine.weight.values[..., ~usable, :, :] == 0).all()
        part = mine.mosaic.values[..., usable, :, :]
        np.testing.assert_array_equal(part, np.broadcast_to(field.mosaic.values[usable], part.shape))
        assert mine.mosaic.dtype == np.float32
        assert mine.cfa.dtype == np.uint8
    lazy = field.chunk(v=1).lf.views
    assert lazy.mosaic.chunks
    xr.testing.assert_identical(lazy.compute(scheduler="synchronous"), field.lf.views)
    told = usable_views(field.drop_vars("view_usable"))
    np.testing.assert_array_equal(told, field.view_usable)
    assert (told.dims, told.attrs) == (field.view_usable.dims, field.view_usable.attrs)


def test_pictures_take_every_step_or_say_which_they_cannot(field: xr.Dataset) -> None:
    matrix, gains, gamma = field.color_matrix.values, field.white_balance.values, float(field.gamma)
    dim = field.assign(mosaic=field.mosaic * np.float32(0.2)).sel(u=0, v=0)
    rgb = square(dim)
    expected = np.clip((rgb.values * (gains / gains.min())).clip(max=1) @ matrix.T, 0, 1) ** gamma
    np.testing.assert_allclose(dim.lf.picture(), expected, atol=1e-5)
    np.testing.assert_allclose(rgb.lf.picture(camera=field), expected, atol=1e-5)
    assert dim.chunk().lf.picture().chunks
    with pytest.raises(LfflowError, match="camera="):
        rgb.lf.picture()
    plain = rgb.drop_vars("camera_model")
    np.testing.assert_allclose(plain.lf.picture(), rgb.clip(0, 1) ** gamma, atol=1e-5)


def test_usable_views_and_clipped_samples(field: xr.Dataset) -> None:
    usable = usable_views(field)
    assert bool(usable.sel(u=0, v=0))
    assert not bool(usable.sel(u=5, v=5))
    assert not saturated(field).any()


def test_plot_and_repr(field: xr.Dataset) -> None:
    assert field.lf.plot().get_array().shape[-1] in (3, 4)
    assert field.weight.lf.plot(u=1).get_array().ndim == 2
    page = field.lf._repr_html_()
    assert "missing" in page
    assert "10.0" in page
    assert "of them usable" in page
    assert "not computed yet" in repr(field.chunk().lf)
    assert "hardly any light" in field.lf.plot(u=5, v=5).axes.get_title()
    two = xr.concat([field, field.assign_coords(capture="OTHER")], "capture")
    assert "captures 2" in repr(two.lf)
    assert f"{int(field.view_usable.sum())} of them usable" in repr(two.lf)


def test_nothing_is_computed_before_asked(field: xr.Dataset, no_compute: None) -> None:
    lazy = field.chunk(t=9)
    for view in (lazy.lf.view(1, 1), lazy.lf.epi(t=3), lazy.lf.square(2), lazy.lf.saturated(), lazy.lf.to_lftoolbox(),
                 white_balance(lazy, xr.DataArray([1.0, 2, 3], dims="channel")), lazy.lf.usable_views()):  # fmt: skip
        assert view.chunks
