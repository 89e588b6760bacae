"""The vignetting behind the noise of a white image: what the optics can draw, without what the photons add.

A single white image has about 1.5 % noise at the peak of a subimage and 3 % where a third of the light is left; divided
by it, a picture inherits both. All that the optics can draw is smooth, though, over the lenses if not over the pixels.
So the white image is the product of: the mean subimage of all lenses, on cells finer than a pixel (every lens samples
it at other places); a gain per lens, smoothed over its neighbours, which follows the falloff and dust; a correction of
the subimage on coarser cells, tile of the field by tile, for apertures that clip the corners; and a low polynomial per
Bayer site for what is left of the colours.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.lattice.subimage import Geometry, geometry
from lfflow.kernels.sensor.demultiplex import owner
from lfflow.lattice import Lattice

FINEST, COARSEST, PIXELS = 0.125, 0.25, 500
"""Bounds of the side of a cell of the mean subimage, sensor pixels, and the pixels that should fall into one."""
COARSE = 0.5
"""Side of a cell of the correction in a tile, sensor pixels."""
TILE = 32
"""Lenses along the side of a tile."""
FINER = 3
"""Nodes a tile between which the correction is interpolated linearly."""
LIT = 0.2
"""Share of the peak above which pixels tell the gains."""

FloatImage = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]


def white_vignetting(image: FloatImage, lattice: Lattice) -> FloatImage:
    """Relative illumination (y, x) float32 from a white image, 1 at its peak.

    The Bayer sites, whatever the colour of the light, have one level in the middle of the field. The peak is the third
    highest of the rows' peaks: two rows with glints do not change it.

    Parameters
    ----------
    image
        Gray image: black level off, gains of the four sites about equal, shape (y, x).
    lattice
        Where the lenses are.
    """
    lattice = lattice.anchored(*image.shape)
    lens, reach = geometry(lattice), 0.62 * max(lattice.dh, lattice.dv)
    ceiling = np.float32(1.5 * np.percentile(image[::7, ::5], 99))
    fine = float(np.clip(math.sqrt(PIXELS * lattice.dh * lattice.dv / image.size), FINEST, COARSEST))
    cells = np.zeros((2, *_cells(reach, fine)))
    _sum_subimages(image, lens, ceiling, fine, *cells)
    subimage = _mean_subimage(*cells)
    floor = np.float32(LIT) * subimage.max()
    model = np.empty(image.shape, np.float32)
    seen, expected = np.zeros((2, *lattice.grid_shape(*image.shape)))
    _draw(subimage, fine, image, lens, floor, ceiling, model, seen, expected)
    tiles = [max(1, round(size / lattice.dh / TILE)) for size in image.shape]
    sums = np.zeros((5, *tiles, *_cells(reach, COARSE)))
    _shade_lenses(image, lens, _lens_gains(seen, expected), ceiling, model, sums)
    ratio = _corrections(sums)
    noise, misfit = _misfit(sums, ratio)
    _finish(image, lens, _nodes(ratio, 3), _nodes(misfit, 1), np.float32(noise), model)
    for row in range(2):
        for column in range(2):
            site = (slice(row, None, 2), slice(column, None, 2))
            trend = _trend(image[site], model[site], floor, ceiling)
            model[site] *= trend / trend[trend.shape[0] // 2, trend.shape[1] // 2]
    model /= max(float(np.sort(model.max(axis=1))[-3:][0]), 1e-12)
    return np.clip(model, 0, 1, out=model)


def _cells(reach: float, cell: float) -> tuple[int, int]:
    """Rows and columns of cells that hold a subimage."""
    side = 2 * (math.ceil(reach / cell) + 2) + 1
    return side, side


def _mean_subimage(total: Array, count: Array) -> FloatImage:
    """Values in the middles of the fine cells, continued beyond the lens by odd reflection in the nearest cell seen."""
    from scipy.ndimage import distance_transform_edt, laplace

    seen = count > 0.5 * np.median(count[count > 0])
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    near = distance_transform_edt(~seen, return_distances=False, return_indices=True)
    mirrored = np.clip(2 * near - np.indices(seen.shape), 0, seen.shape[0] - 1)
    mirrored = np.where(seen[mirrored[0], mirrored[1]], mirrored, near)
    mean = 2 * mean[near[0], near[1]] - mean[mirrored[0], mirrored[1]]
    return np.asarray(mean - laplace(mean, mode="nearest") / 24, np.float32)  # a cell's mean is its middle plus ∇²/24


def _corrections(sums: Array) -> Array:
    """Ratio of image and model in the cells of each tile (i, j, cell, cell); `sums` as in `_shade_lenses`."""
    from scipy.ndimage import gaussian_filter

    light, expected = (gaussian_filter(part, (0, 0, 0.8, 0.8), mode="constant") for part in sums[:2])
    dark = 1e-3 * expected.max()
    return np.asarray((light + dark) / (expected + dark))


def _misfit(sums: Array, ratio: Array) -> tuple[float, Array]:
    """Variance of the image about the corrected model as a multiple of the light: the noise's, and of every cell.

    Photon noise has a variance in proportion to the light. Its factor is that of the cells that fit best: the lower
    third of those that are well lit.
    """
    light, _, squared, product, square = sums
    misfit = np.maximum(squared - 2 * ratio * product + ratio**2 * square, 0)
    known = light > 1e-3 * light.max()
    factor = np.divide(misfit, light, out=np.zeros_like(light), where=known)
    noise = float(np.quantile(factor[light > 0.3 * light.max()], 1 / 3))
    return noise, np.maximum(factor, noise)


def _nodes(values: Array, order: int) -> FloatImage:
    """Values of the tiles (i, j, ...) at nodes that span the field, by splines of at most `order`."""
    from scipy.interpolate import make_interp_spline

    for axis in (0, 1):
        tiles = values.shape[axis]
        nodes = np.linspace(-0.5, tiles - 0.5, FINER * tiles + 1)
        values = make_interp_spline(np.arange(tiles), values, k=min(order, tiles - 1), axis=axis)(nodes)
    return np.maximum(values, 0).astype(np.float32)


def _lens_gains(seen: Array, expected: Array) -> FloatImage:
    """Gain of each lens (t, s): that of its neighbourhood, or its own where it differs clearly (dust)."""
    from scipy.ndimage import gaussian_filter

    light = [gaussian_filter(sums, 1.0, mode="constant") for sums in (seen, expected)]
    smooth = np.divide(light[0], light[1], out=np.ones_like(seen), where=light[1] > 0)
    enough = expected > 0.5 * expected.max()
    own = np.divide(seen, expected, out=np.ones_like(seen), where=enough)
    difference = np.where(enough, own - smooth, 0.0)
    spread = 1.4826 * float(np.median(np.abs(difference[enough]))) if enough.any() else 0.0
    return np.where(np.abs(difference) > 5 * spread, own, smooth).astype(np.float32)


def _trend(image: FloatImage, model: FloatImage, floor: np.floating, ceiling: np.floating) -> FloatImage:
    """Quadratic polynomial (y, x) by which the pixels of one Bayer site exceed the model."""
    block = max(8, min(image.shape) // 24)
    kept = (model > floor) & (image < ceiling)
    rows, columns = np.arange(0, image.shape[0], block), np.arange(0, image.shape[1], block)
    sums = [
        np.add.reduceat(np.add.reduceat(np.where(kept, part, 0).astype(np.float64), rows, 0), columns, 1)
        for part in (image, model)
    ]
    y, x = (np.linspace(-1, 1, size) for size in image.shape)
    i, j = y[np.minimum(rows + block // 2, y.size - 1)], x[np.minimum(columns + block // 2, x.size - 1)]
    i, j = (part.ravel() for part in np.meshgrid(i, j, indexing="ij"))
    design = np.stack([np.ones(i.size), i, i * i, j, j * j, i * j], axis=-1)
    light, expected = sums[0].ravel(), sums[1].ravel()
    ratio = np.divide(light, expected, out=np.ones_like(light), where=expected > 0)
    weight = np.sqrt(expected)
    a = np.linalg.lstsq(design * weight[:, np.newaxis], ratio * weight, rcond=None)[0]
    down, across = a[0] + a[1] * y + a[2] * y * y, a[3] * x + a[4] * x * x
    return np.asarray(down[:, np.newaxis] + across + a[5] * np.outer(y, x), dtype=np.float32)


@numba.njit(nogil=True, cache=True, forceinline=True)
def _place(x: int, y: int, lens: Geometry) -> tuple[int, int, float, float]:  # pragma: no cover - compiled
    """Lens (t, s) of a sensor pixel, and the pixel's offset from its centre along the lattice's axes, pixels."""
    cos, sin, dh, dv, cx, cy, hexagonal = lens
    gx, gy = (cos * (x - cx) + sin * (y - cy)) / dh, (-sin * (x - cx) + cos * (y - cy)) / dv
    t, s = owner(gx, gy, hexagonal)
    if hexagonal:
        return t, s, (gx - s - 0.5 * (t & 1)) * dh, (gy - 0.8660254037844386 * t) * dv
    return t, s, (gx - s) * dh, (gy - t) * dv


@numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _sum_subimages(image, lens, ceiling, fine, total, count):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Sum and number of the pixels below `ceiling` in every fine cell of the subimage."""
    half = total.shape[0] // 2
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if image[y, x] < ceiling:
                _, _, a, b = _place(x, y, lens)
                row, column = round(b / fine) + half, round(a / fine) + half
                total[row, column] += image[y, x]
                count[row, column] += 1.0


