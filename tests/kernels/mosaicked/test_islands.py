from __future__ import annotations

import numpy as np

from lfflow.kernels.mosaicked.islands import without_islands


def scene():
    t, s = np.indices((40, 50))
    disparity = (0.002 * s - 0.3).astype(np.float32)
    disparity[:, 30:] += 0.5
    return disparity, t, s


def test_a_few_lenses_take_what_is_around_and_all_else_stays():
    truth, t, s = scene()
    found = truth.copy()
    spot = (abs(t - 12) <= 1) & (abs(s - 10) <= 1)
    found[spot] = 0.6
    found[3, 40] = np.nan
    mended = without_islands(found, np.zeros(truth.shape, bool))
    np.testing.assert_allclose(mended[spot], truth[spot], atol=0.01)
    assert np.isnan(mended[3, 40])
    rest = ~spot & np.isfinite(found)
    np.testing.assert_array_equal(mended[rest], found[rest])


def test_a_thin_bar_and_a_slope_are_no_islands():
    truth, _, s = scene()
    truth[s == 15] = 0.4
    np.testing.assert_array_equal(without_islands(truth, np.zeros(truth.shape, bool)), truth)


def test_a_larger_island_goes_only_where_it_has_no_texture():
    truth, t, s = scene()
    found = truth.copy()
    spot = (abs(t - 12) <= 3) & (abs(s - 10) <= 3)
    found[spot] = 0.6
    np.testing.assert_array_equal(without_islands(found, np.zeros(truth.shape, bool)), found)
    np.testing.assert_allclose(without_islands(found, spot), truth, atol=0.03)
