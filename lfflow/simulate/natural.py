"""A natural-looking scene: a slanted ground, a backdrop, and objects before each other at several disparities."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from lfflow.simulate.scene import MASK_SCALE, FloatImage, Layer, Scene, Texture
from lfflow.simulate.texture import natural_texture

FloatArray = npt.NDArray[np.float64]
Outline = Callable[[FloatArray, FloatArray], FloatArray]
OutlineMaker = Callable[[np.random.Generator, FloatArray, float], Outline]

_PALETTES = {
    "leaves": [(0.05, 0.16, 0.04), (0.18, 0.34, 0.08), (0.40, 0.45, 0.12), (0.09, 0.22, 0.12), (0.02, 0.06, 0.02)],
    "earth": [(0.24, 0.16, 0.10), (0.42, 0.33, 0.22), (0.12, 0.08, 0.06), (0.60, 0.52, 0.40), (0.30, 0.30, 0.28)],
    "wall": [(0.45, 0.44, 0.42), (0.62, 0.58, 0.50), (0.28, 0.30, 0.34), (0.50, 0.36, 0.28), (0.72, 0.72, 0.70)],
    "petals": [(0.62, 0.10, 0.12), (0.70, 0.44, 0.08), (0.55, 0.20, 0.42), (0.80, 0.72, 0.60), (0.25, 0.22, 0.55)],
}


def palette(name: str) -> FloatArray:
    """Linear sRGB colours (n, 3) of "leaves", "earth", "wall" or "petals"."""
    return np.array(_PALETTES[name])


def natural_scene(rng: np.random.Generator, half_size: float, *, objects: int = 7) -> Scene:
    """Scene of a backdrop, a ground that rises towards the camera, and objects in front of them.

    All disparities lie within ±0.55 lens pitches per view step.

    Parameters
    ----------
    rng
        Source of all chance.
    half_size
        Half of the picture's longer side, lens pitches; objects and masks are made for it.
    objects
        Number of objects.
    """
    reach = half_size + 12
    size = 1 << int(np.ceil(np.log2(max(64.0, min(2 * reach * 2, 1024.0)))))
    textures = {name: natural_texture(rng, size, palette(name), roughness=rng.uniform(0.7, 1.3)) for name in _PALETTES}
    layers = _surroundings(rng, half_size, textures)
    names = list(textures)
    for index in range(objects):
        near = (index + rng.uniform(0.2, 0.8)) / objects
        texture = textures[names[int(rng.integers(len(names)))]]
        layers.append(_object(rng, half_size, near, texture))
    return Scene(tuple(layers), name="natural")


def _surroundings(rng: np.random.Generator, half_size: float, textures: dict[str, Texture]) -> list[Layer]:
    """Backdrop, slightly turned, and a ground from the horizon to the lower edge."""
    far = rng.uniform(-0.42, -0.30)
    turn = rng.uniform(-0.06, 0.06) / half_size
    horizon = half_size * rng.uniform(0.0, 0.35)
    rise = rng.uniform(0.25, 0.5) / (half_size - horizon)
    ground_at_horizon = far + 0.02
    backdrop = Layer(textures["wall"], far, (turn, 0.0), angle=rng.uniform(0, 0.2))
    ground = Layer(
        textures["earth"],
        ground_at_horizon - rise * horizon,
        (0.0, rise),
        bounds=(-1e9, 1e9, horizon, 1e9),
        angle=rng.uniform(0, 6),
    )
    return [backdrop, ground]


def _object(rng: np.random.Generator, half_size: float, near: float, texture: Texture) -> Layer:
    """An object whose disparity grows and whose size shrinks with `near` (0..1)."""
    radius = half_size * rng.uniform(0.16, 0.42) * (1.15 - 0.5 * near)
    middle = rng.uniform(-0.8, 0.8, 2) * half_size
    disparity = -0.28 + 0.72 * near
    slope = rng.uniform(-1, 1, 2) * 0.12 / half_size * (rng.random() < 0.5)
    outline = _OUTLINES[int(rng.integers(len(_OUTLINES)))](rng, middle, radius)
    brightness = rng.uniform(0.7, 1.3)
    tint = np.clip(brightness * rng.uniform(0.8, 1.2, 3), 0.4, 1.5)
    return Layer(
        texture,
        disparity - float(slope @ middle),
        (float(slope[0]), float(slope[1])),
        outline=rasterise(outline, half_size + 12),
        bounds=(middle[0] - 2 * radius, middle[0] + 2 * radius, middle[1] - 2 * radius, middle[1] + 2 * radius),
        shift=(float(rng.uniform(0, 500)), float(rng.uniform(0, 500))),
        angle=float(rng.uniform(0, 6)),
        tint=(float(tint[0]), float(tint[1]), float(tint[2])),
    )


def rasterise(outline: Outline, reach: float) -> FloatImage:
    """Outline function of (X, Y), positive inside, as a mask that reaches `reach` lens pitches from the origin."""
    half = int(np.ceil(reach * MASK_SCALE))
    axis = (np.arange(2 * half) - half) / MASK_SCALE
    return outline(axis[None, :], axis[:, None]).astype(np.float32)


def disc(rng: np.random.Generator, middle: FloatArray, radius: float) -> Outline:
    """An ellipse."""
    squeeze = rng.uniform(0.6, 1.0)
    return lambda x, y: radius - np.hypot(x - middle[0], (y - middle[1]) / squeeze)


def leaf(rng: np.random.Generator, middle: FloatArray, radius: float) -> Outline:
    """A lobed star shape such as a flower or a leaf."""
    lobes, depth, turn = int(rng.integers(3, 8)), rng.uniform(0.15, 0.4), rng.uniform(0, 6)

    def inside(x: FloatArray, y: FloatArray) -> FloatArray:
        dx, dy = x - middle[0], y - middle[1]
        edge = radius * (1 - depth + depth * np.cos(lobes * np.arctan2(dy, dx) + turn))
        return np.asarray(edge - np.hypot(dx, dy))

    return inside


def block(rng: np.random.Generator, middle: FloatArray, radius: float) -> Outline:
    """A turned rectangle."""
    turn, ratio = rng.uniform(0, 3), rng.uniform(0.4, 1.0)
    cos, sin = np.cos(turn), np.sin(turn)

    def inside(x: FloatArray, y: FloatArray) -> FloatArray:
        dx, dy = x - middle[0], y - middle[1]
        along, across = np.abs(cos * dx + sin * dy), np.abs(cos * dy - sin * dx)
        return np.asarray(np.minimum(radius - along, ratio * radius - across))

    return inside


def ring(rng: np.random.Generator, middle: FloatArray, radius: float) -> Outline:
    """A ring: what lies behind shows through."""
    inner = radius * rng.uniform(0.45, 0.65)

    def inside(x: FloatArray, y: FloatArray) -> FloatArray:
        r = np.hypot(x - middle[0], y - middle[1])
        return np.asarray(np.minimum(radius - r, r - inner))

    return inside


_OUTLINES = (disc, leaf, leaf, block, ring)
