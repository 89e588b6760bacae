"""The lattice of a scene's subimages, without what the scene does to their peaks.

Where the scene is out of focus its gradient is seen within each subimage too, and pushes the peak along itself: by an
amount that hangs on the disparity, so that it is the same for the lenses of a neighbourhood and another elsewhere.
Measured over a whole picture the pushes do not cancel: bright things in the middle make the lattice smaller. So a push
per gradient is looked for in each block of the sensor, together with the lattice, by least squares with the weights of
Student's distribution: peaks in plain parts of the scene count most.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from lfflow.kernels.lattice.fit import Fit, block_covariance, jacobian, lens_indices, moved

MOST_BLOCKS = 16
"""Blocks along each side of the sensor that have a push of their own, at most,"""
LENSES_A_BLOCK = 150
"""with so many lenses in each."""
ENOUGH = 40000
"""About so many lenses are read: more tell nothing new of the things in the scene."""
FREEDOM = 2.0
"""Degrees of freedom of Student's distribution."""
ROUNDS = 12
CONVERGED = 1e-5
"""Largest change of a pitch that ends the rounds, pixels."""
STEEPEST = 1.0
"""Change of the logarithm of the brightness over a lens pitch above which it is no gradient."""
SCENE_BLOCKS = 8
"""Blocks along each side of the sensor whose errors count as independent: things in a scene are large."""
HALF_KNOWN = 0.5
"""The push of a scene is known to so much of it."""

FloatImage = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]


def unpushed(image: FloatImage, centres: FloatArray, first: Fit) -> Fit:
    """Lattice with the scene's push solved for.

    Parameters
    ----------
    image
        Gray image with equal gains of the Bayer sites, shape (y, x).
    centres
        Measured peaks (n, 2) as (x, y), pixels.
    first
        Lattice on which they lie (`lfflow.kernels.lattice.fit.fit`).
    """
    shape, lattice = (image.shape[0], image.shape[1]), first.lattice
    k = lens_indices(lattice, centres)
    left = centres - (k @ lattice.matrix.T + (lattice.cx, lattice.cy))
    near = np.hypot(*left.T) < 0.5 * min(lattice.dh, lattice.dv)
    some = np.nonzero(near)[0][:: max(1, round(len(centres) / ENOUGH))]
    centres, k, left = centres[some], k[some], left[some]
    slope = scene_slope(image, centres, lattice.dh)
    sides = int(np.clip(np.sqrt(len(centres) / LENSES_A_BLOCK), 1, MOST_BLOCKS))
    column, row = (np.clip(centres[:, a] * sides // shape[1 - a], 0, sides - 1).astype(np.int64) for a in (0, 1))
    step, scores, inverse = _solve(jacobian(lattice, k), left, slope, row * sides + column)
    covariance = block_covariance(inverse, scores, centres, shape, SCENE_BLOCKS)
    covariance += HALF_KNOWN**2 * np.outer(step, step)
    return replace(first, lattice=moved(lattice, step), covariance=covariance)


def scene_slope(image: FloatImage, centres: FloatArray, pitch: float) -> FloatArray:
    """Change (right, down) of the logarithm of the scene's brightness over a lens pitch, at places (n, 2)."""
    cell = max(1, round(pitch / 2))
    small = cv2.resize(image, (image.shape[1] // cell, image.shape[0] // cell), interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(small, (0, 0), pitch / cell)
    light = np.log(np.maximum(smooth, 0.02 * float(smooth.mean())))
    place = (centres[:, ::-1].T + 0.5) / cell - 0.5
    down, right = (map_coordinates(change, place, order=1, mode="nearest") for change in np.gradient(light))
    slope = np.stack([right, down], axis=1).astype(np.float64) * pitch / cell
    return np.clip(slope, -STEEPEST, STEEPEST)


def _solve(
    design: FloatArray, left: FloatArray, slope: FloatArray, block: npt.NDArray[np.int64]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Step of the parameters (p,), the scores of the lenses (n, p), and the inverse of their derivative (p, p).

    `design` (2, n, p), `left` (n, 2): residuals; `slope` (n, 2), which pushes those of a block by a common factor.
    """
    blocks, step, push = int(block.max()) + 1, np.zeros(design.shape[2]), np.zeros(int(block.max()) + 1)
    along, square = np.einsum("anp,na->np", design, slope), (slope**2).sum(axis=1)
    flat = design.reshape(-1, design.shape[2])
    for _ in range(ROUNDS):
        rest = left - (design @ step).T
        distance = ((rest - push[block, None] * slope) ** 2).sum(axis=1)
        ratio = distance / max(float(np.median(distance)) / 1.3863, 1e-18)
        weight = (FREEDOM + 2) / (FREEDOM + ratio)
        bottom = np.bincount(block, weight * square, blocks)
        bottom += 1e-3 * bottom.mean() + 1e-12
        share = np.stack([np.bincount(block, weight * part, blocks) / bottom for part in along.T], axis=1)
        normal = (flat * np.tile(weight, 2)[:, None]).T @ flat - (share * bottom[:, None]).T @ share
        own = design - slope.T[:, :, None] * share[block]
        change = np.linalg.solve(normal, np.einsum("anp,na,n->p", own, rest, weight))
        step = step + change
        rest = rest - (design @ change).T
        push = np.bincount(block, weight * (rest * slope).sum(axis=1), blocks) / bottom
        if np.abs(change[:2]).max() < CONVERGED:
            break
    scores = np.einsum("anp,na->np", own, (rest - push[block, None] * slope) * weight[:, None])
    steepness = float(np.mean(weight - (FREEDOM + 2) * ratio / (FREEDOM + ratio) ** 2) / np.mean(weight))
    return step, scores, np.asarray(np.linalg.inv(normal) / steepness, dtype=np.float64)
