import numpy as np
import pytest

from lfflow.kernels.full_colour.line_fit import normal_equations
from lfflow.kernels.full_colour.spline import slopes, weights

MARGIN = 8


def _views(truth, offsets):
    """One sinusoid, seen at disparity `truth` by each view, drawn in closed form."""
    place = np.arange(-MARGIN, 24 + MARGIN)
    y, x = np.meshgrid(place, place, indexing="ij")
    return np.stack([np.sin(0.5 * (x + truth * u) + 0.3 * (y + truth * v))[None] for u, v in offsets]).astype("f4")


@pytest.mark.parametrize("truth", [-0.83, 0.0, 0.41])
def test_one_step_finds_the_disparity_of_a_sinusoid(truth):
    offsets = [(u, v) for u in (-1, 0, 1) for v in (-1, 0, 1)]
    u, v = (np.array(column, dtype=np.float32) for column in zip(*offsets, strict=True))
    start = np.full((24, 24), truth + 0.05, dtype=np.float32)
    seen, out = np.ones((9, 24, 24), dtype=np.bool_), np.empty((3, 24, 24), dtype=np.float32)
    normal_equations(
        _views(truth, offsets), np.arange(len(u)), seen, start, u, v, u == 0, (0, 24), MARGIN, np.float32(1e3), out
    )
    curvature, slope, residual = out
    steep = curvature > 0.2 * curvature.max()
    assert steep.mean() > 0.5
    np.testing.assert_allclose((start + slope / curvature)[steep], truth, atol=1e-3)
    assert (residual < 1e-2).all()


def test_a_view_that_sees_something_else_is_left_out():
    offsets = [(u, 0) for u in (-2, -1, 0, 1, 2)]
    views = _views(0.3, offsets)
    views[4] += 2
    u, v = (np.array(column, dtype=np.float32) for column in zip(*offsets, strict=True))
    start, seen = np.full((24, 24), 0.32, dtype=np.float32), np.ones((5, 24, 24), dtype=np.bool_)
    out = np.empty((3, 24, 24), dtype=np.float32)
    normal_equations(views, np.arange(len(u)), seen, start, u, v, u == 0, (0, 24), MARGIN, np.float32(1e-2), out)
    curvature, slope, _ = out
    steep = curvature > 0.2 * curvature.max()
    assert np.abs((start + slope / curvature)[steep] - 0.3).max() < 0.01


def test_noise_does_not_shorten_the_step():
    """Derivatives of each view by itself would add the energy of their noise to the curvature."""
    offsets = [(u, v) for u in (-2, -1, 0, 1, 2) for v in (-2, -1, 0, 1, 2)]
    u, v = (np.array(column, dtype=np.float32) for column in zip(*offsets, strict=True))
    views = _views(0.1, offsets) + np.random.default_rng(1).normal(0, 1.0, (25, 1, 40, 40)).astype("f4")
    start, seen = np.zeros((24, 24), dtype=np.float32), np.ones((25, 24, 24), dtype=np.bool_)
    out = np.empty((3, 24, 24), dtype=np.float32)
    normal_equations(views, np.arange(len(u)), seen, start, u, v, u < 9, (0, 24), MARGIN, np.float32(1e3), out)
    assert out[1].sum() / out[0].sum() == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("fraction", [0.0, 0.2, 0.5, 0.9])
def test_spline_weights_sum_to_one_and_follow_their_slopes(fraction):
    np.testing.assert_allclose(sum(weights(fraction)), 1, rtol=1e-6)
    np.testing.assert_allclose(np.dot(weights(fraction), [-1, 0, 1, 2]), fraction, atol=1e-6)
    step = 1e-3
    numeric = (np.array(weights(fraction + step)) - np.array(weights(fraction - step))) / (2 * step)
    np.testing.assert_allclose(slopes(fraction), numeric, atol=1e-3)
