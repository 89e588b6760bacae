"""Gradient ascent on the quality Υ of the global method (seed equation 6.7), from a poor start.

Υ = Σ_i Q(c_i) with Q = I ⋆ f: its gradient by the parameters P = (dh, dv, θ, C) is Σ_i ∇Q(c_i)·∂c_i/∂P. The metric of
the step is Σ_i (∂c_i/∂P)ᵀ(∂c_i/∂P), under which a pixel counts the same whichever parameter moves it. The lenses that
vote lie in a disc about the middle of the image that grows from one stage to the next: an error of pitch or rotation
moves the lenses of the first disc by less than half a pitch, and what it leaves is small enough for the next.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np
import numpy.typing as npt

from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.lattice.fit import jacobian, lens_indices, moved
from lfflow.kernels.lattice.quality import Shape, reach, shape_function
from lfflow.kernels.lattice.spectrum import start
from lfflow.lattice import Lattice

FloatImage = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]

WIDTH = 0.25
"""σ of the mask in lens pitches: where the seed's Table 2 has its maximum for the smooth shapes."""
FIRST_DISC = 4.0
GROWTH = 1.6
LARGEST_MOVE = 0.2
"""Of any lens in one step, lens pitches."""
STEPS = 60
CONVERGED = 1e-6
"""Largest move of a lens, pixels, that ends the ascent."""


def global_method(
    image: FloatImage, *, shape: Shape = "gaussian", sigma: float | None = None, first: Lattice | None = None
) -> Lattice:
    """Lattice that maximises Υ (seed 6.2.1), without any metadata.

    Parameters
    ----------
    image
        Gray image of an even light, equal gains, shape (y, x).
    shape, sigma
        Shape function and its width, pixels; a quarter of the lens pitch by default.
    first
        Where to start; found in the image's spectrum by default. Starts with pitches up to 5 % off, turned by up to 3°
        and shifted by anything lead to the same lattice, up to whole lenses.

    Returns
    -------
    lattice
        Numbered for the sensor (`Lattice.anchored`).

    Raises
    ------
    LatticeNotFoundError
        The spectrum shows no lattice, or fewer than 8 lenses lie in the image.
    """
    first = start(image) if first is None else first
    sigma = WIDTH * min(first.dh, first.dv) if sigma is None else sigma
    return ascend(correlation(image, shape, sigma), first).anchored(image.shape[0], image.shape[1])


def correlation(image: FloatImage, shape: Shape, sigma: float) -> FloatImage:
    """Q = I ⋆ f: the quality of each pixel as the centre of a subimage, shape (y, x)."""
    half = int(np.ceil(reach(shape, sigma)))
    offsets = np.arange(-half, half + 1)
    kernel = shape_function(shape, np.hypot(offsets[:, np.newaxis], offsets), sigma)
    border = cv2.BORDER_REFLECT_101
    if shape == "gaussian":
        line = kernel[half].astype(np.float64)
        return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, line, line, borderType=border), dtype=np.float32)
    return np.asarray(cv2.filter2D(image, cv2.CV_32F, kernel, borderType=border), dtype=np.float32)


def ascend(quality: FloatImage, first: Lattice) -> Lattice:
    """Lattice at the local maximum of Σ_i Q(c_i) uphill from `first`; `quality` is Q, shape (y, x)."""
    height, width = quality.shape
    radius = FIRST_DISC * first.dh
    lattice = _brightest(quality, _renumbered(first, height, width), radius)
    while True:
        k, complete = _lenses(lattice, height, width, radius)
        if len(k) < 8:
            raise LatticeNotFoundError(f"only {len(k)} subimages lie in the picture")
        lattice = _climb(quality, lattice, k)
        if complete:
            return lattice
        radius *= GROWTH


def _renumbered(lattice: Lattice, height: int, width: int) -> Lattice:
    """Lattice whose lens (0, 0) is the one nearest to the middle, so that the parameters do not lean on each other."""
    t, s = lattice.nearest((width - 1) / 2, (height - 1) / 2)
    cx, cy = lattice.centres(t, s)
    return Lattice(lattice.dh, lattice.dv, lattice.theta, float(cx), float(cy), lattice.arrangement)


