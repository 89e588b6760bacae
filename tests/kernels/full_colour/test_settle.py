import numpy as np

from lfflow.kernels.full_colour.settle import settle_edges


def test_a_fattened_edge_goes_back_to_the_edge_of_the_picture():
    inside = np.zeros((40, 40), dtype=np.bool_)
    inside[12:28, 12:28] = True
    fat = np.zeros_like(inside)
    fat[9:31, 9:31] = True
    guide = np.where(inside, 0.7, 0.3)[..., None].astype(np.float32)
    settled = settle_edges(np.where(fat, 1.0, -0.5).astype(np.float32), guide, rounds=3)
    wrong = (settled > 0) != inside
    assert wrong.sum() < 0.1 * (fat & ~inside).sum()


def test_a_map_without_jumps_is_left_as_it_is():
    slope = np.add.outer(np.arange(30) * 0.05, np.arange(30) * 0.05).astype(np.float32)
    guide = np.random.default_rng(0).random((30, 30, 3)).astype(np.float32)
    np.testing.assert_array_equal(settle_edges(slope, guide, rounds=2), slope)
