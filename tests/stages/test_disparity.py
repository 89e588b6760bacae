from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import lfflow
from lfflow.kernels.mosaicked.fusion import FUSIONS
from lfflow.schema import lattice_of
from lfflow.stages import view_matching
from lfflow.stages.view_matching import disparity_of_views
from tests.conftest import raise_if_dask_computes
from tests.mosaic_fields import lightfield, plane

SHAPE = (40, 46)


@pytest.mark.parametrize("d", [-0.4, 0.0, 0.17])
def test_a_plane_has_one_disparity(d):
    out = lfflow.disparity(lightfield(plane(d), noise=0.01))
    inner = out.disparity.isel(t=slice(6, -6), s=slice(6, -6))
    assert float(abs(inner - d).median()) < 0.01
    assert float((abs(inner - d) > 0.1).mean()) < 0.02


@pytest.mark.parametrize("d", [-0.4, 0.17])
def test_a_plane_without_noise_is_hardly_drawn_to_the_samples(d):
    inner = lfflow.disparity(lightfield(plane(d))).disparity.isel(t=slice(6, -6), s=slice(6, -6))
    assert float(abs(inner - d).median()) < 0.007


@pytest.fixture(scope="module")
def faint_step(step):
    """The step with a seventh of its texture, and noise."""
    lf, _, truth = step
    noise = np.random.default_rng(5).normal(0, 0.02, lf["mosaic"].shape)
    return lf.assign(mosaic=(0.5 + 0.15 * (lf["mosaic"] - 0.5) + noise).astype("float32")), truth


@pytest.mark.parametrize("fusion", FUSIONS)
def test_every_fusion_keeps_a_near_square_of_faint_texture(faint_step, fusion):
    lf, truth = faint_step
    error = np.abs(lfflow.disparity(lf, fusion=fusion).disparity.to_numpy() - truth)[5:-5, 5:-5]
    assert np.median(error) < 0.01
    assert (error > 0.1).mean() < 0.03


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


def test_the_error_map_tells_where_there_is_no_texture():
    def half(X, Y, a, b, colour):
        return np.where(X + 0.2 * a < 24, plane(0.2)(X, Y, a, b, colour), 0.5)

    out = lfflow.disparity(lightfield(half, shape=SHAPE, noise=0.003), regularise=False)
    left, right = out.isel(t=slice(6, -6), s=slice(6, 18)), out.isel(t=slice(6, -6), s=slice(32, -6))
    assert float(left.disparity_std.median()) * 4 < float(right.disparity_std.median())
    assert float(((right.flags & 2) > 0).mean()) > 0.3 > float(((left.flags & 2) > 0).mean())


@pytest.fixture(scope="module")
def step():
    def scene(X, Y, a, b, colour):
        near = (np.abs(X + 0.4 * a - 30) < 10) & (np.abs(Y + 0.4 * b - 22) < 10)
        return np.where(near, plane(0.4, seed=2)(X, Y, a, b, colour), plane(-0.2, seed=3)(X, Y, a, b, colour))

    lf = lightfield(scene, shape=(52, 60), noise=0.002)
    return lf, lfflow.disparity(lf), true_step(lf, 0, 0)


def true_step(lf, u, v):
    X = np.arange(60)[None, :] + 0.5 * (np.arange(52) % 2)[:, None]
    Y = np.arange(52)[:, None] * lattice_of(lf).row_pitch
    return np.where((np.abs(X + 0.4 * u - 30) < 10) & (np.abs(Y + 0.4 * v - 22) < 10), 0.4, -0.2)


def test_a_near_square_keeps_its_edges(step):
    _, out, truth = step
    error = np.abs(out.disparity.to_numpy() - truth)[5:-5, 5:-5]
    assert np.median(error) < 0.01
    assert (error > 0.1).mean() < 0.04


@pytest.mark.parametrize(("u", "v"), [(2, 0), (0, -3)])
def test_another_view_has_a_map_of_its_own(step, u, v):
    lf, _, _ = step
    out = lfflow.disparity(lf, u=u, v=v)
    error = np.abs(out.disparity.to_numpy() - true_step(lf, u, v))[5:-5, 5:-5]
    assert np.median(error) < 0.01
    assert (error > 0.1).mean() < 0.05
    assert (int(out.u), int(out.v)) == (u, v)


