from __future__ import annotations

import numpy as np

from lfflow.kernels.full_colour.cost_filter import CostFilter


def test_costs_do_not_cross_an_edge_of_the_picture() -> None:
    picture = np.where(np.arange(24) < 12, 0.2, 0.6).astype(np.float32) * np.ones((16, 1), dtype=np.float32)
    cost = np.where(picture > 0.4, 1.0, 0.0).astype(np.float32)
    np.testing.assert_allclose(CostFilter(picture, 1e-5)(cost), cost, atol=1e-3)


def test_where_the_picture_is_flat_costs_are_averaged() -> None:
    picture = np.full((32, 32), 0.5, dtype=np.float32)
    cost = np.random.default_rng(3).normal(1, 0.1, picture.shape).astype(np.float32)
    filtered = CostFilter(picture, 1e-5)(cost)
    weights = np.convolve(np.full(5, 1 / 5), np.full(5, 1 / 5))
    expected = sum(
        weights[i] * weights[j] * cost[16 + i - 4, 16 + j - 4] for i in range(weights.size) for j in range(weights.size)
    )
    np.testing.assert_allclose(filtered[16, 16], expected, atol=1e-5)


def test_noise_of_the_picture_is_no_edge() -> None:
    generator = np.random.default_rng(4)
    picture = generator.normal(0.5, 0.02, (64, 64)).astype(np.float32)
    cost = generator.normal(1, 0.1, picture.shape).astype(np.float32)
    averaged, told, untold = (float(CostFilter(picture, noise)(cost).std()) for noise in (10.0, 4e-4, 1e-6))
    assert told - averaged < 0.4 * (untold - averaged)
