from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from analytic_field import lens_places, make_field, scene

import lfflow.accessor  # noqa: F401
from lfflow.errors import LfflowError
from lfflow.lattice import Lattice
from lfflow.schema import lattice_of
from lfflow.stages.refocus import all_in_focus, aperture, depth_of_field, refocus

INNER = {"t": slice(10, -10), "s": slice(10, -10)}


def views_of(layers: list[tuple[float, float]]) -> xr.Dataset:
    _, disp, views = make_field(layers)
    views = views.assign_coords(color_matrix=(("channel", "channel_in"), np.eye(3)))
    return views.assign(disparity=disp["disparity"])


def energy(picture: xr.DataArray) -> float:
    """Gradient energy along the rows."""
    return float((picture.isel(INNER).diff("s") ** 2).mean())


@pytest.mark.parametrize("d", [0.0, 0.17, -0.5])
def test_the_plane_in_focus_is_as_sharp_as_in_the_view(d: float) -> None:
    views = views_of([(d, -99.0)])
    sharp = views["rgb"].sel(u=0, v=0)
    assert energy(refocus(views, d)) == pytest.approx(energy(sharp), rel=0.05)
    np.testing.assert_allclose(refocus(views, d).isel(INNER), sharp.isel(INNER), atol=0.01)
    assert energy(refocus(views, d + 0.3)) < 0.7 * energy(sharp)


def test_a_focal_stack_is_one_dim_and_equals_its_planes() -> None:
    views = views_of([(0.1, -99.0)])
    stack = refocus(views, [-0.1, 0.0, 0.1])
    assert stack.dims == ("d", "t", "s", "channel")
    np.testing.assert_array_equal(stack.sel(d=0.1), refocus(views, 0.1))


def test_a_square_grid_is_refocused_in_its_own_pitch() -> None:
    scale, d = 2.0, 0.3
    axis = np.arange(-2, 3)
    y, x = np.meshgrid(np.arange(60) / scale, np.arange(64) / scale, indexing="ij")
    rgb, _ = scene(x, y, axis[None, :, None, None], axis[:, None, None, None], [(d, -99.0)])
    coords = {"dh": 5.0, "dv": 5.0, "arrangement": np.uint8(1), "scale": scale}
    ds = xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), rgb)}, {"v": axis, "u": axis, **coords})
    ds = ds.assign_coords(t=np.arange(60), s=np.arange(64))
    np.testing.assert_allclose(refocus(ds, d).isel(INNER), ds["rgb"].sel(u=0, v=0).isel(INNER), atol=0.01)


def test_apertures() -> None:
    views = views_of([(0.4, -99.0)])
    single = refocus(views, 0.1, aperture_function="single")
    np.testing.assert_allclose(single.isel(INNER), views["rgb"].sel(u=0, v=0).isel(INNER), atol=1e-5)
    ring, disc = aperture(views, "ring"), aperture(views, "disc")
    assert float(ring.sel(u=0, v=0)) == 0
    assert float(disc.sel(u=4, v=4)) == 0
    given = xr.zeros_like(disc).assign_coords(disc.coords)
    given.loc[{"v": 1, "u": 2}] = 2.0
    np.testing.assert_allclose(
        refocus(views, 0.4, aperture_function=given).isel(INNER),
        views["rgb"].sel(u=0, v=0).isel(INNER),
        atol=0.01,
    )
    with pytest.raises(LfflowError, match="no aperture"):
        refocus(views, aperture_function="star")


def test_all_in_focus_keeps_both_layers_and_a_narrow_depth_of_field_one() -> None:
    views = views_of([(-0.3, -99.0), (0.3, 22.0)])
    sharp = views["rgb"].sel(u=0, v=0)
    near, far = {"t": slice(10, -10), "s": slice(28, 36)}, {"t": slice(10, -10), "s": slice(6, 16)}
    whole = all_in_focus(views)
    for part in (near, far):
        np.testing.assert_allclose(whole.isel(part), sharp.isel(part), atol=0.012)
    narrow = depth_of_field(views, 0.3, 0.1)
    np.testing.assert_allclose(narrow.isel(near), sharp.isel(near), atol=0.012)
    assert float((narrow.isel(far).diff("s") ** 2).mean()) < 0.7 * float((sharp.isel(far).diff("s") ** 2).mean())


def test_the_accessor_pipes_to_the_same_functions() -> None:
    views = views_of([(0.1, -99.0)])
    np.testing.assert_array_equal(views.lf.refocus(d=0.1), refocus(views, 0.1))
    np.testing.assert_array_equal(views.lf.all_in_focus(), all_in_focus(views))
    np.testing.assert_array_equal(views.lf.depth_of_field(0.0, 0.1), depth_of_field(views, 0.0, 0.1))


def test_it_stays_lazy(no_compute: None) -> None:
    views = views_of([(0.1, -99.0)])
    two = xr.concat([views, views], "capture").assign_coords(capture=["a", "b"]).chunk({"capture": 1, "u": 3})
    lazy = refocus(two, [0.0, 0.1])
    assert set(lazy.dims) == {"capture", "d", "t", "s", "channel"}
    found = lazy.sel(capture="b", d=0.1).compute(scheduler="synchronous")
    np.testing.assert_array_equal(found, refocus(views, 0.1))
    assert all_in_focus(two).chunks is not None


def test_the_lattice_of_the_analytic_field_is_the_one_its_places_use() -> None:
    _, _, views = make_field([(0.0, -99.0)], shape=(4, 4), radius=1)
    lattice: Lattice = lattice_of(views)
    x, _ = lens_places(lattice, (4, 4))
    assert x[1, 0] == 0.5