def test_a_view_that_is_not_there_is_refused(step):
    with pytest.raises(ValueError, match="no view u=7"):
        lfflow.disparity(step[0], u=7)


def test_two_thirds_of_the_errors_lie_within_one_std_and_most_within_two(step):
    _, out, truth = step
    valid = out.flags.to_numpy() == 0
    ratio = (np.abs(out.disparity.to_numpy() - truth) / out.disparity_std.to_numpy())[valid]
    assert 0.6 < (ratio < 1).mean() < 0.76
    assert 0.9 < (ratio < 2).mean() < 0.99
    assert valid.mean() > 0.6


def test_the_wide_range_is_found_by_itself():
    out = lfflow.disparity(lightfield(plane(1.4, sharpest=0.15), shape=(44, 60)))
    assert float(abs(out.disparity.isel(t=slice(10, -10), s=slice(12, -12)) - 1.4).median()) < 0.02


def test_a_small_clear_spot_does_not_bound_the_rest():
    def spotted(X, Y, a, b, colour):
        weak = 0.5 + 0.25 * (plane(-0.4, seed=4)(X, Y, a, b, colour) - 0.5)
        spot = (np.abs(X + 0.5 * a - 40) < 3) & (np.abs(Y + 0.5 * b - 30) < 3)
        return np.where(spot, plane(0.5, seed=5)(X, Y, a, b, colour), weak)

    out = lfflow.disparity(lightfield(spotted, shape=(72, 80), noise=0.05))
    assert float((abs(out.disparity[6:-6, 6:-6] + 0.4) > 0.1).mean()) < 0.03


@pytest.mark.parametrize(
    ("cut", "told"),
    [
        ({"t": slice(1)}, r"1 × \d+ lenses: disparity takes at least 2 × 2"),
        ({"u": slice(3, 6), "v": slice(3, 6)}, r"2 to 4 steps from u=0, v=0 .* has u \[-1, 0, 1\], v \[-1, 0, 1\]"),
    ],
)
def test_fields_that_are_too_small_are_refused(tilted, cut, told):
    with pytest.raises(ValueError, match=told):
        lfflow.disparity(tilted.isel(cut))


def test_unknown_options_are_refused():
    lf = lightfield(plane(0.0), shape=(8, 8))
    with pytest.raises(ValueError, match="parabolla"):
        lfflow.disparity(lf, cost_interpolation="parabolla")
    with pytest.raises(TypeError, match="windows"):
        lfflow.disparity(lf, windows=3)


@pytest.fixture
def views():
    rng = np.random.default_rng(5)
    picture = np.kron(rng.uniform(size=(14, 14, 3)), np.ones((4, 4, 1))).astype(np.float32)
    axis = np.arange(-1, 2)
    shifted = [[np.roll(picture, (-v, -u), (0, 1)) for u in axis] for v in axis]
    return xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), np.array(shifted))}, {"v": axis, "u": axis})


def test_full_colour_views_are_matched_with_the_options_for_them(views, monkeypatch):
    asked = []

    def spy(lf, **options):
        asked.append(options)
        return disparity_of_views(lf, **options)

    monkeypatch.setattr(view_matching, "disparity_of_views", spy)
    found = lfflow.disparity(views, threads=2, disparity_range=(-2.0, 2.0))
    assert asked == [{"threads": 2, "disparity_range": (-2.0, 2.0)}]
    xr.testing.assert_identical(found, disparity_of_views(views, disparity_range=(-2.0, 2.0)))
    assert float(abs(found.disparity.isel(t=slice(8, -8), s=slice(8, -8)) - 1).median()) < 0.05


@pytest.mark.parametrize(
    "option",
    [
        {"pairs": [(2, 0)]},
        {"hypotheses": [-1, 1]},
        {"sigma": 2.0},
        {"interpolation": "linear"},
        {"cost_interpolation": "none"},
        {"fusion": "mean"},
        {"second_pass": False},
        {"regularise": False},
        {"min_support": 0.1},
    ],
    ids=lambda option: next(iter(option)),
)
def test_options_of_the_mosaicked_matching_are_refused_for_full_colour_views(views, option):
    with pytest.raises(TypeError, match=next(iter(option))):
        lfflow.disparity(views, **option)
