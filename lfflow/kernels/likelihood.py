"""Maximum likelihood: the lattice that explains every pixel of a white image, with the sensor's own noise.

Model of a pixel at p under lens k: m(p) = b(p)·f(p − c_k), with b the smooth brightness of the field and f the mean
subimage. f is measured on the picture itself and made even, f(−ρ) = f(ρ): that fixes what a centre is, and costs no
information, for the derivatives by the centre are odd. The noise is var(m) = a + g·m, fitted to the residuals.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.lattice_fit import Fit, moved
from lfflow.kernels.subimage import Geometry, geometry
from lfflow.lattice import Lattice

FloatImage = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]
BINS = 6
"""Radial bins of the profile per pixel."""
ROUNDS = 5
SPARSE = 8
"""All rounds but the last read every so many pairs of rows."""
LEVELS = 24
OUTLIER = 5.0


@numba.njit(nogil=True, cache=True, inline="always")
def _lens(x: float, y: float, lens: Geometry) -> tuple[float, float, float, float]:
    """Nearest lens in the undistorted lattice (gx, gy) and the offset from it in units of the pitches."""
    cos, sin, dh, dv, cx, cy, hexagonal = lens
    gx, gy = (cos * (x - cx) + sin * (y - cy)) / dh, (-sin * (x - cx) + cos * (y - cy)) / dv
    if not hexagonal:
        kx, ky = math.floor(gx + 0.5), math.floor(gy + 0.5)
        return kx, ky, gx - kx, gy - ky
    height = 0.8660254037844386
    low = math.floor(gy / height)
    odd = 0.5 * (low % 2)
    ax, ay = math.floor(gx - odd + 0.5) + odd, height * low
    other = 0.5 - odd
    bx, by = math.floor(gx - other + 0.5) + other, height * (low + 1)
    if (gx - bx) ** 2 + (gy - by) ** 2 < (gx - ax) ** 2 + (gy - ay) ** 2:
        ax, ay = bx, by
    return ax, ay, gx - ax, gy - ay


@numba.njit(nogil=True, cache=True, inline="always")
def _field(x: float, y: float, field: FloatArray, middle: tuple[float, float]) -> float:
    """Brightness of the field: a polynomial of the second degree."""
    u, v = (x - middle[0]) / middle[0], (y - middle[1]) / middle[1]
    return float(field[0] + field[1] * u + field[2] * v + field[3] * u * u + field[4] * u * v + field[5] * v * v)


@numba.njit(nogil=True, cache=True)
def _radial(
    image: FloatImage, lens: Geometry, field: FloatArray, sites: FloatArray, bins: int, rows: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum of weights, and first moments of radius and brightness, in radial bins: a profile that is even by itself."""
    cos, sin = lens[0], lens[1]
    middle = ((image.shape[1] - 1) / 2.0, (image.shape[0] - 1) / 2.0)
    weight, radius, total = np.zeros(bins), np.zeros(bins), np.zeros(bins)
    for y in range(0, image.shape[0], rows):
        for x in range(image.shape[1]):
            _kx, _ky, ox, oy = _lens(float(x), float(y), lens)
            a, b = ox * lens[2], oy * lens[3]
            r = math.sqrt(a * a + b * b)
            index = int(r * BINS)
            if index < bins:
                bright = sites[y % 2, x % 2] * _field(x - cos * a + sin * b, y - sin * a - cos * b, field, middle)
                weight[index] += bright
                radius[index] += bright * r
                total[index] += image[y, x]
    return weight, radius, total


