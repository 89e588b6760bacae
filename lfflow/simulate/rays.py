"""Rays from sensor pixels through the lens array into a scene of opaque planes: the numba kernels.

Scene coordinates (X, Y) are lens pitches along the axes of the lattice, with the origin at the sensor's centre. A ray
is a point of the lens plane and an angular offset (a, b) in sensor pixels along the same axes. The point at P of a
plane with disparity d(P) = d0 + g·P (P its place in the central view) is seen at X = P − d·a (`lfflow.conventions`),
so a ray (X, a) meets the plane at P = X + D·a with D = (d0 + g·X) / (1 − g·a). The nearest opaque plane is seen.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt


class SceneArrays(NamedTuple):
    """A scene as the kernels want it: L layers, K textures, M masks.

    ``planes`` (L, 3): d0, gx, gy. ``bounds`` (L, 4): x0, x1, y0, y1 in lens pitches. ``mask_index`` (L,): −1 is opaque
    everywhere. ``texture_index`` (L,); ``frames`` (L, 4): texel = (a·X − b·Y + c, b·X + a·Y + d). ``tints`` (L, 3).
    ``textures`` (K, 3, N, N): periodic cubic B-spline coefficients, N a power of two. ``masks`` (M, J, J): positive
    where opaque, ``mask_scale`` texels a lens pitch, the middle texel at the scene's origin.
    """

    planes: npt.NDArray[np.float64]
    bounds: npt.NDArray[np.float64]
    mask_index: npt.NDArray[np.int64]
    texture_index: npt.NDArray[np.int64]
    frames: npt.NDArray[np.float64]
    tints: npt.NDArray[np.float32]
    textures: npt.NDArray[np.float32]
    masks: npt.NDArray[np.float32]
    mask_scale: float


class Frame(NamedTuple):
    """A lattice on a sensor as the kernels want it (pixels, radians; scene origin in lens pitches)."""

    cos: float
    sin: float
    dh: float
    dv: float
    cx: float
    cy: float
    hexagonal: bool
    origin_x: float
    origin_y: float


class Profile(NamedTuple):
    """Light under one lens: see `lfflow.simulate.optics.Optics`; lengths in sensor pixels, field in lens pitches."""

    radius: float
    softness: float
    droop: float
    cat_eye: float
    cat_eye_radius: float
    falloff: float
    half_diagonal: float


@numba.njit(nogil=True, cache=True)
def _lens_under(x: float, y: float, frame: Any) -> tuple[float, float, float, float]:
    """Lens whose Voronoi cell holds the sensor point: its centre (X, Y) and the point's offset (a, b) from it."""
    px, py = x - frame.cx, y - frame.cy
    gx = (frame.cos * px + frame.sin * py) / frame.dh
    gy = (-frame.sin * px + frame.cos * py) / frame.dv
    if frame.hexagonal:
        height = 0.8660254037844386
        low = math.floor(gy / height)
        odd = 0.5 * (low % 2)
        lx, ly = math.floor(gx - odd + 0.5) + odd, height * low
        other = 0.5 - odd
        mx, my = math.floor(gx - other + 0.5) + other, height * (low + 1)
        if (gx - mx) ** 2 + (gy - my) ** 2 < (gx - lx) ** 2 + (gy - ly) ** 2:
            lx, ly = mx, my
    else:
        lx, ly = math.floor(gx + 0.5), math.floor(gy + 0.5)
    return (
        lx - frame.origin_x,
        ly * frame.dv / frame.dh - frame.origin_y,
        (gx - lx) * frame.dh,
        (gy - ly) * frame.dv,
    )


@numba.njit(nogil=True, cache=True)
def _disc(radius: float, limit: float, softness: float) -> float:
    """1 inside `limit`, 0 outside, a smooth step of width 2·softness between."""
    step = 0.5 + 0.5 * (limit - radius) / softness
    step = min(max(step, 0.0), 1.0)
    return float(step * step * (3.0 - 2.0 * step))


