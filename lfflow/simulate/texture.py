"""Textures: analytic waves for tests, and natural-looking ones with detail at every scale, edges and flat areas."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lfflow.simulate.scene import Texture

SCALE = 2.0
"""Texels a lens pitch."""
BAND_LIMIT = 0.45
"""Frequency, cycles a lens pitch, at which a natural texture has lost half of its amplitude."""

FloatArray = npt.NDArray[np.float64]
FloatImage = npt.NDArray[np.float32]


def flat_texture(colour: tuple[float, float, float]) -> Texture:
    """A texture of one colour."""
    return Texture(np.broadcast_to(np.array(colour, dtype=np.float32)[:, None, None], (3, 4, 4)).copy(), SCALE)


def wave_texture(
    frequency: tuple[float, float],
    mean: tuple[float, float, float] = (0.3, 0.4, 0.3),
    contrast: float = 0.5,
    size: int = 256,
) -> Texture:
    """Plane wave ``mean·(1 + contrast·sin(2π f·X))``, with its frequency rounded to whole periods of the texture.

    Parameters
    ----------
    frequency
        Cycles a lens pitch along X and Y.
    mean
        Mean radiance of each channel.
    contrast
        Relative amplitude.
    size
        Texels along each side, a power of two.
    """
    cycles = [round(f * size / SCALE) for f in frequency]
    i = np.arange(size) / size
    wave = np.sin(2 * np.pi * (cycles[0] * i[None, :] + cycles[1] * i[:, None]))
    values = np.array(mean)[:, None, None] * (1 + contrast * wave)[None]
    return Texture(values.astype(np.float32), SCALE)


def natural_texture(rng: np.random.Generator, size: int, palette: FloatArray, *, roughness: float = 1.0) -> Texture:
    """Overlapping leaves of the palette's colours with noise of 1/f amplitude over them.

    Fallen leaves of all sizes are the simplest model with the statistics of natural pictures: edges, plain areas and
    the same look at every scale.

    Parameters
    ----------
    rng
        Source of all chance.
    size
        Texels along each side, a power of two.
    palette
        Linear sRGB colours, shape (n, 3), in 0..1.
    roughness
        Strength of the noise; 0 leaves the areas plain.
    """
    colours, rough = _leaves(rng, size, palette)
    luminance = np.exp(roughness * rough * _noise(rng, size, 1.0))
    values = _band_limited(colours * luminance[..., None])
    return Texture(np.ascontiguousarray(np.moveaxis(np.clip(values, 0.004, 1.0), -1, 0)), SCALE)


def smooth_texture(rng: np.random.Generator, size: int, palette: FloatArray, *, grain: float) -> Texture:
    """A plain painted surface: two colours that pass into each other over the whole texture, and a faint grain.

    Parameters
    ----------
    rng, size, palette
        As for `natural_texture`.
    grain
        Relative standard deviation of the grain, of 1/f amplitude.
    """
    first, second = palette[rng.choice(len(palette), 2, replace=False)]
    share = 0.5 + 0.15 * _noise(rng, size, 2.5)[..., None]
    values = (first + np.clip(share, 0, 1) * 0.5 * (second - first)) * np.exp(grain * _noise(rng, size, 1.0))[..., None]
    values = _band_limited(values.astype(np.float32))
    return Texture(np.ascontiguousarray(np.moveaxis(np.clip(values, 0.004, 1.0), -1, 0)), SCALE)


def _frequencies(size: int) -> FloatArray:
    """Spatial frequency of a real transform's coefficients, cycles a texel."""
    return np.asarray(np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :]))


def _noise(rng: np.random.Generator, size: int, exponent: float) -> FloatImage:
    """Periodic Gaussian noise with amplitude spectrum 1/f^exponent above 4 cycles a texture; unit variance."""
    from scipy import fft

    spectrum = fft.rfft2(rng.standard_normal((size, size), dtype=np.float32))
    spectrum *= (np.maximum(_frequencies(size), 4 / size) ** -exponent).astype(np.float32)
    spectrum[0, 0] = 0
    noise: FloatImage = fft.irfft2(spectrum, s=(size, size))
    noise /= noise.std()
    return noise


def _leaves(rng: np.random.Generator, size: int, palette: FloatArray) -> tuple[FloatImage, FloatImage]:
    """Colours (N, N, 3) and strength of the noise (N, N) of leaves that cover each other."""
    import cv2

    image = np.empty((size, size, 4), dtype=np.float32)
    image[:] = (*palette[0], 0.25)
    count = max(60, size * size // 900)
    radii = np.sort(_leaf_radii(rng, count, smallest=3.0, largest=size / 7))[::-1]
    for radius in radii:
        colour = palette[rng.integers(len(palette))] * rng.uniform(0.6, 1.25)
        strength = rng.choice([0.05, 0.2, 0.35, 0.5], p=[0.12, 0.28, 0.35, 0.25])
        value = (*(float(c) for c in np.clip(colour, 0.01, 0.95)), float(strength))
        x, y = rng.uniform(0, size, 2)
        axes = (radius, radius * rng.uniform(0.35, 1.0))
        angle = rng.uniform(0, 360)
        polygon = _corners(rng, axes, angle) if rng.random() < 0.4 else None
        for dx in _copies(x, radius, size):
            for dy in _copies(y, radius, size):
                _draw(cv2, image, (x + dx, y + dy), axes, angle, value, polygon)
    return image[..., :3], image[..., 3]


def _leaf_radii(rng: np.random.Generator, count: int, smallest: float, largest: float) -> FloatArray:
    """Radii with density r^−3, the one that looks the same at every scale."""
    low, high = smallest**-2, largest**-2
    return (low - rng.random(count) * (low - high)) ** -0.5


def _copies(position: float, radius: float, size: int) -> list[int]:
    """Shifts at which a leaf shows on a periodic picture."""
    return [shift for shift in (-size, 0, size) if -radius < position + shift < size + radius]


def _corners(rng: np.random.Generator, axes: tuple[float, float], angle: float) -> FloatArray:
    """Corners (n, 2) of a convex polygon in an ellipse about the origin."""
    turn = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
    x, y = axes[0] * np.cos(turn), axes[1] * np.sin(turn)
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _draw(
    cv2: Any,
    image: FloatImage,
    middle: tuple[float, float],
    axes: tuple[float, float],
    angle: float,
    value: tuple[float, ...],
    polygon: FloatArray | None,
) -> None:
    """Fill an ellipse or polygon, positions to 1/16 texel."""
    centre = (round(middle[0] * 16), round(middle[1] * 16))
    if polygon is None:
        size = (round(axes[0] * 16), round(axes[1] * 16))
        cv2.ellipse(image, centre, size, angle, 0, 360, value, -1, cv2.LINE_8, 4)
    else:
        points = np.round((polygon + middle) * 16).astype(np.int32)
        cv2.fillPoly(image, [points], value, cv2.LINE_8, 4)


def _band_limited(image: FloatImage) -> FloatImage:
    """Periodic image (N, N, 3) after a Gaussian low-pass that halves the amplitude at `BAND_LIMIT`."""
    from scipy import fft

    gain = np.exp(-np.log(2) * (_frequencies(image.shape[0]) * SCALE / BAND_LIMIT) ** 2).astype(np.float32)
    low: FloatImage = fft.irfft2(fft.rfft2(image, axes=(0, 1)) * gain[..., None], s=image.shape[:2], axes=(0, 1))
    return low
