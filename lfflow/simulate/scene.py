"""What the simulated camera looks at: textured opaque planes, each with its own disparity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from lfflow.simulate.rays import SceneArrays

MASK_SCALE = 2.0
"""Mask texels a lens pitch."""
EVERYWHERE = (-1e9, 1e9, -1e9, 1e9)

FloatImage = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A periodic colour texture, interpolated by cubic B-splines.

    Parameters
    ----------
    values
        Radiance at the texels, shape (3, N, N), channels R, G, B, N a power of two.
    scale
        Texels a lens pitch.
    """

    values: FloatImage
    scale: float = 2.0

    def __post_init__(self) -> None:
        size = self.values.shape[-1]
        if self.values.shape != (3, size, size) or size & (size - 1):
            raise ValueError(f"a texture is (3, N, N) with N a power of two, not {self.values.shape}")

    def coefficients(self) -> FloatImage:
        """B-spline coefficients, shape (3, N, N)."""
        from scipy.ndimage import spline_filter

        channels = [spline_filter(channel, order=3, output=np.float32, mode="grid-wrap") for channel in self.values]
        return np.stack(channels)


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One opaque plane with a texture and an outline.

    Parameters
    ----------
    texture
        What it looks like; texel (0, 0) lies at the scene's origin, the middle of the sensor.
    disparity
        Disparity at the scene's origin, lens pitches per view step.
    slope
        Its gradient along X and Y, per lens pitch.
    outline
        Positive where the layer is opaque, shape (J, J), `MASK_SCALE` texels a lens pitch, the middle texel at the
        scene's origin, in the coordinates of the central view; None is opaque everywhere.
    bounds
        Rectangle (x0, x1, y0, y1) outside which the layer is transparent, lens pitches from the scene's origin.
    shift, angle
        Offset (lens pitches) and rotation (radians) of the texture on the layer.
    tint
        Factor of each channel.
    """

    texture: Texture
    disparity: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    outline: FloatImage | None = None
    bounds: tuple[float, float, float, float] = EVERYWHERE
    shift: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Opaque layers; where several meet a ray, the one of the largest disparity is seen."""

    layers: Sequence[Layer]
    name: str = "scene"
    _arrays: list[SceneArrays] = field(default_factory=list, repr=False)

    def arrays(self) -> SceneArrays:
        """The scene as arrays for the kernels, made once."""
        if not self._arrays:
            self._arrays.append(_pack(self.layers))
        return self._arrays[0]


def _pack(layers: Sequence[Layer]) -> SceneArrays:
    layers = sorted(layers, key=lambda layer: -layer.disparity)  # front to back, so that few masks are looked at
    textures = list({id(layer.texture): layer.texture for layer in layers}.values())
    outlines = list({id(layer.outline): layer.outline for layer in layers if layer.outline is not None}.values())
    texture_ids, outline_ids = [id(t) for t in textures], [id(o) for o in outlines]
    frames = []
    for layer in layers:
        scale = layer.texture.scale
        cos, sin = scale * np.cos(layer.angle), scale * np.sin(layer.angle)
        frames.append((cos, sin, scale * layer.shift[0], scale * layer.shift[1]))
    return SceneArrays(
        planes=np.array([(layer.disparity, *layer.slope) for layer in layers], dtype=np.float64),
        bounds=np.array([layer.bounds for layer in layers], dtype=np.float64),
        mask_index=np.array([-1 if o.outline is None else outline_ids.index(id(o.outline)) for o in layers]),
        texture_index=np.array([texture_ids.index(id(layer.texture)) for layer in layers]),
        frames=np.array(frames, dtype=np.float64),
        tints=np.array([layer.tint for layer in layers], dtype=np.float32),
        textures=np.stack([texture.coefficients() for texture in textures]),
        masks=np.stack(outlines).astype(np.float32) if outlines else np.zeros((1, 2, 2), dtype=np.float32),
        mask_scale=MASK_SCALE,
    )
