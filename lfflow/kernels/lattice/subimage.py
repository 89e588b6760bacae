"""Where a sensor point lies under its lens."""

from __future__ import annotations

import math

import numba

from lfflow.lattice import Lattice

Geometry = tuple[float, float, float, float, float, float, bool]


def geometry(lattice: Lattice) -> Geometry:
    """Lattice as the numba kernels want it: cos, sin, dh, dv, cx, cy, hexagonal."""
    return (
        math.cos(lattice.theta),
        math.sin(lattice.theta),
        lattice.dh,
        lattice.dv,
        lattice.cx,
        lattice.cy,
        lattice.arrangement == "hexagonal",
    )


@numba.njit(nogil=True, cache=True, inline="always")
def offset_from_lens(x: float, y: float, lens: Geometry) -> tuple[float, float]:
    """Offset of a sensor point from its nearest lens centre, along the axes of the lattice, pixels."""
    cos, sin, dh, dv, cx, cy, hexagonal = lens
    gx, gy = (cos * (x - cx) + sin * (y - cy)) / dh, (-sin * (x - cx) + cos * (y - cy)) / dv
    if not hexagonal:
        return (gx - math.floor(gx + 0.5)) * dh, (gy - math.floor(gy + 0.5)) * dv
    height = 0.8660254037844386
    low = math.floor(gy / height)
    odd = 0.5 * (low % 2)
    ax, ay = gx - odd - math.floor(gx - odd + 0.5), gy - height * low
    other = 0.5 - odd
    bx, by = gx - other - math.floor(gx - other + 0.5), ay - height
    if bx * bx + by * by < ax * ax + ay * ay:
        ax, ay = bx, by
    return ax * dh, ay * dv
