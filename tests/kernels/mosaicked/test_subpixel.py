from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.mosaicked.subpixel import COST_INTERPOLATIONS, minimum

LABELS = np.linspace(-1, 1, 21)


def bowl(place, depth=1.0):
    return (depth * (LABELS - place) ** 2)[:, None, None].astype("f4")


@pytest.mark.parametrize("method", COST_INTERPOLATIONS)
def test_the_minimum_of_a_parabola(method):
    found, cost = minimum(bowl(0.234), LABELS, method)
    within = {"none": 0.05, "parabola": 1e-4, "equiangular": 0.02, "spline": 1e-3}[method]
    assert found[0, 0] == pytest.approx(0.234, abs=within)
    assert cost[0, 0] == pytest.approx((0.2 - 0.234) ** 2, abs=1e-6)


def test_the_minimum_of_two_lines_is_met_by_the_equiangular_fit():
    cost = np.abs(LABELS - 0.234)[:, None, None].astype("f4")
    assert minimum(cost, LABELS, "equiangular")[0][0, 0] == pytest.approx(0.234, abs=1e-4)


def test_undefined_costs_never_win():
    cost = bowl(0.3)
    cost[12:14] = np.nan
    assert minimum(cost, LABELS)[0][0, 0] not in LABELS[12:14]
    assert np.isnan(minimum(np.full_like(cost, np.nan), LABELS)[0][0, 0])
