from __future__ import annotations

import numpy as np

from lfflow.kernels.colour.gather import Targets
from lfflow.kernels.colour.surface_colour import read_surface, steepness, surface_places, surface_shape

SHAPE = surface_shape(20.0, 16.0)
X, Y = surface_places(SHAPE)
LIMIT, TOLERANCE = 4.0, 0.06


def slanted() -> np.ndarray:
    """Planes of a picture that rises by 0.01 a lens pitch to the right and falls by 0.02 downwards."""
    planes = np.empty((*SHAPE, 3, 3), np.float32)
    planes[..., 0] = (0.5 + 0.01 * X - 0.02 * Y)[..., None]
    planes[..., 1], planes[..., 2] = 0.01, -0.02
    return planes


def read(
    disparity: np.ndarray, d: float, u: float, doubt: float, steep: float = 20.0
) -> tuple[np.ndarray, np.ndarray, Targets]:
    x, y = np.meshgrid(np.linspace(5, 14, 10), np.linspace(5, 12, 8))
    one = np.ones(x.size, np.float32)
    targets = Targets(x.ravel().astype("f4"), y.ravel().astype("f4"), u * one, 0 * one, d * one, doubt * one)
    rgb = np.zeros((x.size, 3), np.float32)
    grid = slanted(), disparity, np.full(SHAPE, steep, np.float32), np.where(X < 6, 4, 0).astype(np.uint8)
    bits = np.zeros(x.size, np.uint8)
    read_surface(*grid, targets, TOLERANCE, LIMIT, rgb, bits)
    return rgb, bits, targets


def test_another_view_reads_the_point_that_it_shows() -> None:
    rgb, bits, targets = read(np.full(SHAPE, 0.4, np.float32), 0.4, 3.0, 0.01)
    truth = 0.5 + 0.01 * (targets.x + 0.4 * 3) - 0.02 * targets.y
    np.testing.assert_allclose(rgb, np.repeat(truth[:, None], 3, axis=1), atol=1e-5)
    clear = np.abs(targets.x + 0.4 * 3 - 6) > 0.5
    np.testing.assert_array_equal(bits[clear], np.where(targets.x + 0.4 * 3 < 6, 4, 0)[clear])


def test_another_surface_and_a_doubtful_one_are_not_read() -> None:
    assert np.isnan(read(np.full(SHAPE, 0.4, np.float32), 0.1, 3.0, 0.01)[0]).all()
    assert np.isnan(read(np.full(SHAPE, 0.4, np.float32), 0.4, 3.0, 0.2)[0]).all()
    assert np.isfinite(read(np.full(SHAPE, 0.4, np.float32), 0.4, 3.0, 0.2, steep=1.0)[0]).all()


def test_steepness_counts_in_samples_noise_and_not_the_noise_itself() -> None:
    noise, still = 0.001, np.zeros(SHAPE, np.float32)
    steep = steepness(slanted()[..., 1, 0], still, noise)[8:-8, 8:-8]
    expected = (0.01**2 + 0.02**2) / (noise * (0.5 + 0.01 * X - 0.02 * Y)[8:-8, 8:-8])
    np.testing.assert_allclose(steep, expected, rtol=0.05)
    rng = np.random.default_rng(0)
    flat = (0.5 + 0.02 * rng.standard_normal(SHAPE)).astype(np.float32)
    noisy = steepness(flat, still + 0.02**2, noise)
    assert np.median(noisy) < 0.3 * np.median(steepness(flat, still, noise))