@numba.njit(nogil=True, cache=True)
def _illumination(field_x: float, field_y: float, a: float, b: float, profile: Any) -> float:
    square = a * a + b * b
    if square > (profile.radius + profile.softness) ** 2:
        return 0.0
    light = _disc(math.sqrt(square), profile.radius, profile.softness)
    light *= 1.0 - profile.droop * square / profile.radius**2
    fx, fy = field_x / profile.half_diagonal, field_y / profile.half_diagonal
    if profile.cat_eye > 0.0:
        ex, ey = a + profile.cat_eye * fx, b + profile.cat_eye * fy
        light *= _disc(math.sqrt(ex * ex + ey * ey), profile.cat_eye_radius, profile.softness)
    return float(light * (1.0 - profile.falloff * (fx * fx + fy * fy)))


@numba.njit(nogil=True, cache=True)
def _opaque(masks: npt.NDArray[np.float32], mask: int, x: float, y: float) -> bool:
    """Sign of a mask, bilinear, at the texel position (x, y); beyond the edge the edge's value holds."""
    size = masks.shape[1]
    x, y = min(max(x, 0.0), size - 1.001), min(max(y, 0.0), size - 1.001)
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    top = masks[mask, j, i] * (1.0 - fx) + masks[mask, j, i + 1] * fx
    bottom = masks[mask, j + 1, i] * (1.0 - fx) + masks[mask, j + 1, i + 1] * fx
    return bool(top * (1.0 - fy) + bottom * fy > 0.0)


@numba.njit(nogil=True, cache=True, forceinline=True)
def _first_layer(x: float, y: float, a: float, b: float, scene: Any) -> tuple[int, float, float, float]:
    """Nearest opaque layer along the ray, where (P) and at what disparity; layer −1 if there is none."""
    planes, bounds, masks = scene.planes, scene.bounds, scene.masks
    found, found_x, found_y, nearest = -1, 0.0, 0.0, -np.inf
    for layer in range(planes.shape[0]):
        gx, gy = planes[layer, 1], planes[layer, 2]
        d = planes[layer, 0]
        if gx != 0.0 or gy != 0.0:
            d = (d + gx * x + gy * y) / (1.0 - gx * a - gy * b)
        if d <= nearest:
            continue
        px, py = x + d * a, y + d * b
        if px < bounds[layer, 0] or px > bounds[layer, 1] or py < bounds[layer, 2] or py > bounds[layer, 3]:
            continue
        mask = scene.mask_index[layer]
        if mask >= 0:
            middle = masks.shape[1] // 2
            if not _opaque(masks, mask, px * scene.mask_scale + middle, py * scene.mask_scale + middle):
                continue
        found, found_x, found_y, nearest = layer, px, py, d
    return found, found_x, found_y, nearest


