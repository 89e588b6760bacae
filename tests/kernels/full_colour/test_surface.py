import numpy as np

from lfflow.kernels.full_colour.surface import fit_surface


def _plane():
    t, s = np.mgrid[:20, :24].astype(np.float64)
    return 0.3 + 0.004 * s - 0.003 * t


def test_a_plane_known_at_few_places_is_continued_over_the_rest():
    truth = _plane()
    known = np.random.default_rng(1).random(truth.shape) < 0.3
    target = np.where(known, truth, 5.0).astype(np.float32)
    start = (np.round(truth / 0.05) * 0.05).astype(np.float32)
    guide = np.zeros((20, 24, 1), dtype=np.float32)
    found = fit_surface(target, known * np.float32(1e4), start, guide, stiffness=2e4, iterations=300)
    assert np.abs(found - truth)[2:-2, 2:-2].max() < 2e-3


def test_a_jump_stays_where_the_picture_has_its_edge():
    truth = _plane()
    truth[:, 12:] += 1
    guide = np.where(np.arange(24) < 12, 0.2, 0.8)[None, :, None].astype(np.float32) * np.ones((20, 1, 1), "float32")
    noise = np.random.default_rng(0).normal(0, 0.02, truth.shape)
    target = (truth + noise).astype(np.float32)
    found = fit_surface(target, np.full_like(target, 1 / 0.02**2), target, guide, stiffness=5e4)
    assert np.abs(found - truth)[2:-2, 2:-2].max() < 0.03
    assert (found - truth)[2:-2, 2:-2].std() < 0.4 * noise.std()
