"""A first lattice from the image's own spectrum: nothing is known of pitch, rotation or offset.

The spectrum of a lattice of subimages is a lattice of lines at the reciprocal vectors. They are found in the logarithm
of the picture, where the scene and the lattice add instead of multiplying.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from lfflow.errors import LatticeNotFoundError
from lfflow.lattice import ARRANGEMENTS, Arrangement, Lattice

MIN_PITCH, MAX_PITCH = 5.5, 66.0
MAX_STRETCH = 0.025
"""Difference of the two pitches that a spectrum's resolution can make of none."""
MAX_TILT = math.radians(4.5)
BAND = 0.5
"""The 2×2 bins repeat the spectrum at so many cycles per sensor pixel: beyond half of it lines are folded back."""
TILE = 1024
PEAKS = 80
SIGNIFICANCE = 14.0
"""A line must exceed the local background by this factor: of a million bins of pure noise one does."""

Vectors = npt.NDArray[np.float64]


def log_bins(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Logarithm of the 2×2 sums (no colour pattern is left in them), shape (y // 2, x // 2)."""
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    bins = cv2.resize(image[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    middle = float(np.median(bins[::4, ::4]))
    if not middle > 0:
        raise LatticeNotFoundError("the picture is too dark: more than half of it lies at the black level")
    return np.log(np.maximum(bins, 0) + np.float32(0.1 * middle))


def start(image: npt.NDArray[np.float32]) -> Lattice:
    """Lattice of a picture, accurate to a few tenths of a pixel, without any prior knowledge.

    Parameters
    ----------
    image
        Gray image with equal gains of the Bayer sites, shape (y, x).

    Raises
    ------
    LatticeNotFoundError
        No set of spectral lines forms a lattice with a pitch of 5.5 to 66 px that is turned by less than 4.5°.
    """
    bins = log_bins(image)
    vectors, ratios, resolution = spectral_lines(bins)
    arrangement, basis = _best_lattice(vectors, ratios, resolution)
    lattice = _from_reciprocal(basis, arrangement)
    return _with_origin(bins, lattice)


def spectral_lines(bins: npt.NDArray[np.float32]) -> tuple[Vectors, npt.NDArray[np.float64], float]:
    """Significant lines of the mean power spectrum of overlapping tiles.

    Returns
    -------
    vectors, ratios, resolution
        Frequencies (n, 2) as (x, y) in cycles per sensor pixel, with both signs; power over the background (n,);
        width of a bin in cycles per sensor pixel.
    """
    power = _mean_power(bins)
    rows, columns = power.shape[0], (power.shape[1] - 1) * 2
    fy, fx = np.fft.fftfreq(rows)[:, None] / 2, np.arange(power.shape[1])[None, :] / columns / 2
    radius = np.hypot(fx, fy)
    ratio = power / _background(power, radius)
    ratio = np.fft.fftshift(ratio, axes=0).astype(np.float32)
    radius = np.fft.fftshift(radius, axes=0)
    top = cv2.dilate(ratio, np.ones((5, 5), np.uint8))
    peak = (ratio == top) & (ratio > SIGNIFICANCE) & (radius > 0.8 / MAX_PITCH)
    peak[:, -1:] = False
    peak[0], peak[-1] = False, False
    y, x = np.nonzero(peak)
    if y.size == 0:
        raise LatticeNotFoundError("the picture's spectrum holds no line above its noise: it is too flat or too dark")
    order = np.argsort(ratio[y, x])[::-1][:PEAKS]
    y, x = y[order], x[order]
    logs = np.log(np.maximum(ratio, 1e-6))
    dy = _vertex(logs[y - 1, x], logs[y, x], logs[y + 1, x])
    left = np.where(x == 0, logs[rows - 1 - np.clip(y - 1, 0, rows - 1), 1], logs[y, x - 1])
    dx = _vertex(left, logs[y, x], logs[y, x + 1])
    vectors = np.stack([(x + dx) / columns / 2, (y + dy - rows // 2) / rows / 2], axis=1)
    return np.concatenate([vectors, -vectors]), np.tile(ratio[y, x].astype(float), 2), 1 / min(rows, columns) / 2


def _mean_power(bins: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Power spectrum (rows, columns // 2 + 1), mean over up to 2×2 tiles."""
    rows, columns = (min(TILE, size // 16 * 16) for size in bins.shape)
    if min(rows, columns) < 32:
        raise LatticeNotFoundError(f"a picture of {bins.shape[1] * 2}×{bins.shape[0] * 2} px is too small")
    window = (np.hanning(rows + 1)[:-1, None] * np.hanning(columns + 1)[None, :-1]).astype(np.float32)
    power = np.zeros((rows, columns // 2 + 1), np.float32)
    for top in sorted({0, bins.shape[0] - rows}):
        for left in sorted({0, bins.shape[1] - columns}):
            tile = bins[top : top + rows, left : left + columns]
            power += np.abs(np.fft.rfft2((tile - tile.mean()) * window)) ** 2
    return power


def _background(power: npt.NDArray[np.float32], radius: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Median of the power in rings of equal width on a logarithmic scale, interpolated."""
    edges = np.geomspace(max(float(radius[radius > 0].min()), 0.002), float(radius.max()) * 1.001, 25)
    ring = np.digitize(radius.ravel(), edges)
    values, places = [], []
    flat = power.ravel()
    for index in range(1, edges.size):
        inside = flat[ring == index]
        if inside.size >= 12:
            values.append(math.log(max(float(np.median(inside)), 1e-30)))
            places.append(math.log(edges[index - 1] * edges[index]) / 2)
    if not values:
        raise LatticeNotFoundError("the picture is too small for its spectrum to be judged")
    smooth = np.interp(np.log(np.maximum(radius, edges[0])), places, values)
    return np.asarray(np.exp(smooth) + 1e-30, dtype=np.float64)


def _vertex(before: npt.NDArray[np.float32], at: npt.NDArray[np.float32], after: npt.NDArray[np.float32]) -> Vectors:
    """Place of the vertex of the parabola through three samples, in −½…½."""
    curvature = np.minimum(before - 2 * at + after, -1e-6)
    return np.asarray(np.clip((before - after) / (2 * curvature), -0.5, 0.5), dtype=np.float64)


def reciprocal_shells(arrangement: Arrangement) -> npt.NDArray[np.int64]:
    """Integer combinations of the two reciprocal vectors, first shell first, by rising length, shape (n, 2)."""
    metric = np.linalg.inv(Lattice(1, 1, 0, 0, 0, arrangement).matrix)
    m = np.array([(i, j) for i in range(-4, 5) for j in range(-4, 5) if (i, j) != (0, 0)])
    length = np.hypot(*(m @ metric).T)
    order = np.argsort(length, kind="stable")
    return np.asarray(m[order[length[order] < 3.2 * length.min()]], dtype=np.int64)


class _Candidate(NamedTuple):
    """Reciprocal basis, the significance of the lines that it explains, and of those within reach that it does not."""

    pitch: float
    basis: Vectors
    explained: float
    left: float
    arrangement: Arrangement


def _best_lattice(vectors: Vectors, ratios: Vectors, resolution: float) -> tuple[Arrangement, Vectors]:
    """Reciprocal basis (rows g1, g2) that explains most of the lines; of equals the one of the smallest pitch."""
    candidates = []
    gain = np.log(ratios)
    for arrangement in ARRANGEMENTS:
        matrix = Lattice(1, 1, 0, 0, 0, arrangement).matrix
        upright = np.linalg.inv(matrix)[1, 1]
        tilt = np.abs(np.arctan2(vectors[:, 0], vectors[:, 1]))
        length = np.hypot(*vectors.T)
        near = (tilt < MAX_TILT + resolution / length) & (length < upright / MIN_PITCH) & (length > upright / MAX_PITCH)
        for g2 in vectors[near]:
            pitch, theta = upright / math.hypot(*g2), math.atan2(-g2[0], g2[1])
            basis = inverse(Lattice(pitch, pitch, theta, 0, 0, arrangement).matrix)
            found = _fit_basis(basis, arrangement, vectors, gain, resolution)
            if found is not None and _plausible(found[0], arrangement):
                candidates.append(_Candidate(pitch, *found, arrangement))
    if not candidates:
        raise LatticeNotFoundError(
            "the lines of the picture's spectrum form no lattice: it is too dark or too flat, or no plenoptic picture"
        )
    most = max(candidate.explained for candidate in candidates)
    alike = [candidate for candidate in candidates if candidate.explained > 0.9 * most]
    finest = min(alike, key=lambda one: (one.pitch, -one.explained))
    # Half the pitch explains every other line; the whole one explains more of them and leaves fewer.
    better = [one for one in alike if one.explained > finest.explained and one.left < finest.left]
    chosen = min(better, key=lambda one: one.left, default=finest)
    return chosen.arrangement, chosen.basis


def _plausible(basis: Vectors, arrangement: Arrangement) -> bool:
    """Whether a reciprocal basis is that of a lens array: pitches in range, and alike."""
    lattice = _from_reciprocal(basis, arrangement)
    return min(lattice.dh, lattice.dv) > MIN_PITCH and abs(lattice.dv / lattice.dh - 1) < MAX_STRETCH


def _fit_basis(
    basis: Vectors, arrangement: Arrangement, vectors: Vectors, gain: Vectors, resolution: float
) -> tuple[Vectors, float, float] | None:
    """Basis fitted to the lines near its multiples; None without a first shell.

    With it come the significance that they add up to, and that of all other lines within the multiples' reach.
    """
    shells = reciprocal_shells(arrangement)
    first = 6 if arrangement == "hexagonal" else 4
    for count in (first, len(shells)):
        predicted = shells[:count] @ basis
        folds = BAND * np.rint(predicted / BAND)
        distance = np.hypot(*(predicted[:, None] - folds[:, None] - vectors[None]).transpose(2, 0, 1))
        tolerance = 1.5 * resolution + 0.03 * np.hypot(*basis[0]) * (count == first)
        nearest = distance.argmin(axis=1)
        matched = distance[np.arange(count), nearest] < tolerance
        if not matched[:first].all():
            return None
        used = shells[:count][matched].astype(float)
        weight = np.sqrt(gain[nearest[matched]])[:, None]
        lines = vectors[nearest[matched]] + folds[matched]
        basis = np.linalg.lstsq(used * weight, lines * weight, rcond=None)[0]
    within = np.hypot(*vectors.T) < np.hypot(*predicted.T).max()
    explained = float(gain[np.unique(nearest[matched])].sum())
    return basis, explained, float(gain[within].sum()) - explained


def inverse(matrix: Vectors) -> Vectors:
    """Inverse of a matrix, float64."""
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _from_reciprocal(basis: Vectors, arrangement: Arrangement) -> Lattice:
    return from_matrix(inverse(basis), arrangement)


def from_matrix(matrix: Vectors, arrangement: Arrangement, cx: float = 0.0, cy: float = 0.0) -> Lattice:
    """Five parameters of a general 2×2 matrix T: column norms of T·A⁻¹ and the mean of its two rotations (Alg. 1)."""
    shape = matrix @ np.linalg.inv(Lattice(1, 1, 0, 0, 0, arrangement).matrix)
    dh, dv = np.hypot(*shape)
    theta = 0.5 * (math.asin(np.clip(shape[1, 0] / dh, -1, 1)) + math.asin(np.clip(-shape[0, 1] / dv, -1, 1)))
    return Lattice(float(dh), float(dv), theta, cx, cy, arrangement)


def coefficient(bins: npt.NDArray[np.float32], frequency: Vectors) -> complex:
    """Fourier coefficient of the middle of `bins` at one frequency (cycles per sensor pixel), phase at the pixel 0."""
    rows, columns = bins.shape
    y, x = 2 * np.arange(rows) + 0.5, 2 * np.arange(columns) + 0.5
    wave_y = (np.hanning(rows + 2)[1:-1] * np.exp(-2j * np.pi * frequency[1] * y)).astype(np.complex64)
    wave_x = (np.hanning(columns + 2)[1:-1] * np.exp(-2j * np.pi * frequency[0] * x)).astype(np.complex64)
    return complex(wave_y @ (bins @ wave_x.real + 1j * (bins @ wave_x.imag)))


def _with_origin(bins: npt.NDArray[np.float32], lattice: Lattice) -> Lattice:
    """Lattice with the origin that the phases of its first lines ask for: a lens centre near the middle of `bins`."""
    rows, columns = (min(size, 512) for size in bins.shape)
    top, left = (bins.shape[0] - rows) // 2, (bins.shape[1] - columns) // 2
    crop = bins[top : top + rows, left : left + columns]
    crop = crop - crop.mean()
    basis = np.linalg.inv(lattice.matrix)
    first, second = coefficient(crop, basis[0]), coefficient(crop, basis[1])
    if lattice.arrangement == "hexagonal":
        third = coefficient(crop, basis[0] + basis[1])
        if (first * second * third.conjugate()).real < 0:  # dark centres: all lines have turned sign
            first, second = -first, -second
    phases = -np.angle([first, second]) / (2 * np.pi)
    x, y = lattice.matrix @ phases + (2 * left, 2 * top)
    return replace(lattice, cx=float(x), cy=float(y))
