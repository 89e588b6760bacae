from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.mosaicked.fusion import FUSIONS, fuse_costs, spread, trimmed_sum, weighted_median
from lfflow.kernels.mosaicked.subpixel import minimum

LABELS = np.linspace(-1, 1, 21)


def bowl(place, depth=1.0):
    return (depth * (LABELS - place) ** 2)[:, None, None].astype("f4")


def test_the_median_is_one_of_the_values():
    values = np.array([0.0, 1.0, np.nan, 0.1, 0.9], dtype="f4")[:, None, None]
    assert weighted_median(values, np.ones_like(values))[0, 0] == np.float32(0.1)
    heavy = np.array([1, 9, 9, 1, 1], dtype="f4")[:, None, None]
    assert weighted_median(values, heavy)[0, 0] == np.float32(1.0)
    assert np.isnan(weighted_median(values, np.zeros_like(values)))[0, 0]


def test_spread_is_the_weighted_standard_deviation():
    values = np.array([0.0, 2.0, 1.0], dtype="f4")[:, None, None]
    weights = np.array([1.0, 1.0, 2.0], dtype="f4")[:, None, None]
    assert spread(values, weights, np.ones((1, 1), "f4"))[0, 0] == pytest.approx(np.sqrt(0.5))


def test_trimming_leaves_out_the_worst_and_what_is_undefined():
    costs = np.array([1.0, 2.0, np.nan, 3.0, 100.0], dtype="f4")[:, None, None, None]
    assert trimmed_sum(costs, 0.75)[0, 0, 0] == pytest.approx(2.0)
    assert np.isnan(trimmed_sum(np.full((2, 1, 1, 1), np.nan, "f4")))[0, 0, 0]


@pytest.mark.parametrize("fusion", FUSIONS)
def test_every_fusion_finds_what_all_pairs_agree_on(fusion):
    costs = np.stack([bowl(0.3), bowl(0.3, 4.0), bowl(0.3, 0.5), bowl(0.3, 2.0)])
    found, _ = minimum(fuse_costs(costs, LABELS, fusion), LABELS)
    assert found[0, 0] == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize("fusion", ["trimmed", "opposite", "median"])
def test_one_hidden_side_does_not_move_the_minimum(fusion):
    costs = np.stack([bowl(0.3), bowl(0.3), bowl(0.3), 8 * bowl(-0.8)])
    found, _ = minimum(fuse_costs(costs, LABELS, fusion), LABELS)
    assert found[0, 0] == pytest.approx(0.3, abs=0.02)