def _brightest(quality: FloatImage, lattice: Lattice, radius: float) -> Lattice:
    """Of the lattices that differ by the offset alone, over a cell in steps of a quarter, that of the largest Υ."""
    k, _ = _lenses(lattice, quality.shape[0], quality.shape[1], radius)
    shifts = [lattice.matrix @ (i / 4, j / 4) for i in range(-2, 2) for j in range(-2, 2)]
    tried = [moved(lattice, np.array([0.0, 0.0, 0.0, *shift])) for shift in shifts]
    return max(tried, key=lambda candidate: _upsilon(quality, candidate, k)[0])


def _lenses(lattice: Lattice, height: int, width: int, radius: float) -> tuple[FloatArray, bool]:
    """Indices k (n, 2) of the lenses within `radius` of the middle that are whole, and whether these are all."""
    margin = 0.5 * lattice.dh + 2
    reach_t = int(np.hypot(height, width) / (2 * lattice.row_pitch * lattice.dh)) + 2
    reach_s = int(np.hypot(height, width) / (2 * lattice.dh)) + 2
    t, s = np.mgrid[-reach_t : reach_t + 1, -reach_s : reach_s + 1]
    x, y = lattice.centres(t, s)
    whole = (x >= margin) & (x <= width - 1 - margin) & (y >= margin) & (y <= height - 1 - margin)
    near = np.hypot(x - (width - 1) / 2, y - (height - 1) / 2) <= radius
    chosen = whole & near
    return lens_indices(lattice, np.stack([x[chosen], y[chosen]], axis=1)), bool((near | ~whole).all())


def _climb(quality: FloatImage, lattice: Lattice, k: FloatArray) -> Lattice:
    """Ascend with the lenses k: steps along the gradient, halved until Υ rises, doubled when it did at once."""
    value, gradient = _upsilon(quality, lattice, k)
    pace = np.inf
    for _ in range(STEPS):
        design = jacobian(lattice, k)
        direction = np.linalg.solve(np.einsum("ani,anj->ij", design, design), gradient)
        move = float(np.hypot(*(design @ direction)).max())
        pace = min(2 * pace, LARGEST_MOVE * lattice.dh / max(move, 1e-300))
        while pace * move > CONVERGED:
            candidate = moved(lattice, pace * direction)
            higher, slope = _upsilon(quality, candidate, k)
            if higher > value:
                break
            pace /= 2
        else:
            return lattice
        lattice, value, gradient = candidate, higher, slope
    return lattice


def _upsilon(quality: FloatImage, lattice: Lattice, k: FloatArray) -> tuple[float, FloatArray]:
    """Υ and its gradient by (dh, dv, θ, cx, cy)."""
    x, y = (k @ lattice.matrix.T + (lattice.cx, lattice.cy)).T
    values = _sample(quality, np.ascontiguousarray(x), np.ascontiguousarray(y))
    return float(values[0].sum()), np.einsum("an,ani->i", values[1:], jacobian(lattice, k))


@numba.njit(nogil=True, cache=True)
def _sample(image: FloatImage, x: FloatArray, y: FloatArray) -> FloatArray:
    """Value and slopes (by x, by y) at places (n,) by cubic convolution, shape (3, n); 0 outside the image."""
    out = np.zeros((3, x.size))
    weight, steep = np.empty((2, 4)), np.empty((2, 4))
    for n in range(x.size):
        i, j = int(np.floor(x[n])), int(np.floor(y[n]))
        if i < 1 or j < 1 or i + 2 >= image.shape[1] or j + 2 >= image.shape[0]:
            continue
        for axis, f in enumerate((x[n] - i, y[n] - j)):
            weight[axis, 0] = f * (-0.5 + f * (1.0 - 0.5 * f))
            weight[axis, 1] = 1.0 + f * f * (-2.5 + 1.5 * f)
            weight[axis, 2] = f * (0.5 + f * (2.0 - 1.5 * f))
            weight[axis, 3] = f * f * (-0.5 + 0.5 * f)
            steep[axis, 0] = -0.5 + f * (2.0 - 1.5 * f)
            steep[axis, 1] = f * (-5.0 + 4.5 * f)
            steep[axis, 2] = 0.5 + f * (4.0 - 4.5 * f)
            steep[axis, 3] = f * (-1.0 + 1.5 * f)
        for b in range(4):
            for a in range(4):
                value = float(image[j - 1 + b, i - 1 + a])
                out[0, n] += weight[0, a] * weight[1, b] * value
                out[1, n] += steep[0, a] * weight[1, b] * value
                out[2, n] += weight[0, a] * steep[1, b] * value
    return out
