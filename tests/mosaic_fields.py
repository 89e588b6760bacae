"""A mosaicked light field made from a formula: an independent path to the truth, without lfflow.simulate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from lfflow.lattice import Lattice
from lfflow.schema import lattice_variables

F01 = Lattice(dh=10.00861, dv=10.01028, theta=0.00143, cx=7.3, cy=6.1)
BGGR = np.array([[2, 1], [1, 0]], dtype=np.uint8)


def waves(seed: int, *, sharpest: float = 0.3, count: int = 40) -> Callable[..., np.ndarray]:
    """Picture rgb(X, Y) that is a sum of waves of at most `sharpest` cycles per lens pitch."""
    rng = np.random.default_rng(seed)
    radius = sharpest * np.sqrt(rng.uniform(0.02, 1, count))
    angle = rng.uniform(0, 2 * np.pi, count)
    phase = rng.uniform(0, 2 * np.pi, (count, 3))
    fx, fy = radius * np.cos(angle), radius * np.sin(angle)

    def picture(X: np.ndarray, Y: np.ndarray, colour: np.ndarray) -> np.ndarray:
        out = np.full(X.shape, 0.5)
        for k in range(count):
            p = phase[k, np.minimum(colour, 2)] * 0.2 + phase[k, 0]
            out += 0.05 * np.sin(2 * np.pi * (fx[k] * X + fy[k] * Y) + p)
        return out

    return picture


def lightfield(
    scene: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    *,
    shape: tuple[int, int] = (48, 60),
    radius: int = 4,
    lattice: Lattice = F01,
    noise: float = 0.0,
    seed: int = 0,
    with_rho: bool = True,
) -> xr.Dataset:
    """Light field whose sample of colour c at lens X and aperture point (a, b) is scene(X, Y, a, b, c)."""
    views = np.arange(-radius, radius + 1)
    t, s = np.arange(shape[0]), np.arange(shape[1])
    x, y = lattice.centres(t[:, None], s[None, :])
    px, py = np.floor(x + 0.5).astype(int), np.floor(y + 0.5).astype(int)
    v, u = views[:, None, None, None], views[None, :, None, None]
    cfa = BGGR[(py + v) % 2, (px + u) % 2]
    X = s[None, :] + lattice.row_offset(t)[:, None]
    Y = t[:, None] * lattice.row_pitch + 0 * X
    a, b = np.broadcast_arrays(u + (px - x) * with_rho, v + (py - y) * with_rho)
    value = scene(np.broadcast_to(X, cfa.shape), np.broadcast_to(Y, cfa.shape), a, b, cfa)
    value = value + noise * np.random.default_rng(seed).standard_normal(cfa.shape)
    inside = np.broadcast_to(u**2 + v**2 <= 20.25, cfa.shape)
    dims = ("v", "u", "t", "s")
    return xr.Dataset(
        {
            "mosaic": (dims, np.where(inside, value, np.nan).astype(np.float32)),
            "cfa": (dims, np.where(inside, cfa, 255).astype(np.uint8)),
            "weight": (dims, inside.astype(np.float32)),
        },
        coords={
            "v": views,
            "u": views,
            "t": t,
            "s": s,
            "channel": ["R", "G", "B"],
            "white_balance": ("channel", np.ones(3)),
            "iso": 200.0,
            **lattice_variables(lattice),
        },
    )


def plane(d: float, seed: int = 1, **options: float) -> Callable[..., np.ndarray]:
    """A fronto-parallel picture at disparity d: what is at X in view 0 is at X − d·u in view u."""
    picture = waves(seed, **options)
    return lambda X, Y, a, b, colour: picture(X + d * a, Y + d * b, colour)
