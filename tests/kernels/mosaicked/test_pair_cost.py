from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.mosaicked.pair_cost import tap_weights


@pytest.mark.parametrize("method", ["nearest", "linear", "cubic", "bandlimited"])
def test_interpolation_keeps_constants_and_hits_the_samples(method):
    for fraction in (0.0, 0.25, 0.5, 0.9):
        assert tap_weights(fraction, method).sum() == pytest.approx(1, abs=1e-6)
    assert tap_weights(0.0, method)[2] == 1


def test_cubic_is_exact_on_parabolas():
    taps = np.arange(-2, 4.0)
    for f in (0.2, 0.5, 0.7):
        assert tap_weights(f, "cubic") @ taps**2 == pytest.approx(f * f, abs=1e-6)
