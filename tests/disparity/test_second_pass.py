from __future__ import annotations

import numpy as np
import pytest

import lfflow
from lfflow.kernels.completion import complete_centre
from lfflow.kernels.mosaic_field import mosaic_field
from lfflow.kernels.refine import refine
from lfflow.schema import lattice_of
from tests.disparity.conftest import lightfield, plane, waves

SHAPE = (40, 46)


def field_of(lf):
    axes = tuple(lf[dim].to_numpy() for dim in ("v", "u", "t", "s"))
    return mosaic_field(lf.mosaic.to_numpy(), lf.cfa.to_numpy(), lf.weight.to_numpy(), axes, lattice_of(lf))


@pytest.fixture(scope="module")
def slab():
    return field_of(lightfield(plane(0.3, seed=4, sharpest=0.2), shape=SHAPE))


def test_the_completed_view_is_the_picture(slab):
    picture, weight = complete_centre(slab, np.full(SHAPE, 0.3, "f4"), np.full(SHAPE, 0.01, "f4"))
    X = np.arange(SHAPE[1])[None, :] + slab.offset[:, None]
    Y = np.arange(SHAPE[0])[:, None] * slab.row_pitch + 0 * X
    for colour in range(3):
        truth = waves(4, sharpest=0.2)(X, Y, np.full(X.shape, colour))
        error = (picture[colour] - truth)[6:-6, 6:-6]
        assert np.sqrt(np.mean(error**2)) < 0.15 * truth.std()
    assert (weight[:, 6:-6, 6:-6] > 0.05).mean() > 0.95


@pytest.mark.parametrize("off", [-0.03, 0.03])
def test_steps_go_to_the_true_disparity(slab, off):
    start = np.full(SHAPE, 0.3 + off, dtype="f4")
    picture, _ = complete_centre(slab, np.full(SHAPE, 0.3, "f4"), np.full(SHAPE, 0.01, "f4"))
    once = refine(slab, picture, start).disparity
    twice = refine(slab, picture, once).disparity
    errors = [float(np.median(np.abs(d - 0.3)[6:-6, 6:-6])) for d in (start, once, twice)]
    assert errors[1] < errors[0] / 2
    assert errors[2] < 0.007


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
    X = np.arange(60)[None, :] + 0.5 * (np.arange(52) % 2)[:, None]
    Y = np.arange(52)[:, None] * lattice_of(lf).row_pitch
    truth = np.where((np.abs(X - 30) < 10) & (np.abs(Y - 22) < 10), 0.4, -0.2)
    return lfflow.disparity(lf), truth


def test_a_near_square_keeps_its_edges(step):
    out, truth = step
    error = np.abs(out.disparity.to_numpy() - truth)[5:-5, 5:-5]
    assert np.median(error) < 0.01
    assert (error > 0.1).mean() < 0.04


def test_most_errors_lie_within_the_error_map(step):
    out, truth = step
    valid = out.flags.to_numpy() == 0
    ratio = (np.abs(out.disparity.to_numpy() - truth) / out.disparity_std.to_numpy())[valid]
    assert (ratio < 2).mean() > 0.9
    assert valid.mean() > 0.6


def test_the_wide_range_is_found_by_itself():
    out = lfflow.disparity(lightfield(plane(1.4, sharpest=0.15), shape=(44, 60)))
    assert float(abs(out.disparity.isel(t=slice(10, -10), s=slice(12, -12)) - 1.4).median()) < 0.02


def test_unknown_options_are_refused():
    lf = lightfield(plane(0.0), shape=(8, 8))
    with pytest.raises(ValueError, match="parabolla"):
        lfflow.disparity(lf, cost_interpolation="parabolla")
    with pytest.raises(TypeError, match="windows"):
        lfflow.disparity(lf, windows=3)
