"""Light fields with closed forms: textured layers parallel to the sensor, seen through an F01-like mosaic."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.lattice import Lattice
from lfflow.schema import DISPARITY, LIGHTFIELD, lattice_variables

BAYER = np.array([[2, 1], [1, 0]], dtype=np.uint8)
Array = npt.NDArray[np.float64]


def texture(x: Array, y: Array, seed: int = 0, finest: float = 2.6) -> Array:
    """Sum of cosines with periods of `finest` lenses and more; last axis R, G, B with correlated detail."""
    rng = np.random.default_rng(seed)
    out = np.zeros((*np.broadcast_shapes(x.shape, y.shape), 3))
    tint = np.array([1.0, 0.8, 0.6])
    for _ in range(12):
        period, angle, phase = finest * 2 ** rng.uniform(0, 3), rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
        wave = np.cos(2 * np.pi * (np.cos(angle) * x + np.sin(angle) * y) / period + phase)
        out += wave[..., None] * tint * rng.uniform(0.7, 1.3, 3)
    return 0.4 + 0.04 * out


def scene(x: Array, y: Array, u: Array, v: Array, layers: list[tuple[float, float]]) -> tuple[Array, Array]:
    """Radiance and disparity of the light that reaches lens position (x, y) from aperture position (u, v).

    Each layer is (disparity, left edge in view (0, 0)); it covers everything to the right of its edge.
    """
    x, y, u, v = np.broadcast_arrays(x, y, u, v)
    rgb, disparity = np.full((*x.shape, 3), np.nan), np.full(x.shape, np.nan)
    for index, (d, edge) in enumerate(sorted(layers)):
        at_x, at_y = x + d * u, y + d * v
        seen = at_x >= edge
        rgb[seen] = texture(at_x, at_y, seed=index)[seen]
        disparity[seen] = d
    return rgb, disparity


def lens_places(lattice: Lattice, shape: tuple[int, int]) -> tuple[Array, Array]:
    t, s = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    return s + lattice.row_offset(t), t * lattice.row_pitch


def make_field(
    layers: list[tuple[float, float]], shape: tuple[int, int] = (48, 44), radius: int = 4, *, noise: float = 0.0
) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """Mosaicked field, true disparity of every view, and true views at (u, v) without the lenses' residuals."""
    lattice = Lattice(10.00861, 10.01028, 0.00143, 41.3, 37.8)
    t, s = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    cx, cy = lattice.centres(t, s)
    x, y = lens_places(lattice, shape)
    axis = np.arange(-radius, radius + 1)
    v, u = axis[:, None, None, None], axis[None, :, None, None]
    row, column = np.rint(cy).astype(int), np.rint(cx).astype(int)
    seen, _ = scene(x, y, u + (column - cx), v + (row - cy), layers)
    truth, disparity = scene(x, y, u, v, layers)
    cfa = BAYER[(row + v) % 2, (column + u) % 2]
    mosaic = np.take_along_axis(seen, cfa[..., None].astype(int), -1)[..., 0]
    outside = np.broadcast_to((u * u + v * v) > (radius + 0.5) ** 2, cfa.shape)
    if noise:
        mosaic = mosaic + np.random.default_rng(1).normal(0, noise, mosaic.shape)
    coords = {"v": axis, "u": axis, "t": np.arange(shape[0]), "s": np.arange(shape[1]), **lattice_variables(lattice)}
    dims = ("v", "u", "t", "s")
    lf = xr.Dataset(
        {
            "mosaic": (dims, np.where(outside, np.nan, mosaic).astype(np.float32)),
            "cfa": (dims, np.where(outside, 255, cfa).astype(np.uint8)),
            "weight": (dims, np.where(outside, 0, 1).astype(np.float32)),
        },
        coords,
    )
    disp = xr.Dataset(
        {
            "disparity": (dims, disparity.astype(np.float32)),
            "disparity_std": (dims, np.full(disparity.shape, 0.01, np.float32)),
            "flags": (dims, np.zeros(disparity.shape, np.uint8)),
        },
        coords,
    )
    views = xr.Dataset({"rgb": ((*dims, "channel"), truth.astype(np.float32))}, {**coords, "channel": list("RGB")})
    return LIGHTFIELD.annotate(lf), DISPARITY.annotate(disp), views
