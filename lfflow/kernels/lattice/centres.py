"""The local method (seed 6.2.2): the quality Q of every place as a subimage centre, and its peaks."""

from __future__ import annotations

import cv2
import numba
import numpy as np
import numpy.typing as npt

from lfflow.lattice import Lattice

WIDTH = 0.25
"""σ of the Gaussian mask in lens pitches (2.5 px on a pitch of 10 px)."""
EVEN = (0.7548776662466927, 0.5698402909980532)
"""Steps of the additive sequence of lowest discrepancy in two dimensions."""

Centres = npt.NDArray[np.float64]


def quality_image(image: npt.NDArray[np.float32], sigma: float) -> npt.NDArray[np.float32]:
    """Q(c) for every pixel c: correlation with a Gaussian mask of width `sigma` (px), seed equation 6.8.

    The weights α of the colours are in `image` already (`lfflow.kernels.sensor.equalise`).
    """
    size = 2 * int(np.ceil(3.2 * sigma)) + 1
    blurred = cv2.GaussianBlur(image, (size, size), sigma, borderType=cv2.BORDER_REFLECT_101)
    out: npt.NDArray[np.float32] = np.array(blurred, dtype=np.float32, copy=None)
    return out


def flatten_scene(image: npt.NDArray[np.float32], pitch: float) -> npt.NDArray[np.float32]:
    """Image divided by its mean over three lens pitches: the scene goes, the subimages' edges stay."""
    size = 2 * round(1.5 * pitch) + 1
    mean = cv2.blur(image, (size, size), borderType=cv2.BORDER_REFLECT_101)
    floor = 0.05 * float(mean[::8, ::8].mean())
    flat: npt.NDArray[np.float32] = (np.clip(image, 0, None) / np.maximum(mean, floor)).astype(np.float32)
    return flat


def lens_centres(lattice: Lattice, height: int, width: int, margin: float, every: float = 1) -> Centres:
    """Predicted centres (n, 2) as (x, y) of all lenses that lie `margin` px or more inside the sensor.

    Of one lens of `every`, spread evenly, instead: the same ones as long as the lattice moves by less than a lens.
    """
    anchored = lattice.anchored(height, width)
    rows, columns = anchored.grid_shape(height, width)
    t, s = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    x, y = anchored.centres(t, s)
    inside = (x >= margin) & (x <= width - 1 - margin) & (y >= margin) & (y <= height - 1 - margin)
    if every > 1:
        first_t, first_s = lattice.nearest(anchored.cx, anchored.cy)
        column = s + first_s
        if lattice.arrangement == "hexagonal":
            column -= t // 2 + first_t // 2
        inside &= (column * EVEN[0] + (t + first_t) * EVEN[1]) % 1 < 1 / every
    return np.stack([x[inside], y[inside]], axis=1)


@numba.njit(nogil=True, cache=True)
def _summit(quality: npt.NDArray[np.float32], x: int, y: int, steps: int) -> tuple[int, int]:
    """Pixel of the local maximum uphill from (x, y); (0, 0) where it is none, at the border or too many steps away."""
    height, width = quality.shape
    for _ in range(steps):
        if not (0 < x < width - 1 and 0 < y < height - 1):
            return 0, 0
        best_x, best_y = x, y
        for j in range(y - 1, y + 2):
            for i in range(x - 1, x + 2):
                if quality[j, i] > quality[best_y, best_x]:
                    best_x, best_y = i, j
        if best_x == x and best_y == y:
            return x, y
        x, y = best_x, best_y
    return 0, 0


@numba.njit(nogil=True, cache=True)
def _vertex(before: float, at: float, after: float) -> float:
    bend = 2 * at - before - after
    return 0.5 * (after - before) / bend if bend > 0 else np.nan


@numba.njit(nogil=True, cache=True)
def climb(quality: npt.NDArray[np.float32], starts: Centres, reach: float, whole: bool) -> Centres:
    """Nearest local maximum of the quality for each start, NaN where it lies beyond `reach` pixels.

    Parameters
    ----------
    quality
        Shape (y, x).
    starts
        (n, 2) as (x, y), pixels.
    reach
        Largest distance of a centre from its start, pixels.
    whole
        Stop at whole pixels, as the seed does; else the vertex of the parabolas through the neighbours.
    """
    found = np.full(starts.shape, np.nan)
    for index in range(starts.shape[0]):
        start_x, start_y = starts[index, 0], starts[index, 1]
        i, j = _summit(quality, int(np.rint(start_x)), int(np.rint(start_y)), int(reach) + 2)
        if i == 0:
            continue
        x, y = float(i), float(j)
        if not whole:
            x += _vertex(float(quality[j, i - 1]), float(quality[j, i]), float(quality[j, i + 1]))
            y += _vertex(float(quality[j - 1, i]), float(quality[j, i]), float(quality[j + 1, i]))
        if (x - start_x) ** 2 + (y - start_y) ** 2 <= reach**2:
            found[index, 0], found[index, 1] = x, y
    return found


def measure_centres(
    image: npt.NDArray[np.float32], lattice: Lattice, *, sigma: float | None = None, whole: bool = False
) -> Centres:
    """Measured subimage centres (n, 2) as (x, y), sensor pixels, starting from those that `lattice` predicts.

    Parameters
    ----------
    image
        Gray image, shape (y, x), flattened where a scene modulates it.
    lattice
        First guess; a subimage is found when the guess lies nearer to it than half a pitch.
    sigma
        Width of the mask, pixels; a quarter of a lens pitch by default.
    whole
        Whole pixels only (the seed's search).
    """
    pitch = min(lattice.dh, lattice.dv)
    width = WIDTH * pitch if sigma is None else sigma
    starts = lens_centres(lattice, image.shape[0], image.shape[1], margin=0.5 * pitch + width)
    found = climb(quality_image(image, width), starts, 0.5 * pitch, whole)
    return found[np.isfinite(found[:, 0])]
