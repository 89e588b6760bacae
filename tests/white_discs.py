"""White images drawn lens by lens: a soft disc about each centre, wherever a warp puts it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfflow.lattice import Lattice

Warp = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def white_discs(
    lattice: Lattice, shape: tuple[int, int], warp: Warp, *, noise: float = 0.03, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Image (y, x) float32 with photon-like noise, and the places (n, 2) of all lens centres."""
    height, width = shape
    numbered = lattice.anchored(height, width)
    rows, columns = numbered.grid_shape(height, width)
    x, y = numbered.centres(*np.mgrid[-1 : rows + 1, -1 : columns + 1])
    right, down = warp(x, y)
    places = np.stack([(x + right).ravel(), (y + down).ravel()], axis=1)
    image, half = np.zeros(shape), int(0.8 * lattice.dh) + 2
    for centre_x, centre_y in places:
        i, j = int(np.floor(centre_x)) - half, int(np.floor(centre_y)) - half
        across, along = slice(max(i, 0), max(i + 2 * half + 2, 0)), slice(max(j, 0), max(j + 2 * half + 2, 0))
        part = image[along, across]
        if part.size:
            grid_y, grid_x = np.ogrid[
                along.start : along.start + part.shape[0], across.start : across.start + part.shape[1]
            ]
            radius = np.hypot(grid_x - centre_x, grid_y - centre_y)
            np.maximum(part, 1 / (1 + np.exp((radius - 0.45 * lattice.dh) / 0.5)), out=part)
    noisy = image + np.random.default_rng(seed).normal(0, noise, shape) * np.sqrt(image + 0.05)
    return noisy.astype(np.float32), places
