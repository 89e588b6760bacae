import numpy as np

from lfflow.kernels.full_colour.visibility import seen_by


def test_what_a_near_square_hides_lies_beside_it_by_the_difference_of_the_shifts():
    disparity = np.full((20, 30), -1.0, dtype=np.float32)
    disparity[6:14, 10:20] = 2.0
    seen = seen_by(disparity, np.float32(2), np.float32(0), np.float32(0.1))
    hidden = np.argwhere(~seen[10, 3:27])[:, 0] + 3
    np.testing.assert_array_equal(hidden, [4, 5, 6, 7, 8, 9])  # far places at s + 2 land on near ones at s − 4
    assert seen[6:14, 14:20].all()
    assert seen[:5, 3:27].all()


def test_a_place_outside_the_view_is_not_seen():
    seen = seen_by(np.full((4, 12), 1.0, dtype=np.float32), np.float32(3), np.float32(0), np.float32(0.1))
    np.testing.assert_array_equal(seen[2], np.arange(12) >= 3)
