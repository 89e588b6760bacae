"""A scene that is hard to match: plain surfaces, thin things in front of them, and planes steeply turned away.

Natural scenes (`lfflow.simulate.natural`) have detail everywhere, which real rooms do not. Here the backdrop and the
largest object hardly change over a window of any size, a fence and twigs are as narrow as one to three lens pitches,
what lies behind is seen between them, and two boards run through a large part of the range of disparities.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lfflow.simulate.natural import Outline, OutlineMaker, block, disc, leaf, palette, rasterise
from lfflow.simulate.scene import Layer, Scene, Texture
from lfflow.simulate.texture import natural_texture, smooth_texture

FloatArray = npt.NDArray[np.float64]

FAR, NEAR = -0.45, 0.5
"""Disparity of the backdrop in the middle, and of the nearest twig, lens pitches per view step."""


def hard_scene(rng: np.random.Generator, half_size: float) -> Scene:
    """Scene of plain walls, slanted boards, a large smooth body, a fence and twigs; matt, every plane opaque.

    Parameters
    ----------
    rng
        Source of all chance.
    half_size
        Half of the picture's longer side, lens pitches; objects and masks are made for it.
    """
    size = 1 << int(np.ceil(np.log2(np.clip(4 * (half_size + 12), 64.0, 1024.0))))
    plain = [smooth_texture(rng, size, palette(name), grain=grain) for name, grain in _PLAIN]
    rough = [natural_texture(rng, size, palette(name), roughness=0.8) for name in ("earth", "petals", "leaves")]
    wall = Layer(plain[0], FAR, (float(rng.uniform(-0.1, 0.1)) / half_size, 0.0), angle=float(rng.uniform(0, 6)))
    boards = [_board(rng, half_size, side, texture) for side, texture in ((-1, rough[0]), (1, plain[1]))]
    return Scene(
        (
            wall,
            *boards,
            _object(rng, half_size, disc, plain[2], middle=rng.uniform(-0.5, 0.5, 2), size=0.42, disparity=-0.08),
            _object(rng, half_size, leaf, rough[1], middle=rng.uniform(-0.7, 0.7, 2), size=0.22, disparity=0.04),
            _object(rng, half_size, block, plain[1], middle=rng.uniform(-0.7, 0.7, 2), size=0.25, disparity=0.16),
            _object(rng, half_size, fence, rough[2], middle=rng.uniform(-0.4, 0.4, 2), size=0.45, disparity=0.30),
            _object(rng, half_size, twigs, plain[0], middle=rng.uniform(-0.3, 0.3, 2), size=0.80, disparity=NEAR),
        ),
        name="hard",
    )


_PLAIN = (("wall", 0.006), ("earth", 0.01), ("petals", 0.006))
"""Palette and relative strength of the grain of the plain surfaces; the noise of one sample is about 0.02."""


def _board(rng: np.random.Generator, half_size: float, side: int, texture: Texture) -> Layer:
    """A board below (side 1) or at the left (−1) that comes from the wall towards the camera."""
    edge = half_size * float(rng.uniform(0.35, 0.55))
    slope = float(rng.uniform(0.55, 0.75)) / (half_size - edge)
    along, across = (0.0, slope), (slope * side, 0.0)
    bounds = (-1e9, 1e9, edge, 1e9) if side > 0 else (-1e9, -edge, -1e9, 1e9)
    return Layer(
        texture, FAR + 0.03 - slope * edge, along if side > 0 else across, bounds=bounds, angle=float(rng.uniform(0, 6))
    )


def _object(
    rng: np.random.Generator,
    half_size: float,
    outline: OutlineMaker,
    texture: Texture,
    *,
    middle: FloatArray,
    size: float,
    disparity: float,
) -> Layer:
    """An object of relative `size` about `middle` (both in units of `half_size`), turned a little from the camera."""
    radius, middle = size * half_size * float(rng.uniform(0.8, 1.2)), middle * half_size
    slope = rng.uniform(-1, 1, 2) * 0.06 / half_size
    tint = rng.uniform(0.6, 1.2) * rng.uniform(0.85, 1.15, 3)
    return Layer(
        texture,
        disparity - float(slope @ middle),
        (float(slope[0]), float(slope[1])),
        outline=rasterise(outline(rng, middle, radius), half_size + 12),
        shift=(float(rng.uniform(0, 500)), float(rng.uniform(0, 500))),
        angle=float(rng.uniform(0, 6)),
        tint=(float(tint[0]), float(tint[1]), float(tint[2])),
    )


def fence(rng: np.random.Generator, middle: FloatArray, radius: float) -> Outline:
    """Parallel bars, each one to three lens pitches wide, and a rail across them."""
    count, turn = 9, float(rng.uniform(-0.3, 0.3))
    cos, sin = np.cos(turn), np.sin(turn)
    bars = (np.arange(count) - (count - 1) / 2) * 2 * radius / count + rng.uniform(-0.3, 0.3, count)
    widths = rng.uniform(0.5, 1.5, count)

    def inside(x: FloatArray, y: FloatArray) -> FloatArray:
        along, across = cos * (x - middle[0]) + sin * (y - middle[1]), cos * (y - middle[1]) - sin * (x - middle[0])
        edge = np.maximum(np.abs(along), np.abs(across)) - radius
        bar = np.max([width - np.abs(along - place) for place, width in zip(bars, widths, strict=True)], axis=0)
        return np.asarray(np.minimum(np.maximum(bar, 1.2 - np.abs(across - 0.3 * radius)), -edge))

    return inside


def twigs(rng: np.random.Generator, middle: FloatArray, radius: float) -> Outline:
    """Crooked twigs from one place outwards, one to two lens pitches wide."""
    segments = []
    for _ in range(5):
        start, heading = np.array(middle), float(rng.uniform(0, 2 * np.pi))
        for thickness in np.linspace(1.1, 0.5, 6):
            heading += float(rng.normal(0, 0.35))
            end = start + radius / 5 * np.array([np.cos(heading), np.sin(heading)])
            segments.append((start, end, float(thickness)))
            start = end

    def inside(x: FloatArray, y: FloatArray) -> FloatArray:
        nearest = np.full(np.broadcast_shapes(x.shape, y.shape), -np.inf)
        for start, end, thickness in segments:
            np.maximum(nearest, thickness - _distance(x, y, start, end), out=nearest)
        return np.asarray(nearest)

    return inside


def _distance(x: FloatArray, y: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Distance of points from a line segment."""
    step = end - start
    share = ((x - start[0]) * step[0] + (y - start[1]) * step[1]) / (step @ step)
    share = np.clip(share, 0, 1)
    return np.asarray(np.hypot(x - start[0] - share * step[0], y - start[1] - share * step[1]))
