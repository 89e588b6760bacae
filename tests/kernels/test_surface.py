import numpy as np
import pytest

from lfflow.kernels.surface import smooth_surface


@pytest.mark.parametrize("brick", [False, True])
def test_a_plane_seen_at_few_places_is_continued_over_the_rest(brick):
    t, s = np.mgrid[:20, :24].astype(np.float64)
    x = s + 0.5 * (t % 2) if brick else s
    truth = 0.3 + 0.004 * x - 0.003 * t
    hypotheses = np.linspace(-0.5, 1.0, 31).astype(np.float32)
    seen = np.random.default_rng(1).random(truth.shape) < 0.3
    volume = np.where(seen[:, None, :], (hypotheses[None, :, None] - truth[:, None, :]) ** 2, 1.0).astype(np.float32)
    start = (np.round(truth / 0.05) * 0.05).astype(np.float32)
    guide = np.zeros((20, 24, 1), dtype=np.float32)
    found, information = smooth_surface(
        volume, hypotheses, start, 1e-4, 32, guide, anchor=1e-3, iterations=300, brick=brick
    )
    assert np.abs(found - truth)[2:-2, 2:-2].max() < 2e-3
    assert (information[seen] > 0).all()
    assert (information[~seen] == 0).all()
