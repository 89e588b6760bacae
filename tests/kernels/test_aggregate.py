import numpy as np
import pytest

from lfflow.kernels.aggregate import accumulate, regularise


def _wedge(rows=24, columns=30, noise=0.0):
    hypotheses = np.linspace(-1, 1, 41).astype(np.float32)
    t, s = np.mgrid[:rows, :columns]
    truth = np.where(s < 15, -0.53, 0.21 + 0.004 * t)
    cost = np.minimum((hypotheses[:, None, None] - truth) ** 2, 0.09)
    cost += noise * np.random.default_rng(3).standard_normal(cost.shape)
    guide = np.where(s < 15, 0.2, 0.8)[..., None].astype(np.float32)
    return cost.astype(np.float32), hypotheses, truth, guide


@pytest.mark.parametrize("brick", [False, True])
def test_exact_parabolas_are_found_below_the_step(brick):
    cost, hypotheses, truth, guide = _wedge()
    found = regularise(cost, hypotheses, guide, small=1e-4, large=1e-3, brick=brick)
    assert np.abs(found - truth).max() < 1e-3


@pytest.mark.parametrize("brick", [False, True])
def test_undefined_costs_follow_their_neighbours_up_to_the_edge(brick):
    cost, hypotheses, truth, guide = _wedge(noise=0.002)
    cost[:, 5:12, 10:20] = np.nan
    cost[7, 2, 3] = np.inf
    found = regularise(cost, hypotheses, guide, brick=brick)
    assert np.isfinite(found).all()
    assert np.abs(found - truth).max() < 0.06


def test_one_path_step_equals_its_definition():
    cost = np.array([[[1.0, 4.0]], [[5.0, 0.5]], [[9.0, 3.0]]], dtype=np.float32)
    total, unit = accumulate(cost, small=0.5, large=2.0, scale=1.0)
    right = np.array([4.0, 0.5, 3.0]) + np.array([0.0, 0.5, 2.0])
    left = np.array([1.0, 5.0, 9.0]) + np.array([0.5, 0.0, 0.5])
    alone = cost[:, 0, :].T
    assert unit == 1.0
    np.testing.assert_allclose(total[0], [left + 7 * alone[0], right + 7 * alone[1]])


def test_places_without_any_cost_give_nan():
    empty = np.full((5, 4, 4), np.nan, dtype=np.float32)
    assert np.isnan(regularise(empty, np.arange(5.0))).all()