@numba.njit(nogil=True, cache=True)
def _normal_equations(
    image: FloatImage,
    lens: Geometry,
    field: FloatArray,
    spline: FloatArray,
    noise: FloatArray,
    sites: FloatArray,
    rows: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fisher matrix and score of (dh, dv, theta, cx, cy, field), residual moments by level, sums by Bayer site.

    `spline` (bins + 1, 2): value and slope of the profile at the radii j / BINS. `noise` (2,): variance a + g·m.
    `sites` (2, 2): gain left in each Bayer site. Every `rows`-th pair of sensor rows is read.
    """
    cos, sin, dh, dv = lens[0], lens[1], lens[2], lens[3]
    middle = ((image.shape[1] - 1) / 2.0, (image.shape[0] - 1) / 2.0)
    fisher, score, slope = np.zeros((11, 11)), np.zeros(11), np.zeros(11)
    levels, sums = np.zeros((3, LEVELS)), np.zeros((2, 2, 2))
    last = spline.shape[0] - 2
    for y in range(2, image.shape[0] - 2):
        if (y // 2) % rows != 0:
            continue
        for x in range(2, image.shape[1] - 2):
            kx, ky, ox, oy = _lens(float(x), float(y), lens)
            a, b = ox * dh, oy * dv
            r = math.sqrt(a * a + b * b)
            place = r * BINS
            index = int(place)
            if index > last:
                continue
            h = place - index
            value = _hermite(spline, index, h)
            steep = _hermite_slope(spline, index, h)
            u, v = (x - cos * a + sin * b - middle[0]) / middle[0], (y - sin * a - cos * b - middle[1]) / middle[1]
            bright = field[0] + field[1] * u + field[2] * v + field[3] * u * u + field[4] * u * v + field[5] * v * v
            bright *= sites[y % 2, x % 2]
            model = bright * value
            residual = image[y, x] - model
            variance = noise[0] + noise[1] * max(model, 0.0)
            if residual * residual > OUTLIER * OUTLIER * variance:
                continue
            sums[0, y % 2, x % 2] += image[y, x]
            sums[1, y % 2, x % 2] += model
            level = min(int(max(model, 0.0) * (LEVELS / 2.5)), LEVELS - 1)
            levels[0, level] += 1
            levels[1, level] += model
            levels[2, level] += residual * residual
            inverse = 1.0 / variance
            da, db = (bright * steep * a / r, bright * steep * b / r) if r > 1e-9 else (0.0, 0.0)
            # The offset (a, b) is R(−θ)(p − c) − diag(dh, dv)·k; its derivatives by the parameters:
            slope[0] = -da * kx
            slope[1] = -db * ky
            slope[2] = da * (b + dv * ky) - db * (a + dh * kx)
            slope[3] = -da * cos + db * sin
            slope[4] = -da * sin - db * cos
            slope[5], slope[6], slope[7] = value, value * u, value * v
            slope[8], slope[9], slope[10] = value * u * u, value * u * v, value * v * v
            for i in range(11):
                weighted = slope[i] * inverse
                score[i] += weighted * residual
                for j in range(i + 1):
                    fisher[i, j] += weighted * slope[j]
    for i in range(11):
        for j in range(i):
            fisher[j, i] = fisher[i, j]
    return fisher, score, levels, sums


@numba.njit(nogil=True, cache=True, inline="always")
def _hermite(spline: FloatArray, i: int, h: float) -> float:
    p, q = spline[i, 0], spline[i + 1, 0]
    m, n = spline[i, 1] / BINS, spline[i + 1, 1] / BINS
    return float(p + h * (m + h * (3 * (q - p) - 2 * m - n + h * (2 * (p - q) + m + n))))


@numba.njit(nogil=True, cache=True, inline="always")
def _hermite_slope(spline: FloatArray, i: int, h: float) -> float:
    p, q = spline[i, 0], spline[i + 1, 0]
    m, n = spline[i, 1] / BINS, spline[i + 1, 1] / BINS
    return float((m + h * (2 * (3 * (q - p) - 2 * m - n) + 3 * h * (2 * (p - q) + m + n))) * BINS)


def radial_profile(
    image: FloatImage, lattice: Lattice, field: FloatArray, sites: FloatArray, rows: int = 1
) -> FloatArray:
    """Value and slope of the mean subimage at the radii j / BINS px, shape (n, 2).

    Parameters
    ----------
    image
        White image with equal gains, shape (y, x).
    lattice
        Where the lenses are.
    field
        Six coefficients of the brightness of the field.
    sites
        Gain left in each Bayer site, shape (2, 2).
    rows
        Every so many sensor rows are read.
    """
    bins = int(0.6 * max(lattice.dh, lattice.dv) * BINS)
    weight, radius, total = _radial(image, geometry(lattice), field, sites, bins, rows)
    filled = weight > 0
    at = np.concatenate([-(radius[filled] / weight[filled])[2::-1], radius[filled] / weight[filled]])
    values = np.concatenate([(total[filled] / weight[filled])[2::-1], total[filled] / weight[filled]])
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(at, values)
    knots = np.arange(int(at[-1] * BINS) + 1) / BINS
    return np.stack([spline(knots), spline(knots, 1)], axis=1)


def refine(image: FloatImage, first: Fit) -> Fit:
    """Lattice of the highest likelihood and its covariance, the inverse Fisher information.

    Parameters
    ----------
    image
        White image with equal gains of the Bayer sites, mean 1, shape (y, x).
    first
        Lattice to within a few hundredths of a pixel.

    Raises
    ------
    LatticeNotFoundError
        The steps leave the neighbourhood of the first lattice: the picture is no white image.
    """
    lattice = first.lattice
    field = np.array([1.0, 0, 0, 0, 0, 0])
    noise = np.array([0.05, 0.05])
    sites = np.ones((2, 2))
    for turn in range(ROUNDS):
        rows = SPARSE if turn < ROUNDS - 1 else 1
        profile = radial_profile(image, lattice, field, sites, rows=max(rows - 1, 1))
        fisher, score, levels, sums = _normal_equations(image, geometry(lattice), field, profile, noise, sites, rows)
        sites *= sums[0] / sums[1]
        sites /= sites.mean()
        # A common factor of field and profile cannot be told apart: the field's constant stays at 1.
        free = np.array([0, 1, 2, 3, 4, 6, 7, 8, 9, 10])
        step = np.linalg.solve(fisher[np.ix_(free, free)], score[free])
        lattice = moved(lattice, step[:5])
        field[1:] += step[5:]
        noise = _noise_model(levels)
        if np.abs(step[3:5]).max() > first.lattice.dh:
            raise LatticeNotFoundError("the likelihood has no maximum near the measured centres")
    covariance = np.linalg.inv(fisher[np.ix_(free, free)])[:5, :5]
    return Fit(lattice, covariance, first.rms, first.count)


def _noise_model(levels: FloatArray) -> FloatArray:
    """Offset and slope of the variance against the level, both at least a little above 0."""
    count, total, squares = levels
    filled = count > 200
    level, variance = total[filled] / count[filled], squares[filled] / count[filled]
    weight = np.sqrt(count[filled]) / np.maximum(variance, 1e-12)
    design = np.stack([np.ones_like(level), level], axis=1)
    offset, slope = np.linalg.lstsq(design * weight[:, None], variance * weight, rcond=None)[0]
    return np.array([max(offset, 1e-2 * float(variance.min())), max(slope, 0.0)])