@numba.njit(nogil=True, cache=True)
def _weights(f: float) -> tuple[float, float, float, float]:
    """Cubic B-spline weights of the four texels about a position with fraction f."""
    g = 1.0 - f
    return (
        g * g * g / 6.0,
        (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0,
        (4.0 - 6.0 * g * g + 3.0 * g * g * g) / 6.0,
        f * f * f / 6.0,
    )


@numba.njit(nogil=True, cache=True)
def _texel(textures: npt.NDArray[np.float32], index: int, channel: int, x: float, y: float) -> float:
    """Value of a periodic cubic B-spline at the texel position (x, y)."""
    wrap = textures.shape[2] - 1
    i, j = int(math.floor(x)), int(math.floor(y))  # noqa: RUF046 - numba's floor gives a float
    wx, wy = _weights(x - i), _weights(y - j)
    i0, i1, i2, i3 = (i - 1) & wrap, i & wrap, (i + 1) & wrap, (i + 2) & wrap
    total = 0.0
    for k in range(4):
        row = (j - 1 + k) & wrap
        total += wy[k] * (
            wx[0] * textures[index, channel, row, i0]
            + wx[1] * textures[index, channel, row, i1]
            + wx[2] * textures[index, channel, row, i2]
            + wx[3] * textures[index, channel, row, i3]
        )
    return total


@numba.njit(nogil=True, cache=True, forceinline=True)
def _colour(layer: int, x: float, y: float, channel: int, scene: Any) -> float:
    """Radiance of a layer at the point (x, y) of the scene."""
    frames = scene.frames
    i = frames[layer, 0] * x - frames[layer, 1] * y + frames[layer, 2]
    j = frames[layer, 1] * x + frames[layer, 0] * y + frames[layer, 3]
    return float(_texel(scene.textures, scene.texture_index[layer], channel, i, j) * scene.tints[layer, channel])


@numba.njit(nogil=True, cache=True, forceinline=True)
def _mean_radiance(
    x: float,
    y: float,
    a: float,
    b: float,
    scene: Any,
    rays: npt.NDArray[np.float64],
    channels: tuple[int, int],
    mean: npt.NDArray[np.float64],
) -> None:
    """Mean over the rays about (x, y, a, b) of the radiance of the channels from the first to before the last.

    It goes into `mean` (3,). `rays` (n, 4): offsets (lens x, lens y in lens pitches, pixel x, pixel y in pixels). Rays
    that meet nothing are dark.
    """
    first, last = channels
    mean[:] = 0.0
    for k in range(rays.shape[0]):
        layer, px, py, _ = _first_layer(x + rays[k, 0], y + rays[k, 1], a + rays[k, 2], b + rays[k, 3], scene)
        if layer >= 0:
            for channel in range(first, last):
                mean[channel] += _colour(layer, px, py, channel, scene)
    for channel in range(first, last):
        mean[channel] /= rays.shape[0]


@numba.njit(nogil=True, cache=True)
def illuminate(out: npt.NDArray[np.float32], first_row: int, frame: Any, profile: Any) -> None:
    """Relative illumination of the sensor rows from `first_row` on, into `out` (rows, width), 1 at a lens's centre."""
    for row in range(out.shape[0]):
        for x in range(out.shape[1]):
            lens_x, lens_y, a, b = _lens_under(float(x), float(first_row + row), frame)
            out[row, x] = _illumination(lens_x, lens_y, a, b, profile)


@numba.njit(nogil=True, cache=True)
def expose(
    out: npt.NDArray[np.float32],
    first_row: int,
    frame: Any,
    scene: Any,
    rays: npt.NDArray[np.float64],
    cfa: npt.NDArray[np.int64],
) -> None:
    """Multiply the illumination in `out` (rows, width) by the scene's radiance in the colour of each pixel.

    `rays` as in `_mean_radiance`. `cfa` (2, 2): channel of the top-left sensor pixels.
    """
    mean = np.zeros(3)
    for row in range(out.shape[0]):
        y = first_row + row
        for x in range(out.shape[1]):
            if out[row, x] < 1e-4:
                continue
            lens_x, lens_y, a, b = _lens_under(float(x), float(y), frame)
            channel = cfa[y & 1, x & 1]
            _mean_radiance(lens_x, lens_y, a, b, scene, rays, (channel, channel + 1), mean)
            out[row, x] *= mean[channel]


@numba.njit(nogil=True, cache=True)
def view_disparity(
    out: npt.NDArray[np.float32], x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], a: float, b: float, scene: Any
) -> None:
    """Disparity of the points seen at the lens positions (x, y) under the angle (a, b), into `out` (same shape)."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            layer, _, _, d = _first_layer(x[i, j], y[i, j], a, b, scene)
            out[i, j] = d if layer >= 0 else np.nan


@numba.njit(nogil=True, cache=True)
def view_radiance(
    out: npt.NDArray[np.float32],
    x: npt.NDArray[np.float64],
    y: npt.NDArray[np.float64],
    a: float,
    b: float,
    scene: Any,
    rays: npt.NDArray[np.float64],
) -> None:
    """Radiance (R, G, B) seen at the lens positions (x, y) under the angle (a, b), into `out` (rows, columns, 3)."""
    mean = np.zeros(3)
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            _mean_radiance(x[i, j], y[i, j], a, b, scene, rays, (0, 3), mean)
            out[i, j, :] = mean