@numba.njit(nogil=True, cache=True, forceinline=True)
def _cubic(f):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Weights of four neighbours for the cubic convolution at the fraction f between the second and the third."""
    g = 1.0 - f
    return (
        np.float32(-0.5 * f * g * g),
        np.float32(0.5 * g * (2.0 + 2.0 * f - 3.0 * f * f)),
        np.float32(0.5 * f * (2.0 + 2.0 * g - 3.0 * g * g)),
        np.float32(-0.5 * g * f * f),
    )


@numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _draw(subimage, fine, image, lens, floor, ceiling, model, seen, expected):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Put the mean subimage on the pixels (y, x) of `model`; add up the light of its well lit ones by lens (t, s)."""
    half = subimage.shape[0] // 2
    for y in range(model.shape[0]):
        for x in range(model.shape[1]):
            t, s, a, b = _place(x, y, lens)
            column, row = a / fine + half, b / fine + half
            j, i = int(column), int(row)
            across, down = _cubic(column - j), _cubic(row - i)
            value = np.float32(0)
            for k in range(4):
                line = subimage[i - 1 + k]
                value += down[k] * (
                    across[0] * line[j - 1] + across[1] * line[j] + across[2] * line[j + 1] + across[3] * line[j + 2]
                )
            model[y, x] = value
            if value > floor and image[y, x] < ceiling and 0 <= t < seen.shape[0] and 0 <= s < seen.shape[1]:
                seen[t, s] += image[y, x]
                expected[t, s] += value


@numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _shade_lenses(image, lens, gains, ceiling, model, sums):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Multiply the model by the gain of each lens; add up, in every coarse cell of every tile, image w and model m.

    ``sums`` (5, i, j, row, column): Σw, Σm, Σw², Σwm, Σm², of the pixels below `ceiling` and not far from the model.
    """
    height, width = image.shape
    half = sums.shape[3] // 2
    for y in range(height):
        i = y * sums.shape[1] // height
        for x in range(width):
            t, s, a, b = _place(x, y, lens)
            if 0 <= t < gains.shape[0] and 0 <= s < gains.shape[1]:
                model[y, x] *= gains[t, s]
            w, m = image[y, x], model[y, x]
            if w < ceiling and abs(w - m) < np.float32(0.5) * ceiling:
                cell = sums[:, i, x * sums.shape[2] // width, round(b / COARSE) + half, round(a / COARSE) + half]
                cell[0] += w
                cell[1] += m
                cell[2] += w * w
                cell[3] += w * m
                cell[4] += m * m


@numba.njit(nogil=True, cache=True, forceinline=True)
def _between(place, nodes):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """First of the two nodes about a place (0 to 1 over the field), and the share of the second."""
    node = place * (nodes - 1)
    first = min(int(node), nodes - 2)
    return first, np.float32(node - first)


@numba.njit(nogil=True, cache=True, forceinline=True)
def _bilinear(cells, i, j, down, across):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    first = cells[i, j] + across * (cells[i, j + 1] - cells[i, j])
    second = cells[i + 1, j] + across * (cells[i + 1, j + 1] - cells[i + 1, j])
    return first + down * (second - first)


@numba.njit(nogil=True, cache=True, forceinline=True)
def _field(values, y, x, height, width, a, b):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Value at a pixel and its offset in the subimage, linear between the cells and the nodes."""
    half = values.shape[2] // 2
    above, share_y = _between((y + 0.5) / height, values.shape[0])
    left, share_x = _between((x + 0.5) / width, values.shape[1])
    column, row = a / COARSE + half, b / COARSE + half
    j, i = int(column), int(row)
    across, down = np.float32(column - j), np.float32(row - i)
    upper = _bilinear(values[above, left], i, j, down, across)
    upper += share_x * (_bilinear(values[above, left + 1], i, j, down, across) - upper)
    lower = _bilinear(values[above + 1, left], i, j, down, across)
    lower += share_x * (_bilinear(values[above + 1, left + 1], i, j, down, across) - lower)
    return upper + share_y * (lower - upper)


@numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _finish(image, lens, ratio, misfit, noise, model):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Multiply the pixels (y, x) of `model` by the ratio; move them towards the image where the model misses it.

    They move by the share of the misfit that the noise, with a quarter more, does not explain. Pixels that stick out
    are defects and do not count.
    """
    height, width = model.shape
    noise = max(noise, np.float32(1e-12))
    for y in range(height):
        for x in range(width):
            _, _, a, b = _place(x, y, lens)
            value = model[y, x] * _field(ratio, y, x, height, width, a, b)
            factor = max(_field(misfit, y, x, height, width, a, b), noise)
            share = max(np.float32(1) - np.float32(1.25) * noise / factor, np.float32(0))
            difference = image[y, x] - value
            if difference * difference < np.float32(36) * factor * max(value, np.float32(0)):
                value += share * difference
            model[y, x] = value
