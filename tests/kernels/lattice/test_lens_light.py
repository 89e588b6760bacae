"""What a pixel under a lens sees, against integrals over its area."""

from __future__ import annotations

import numpy as np
import pytest

from lfflow.kernels.lattice.aperture import Aperture
from lfflow.kernels.lattice.centres import lens_centres
from lfflow.kernels.lattice.lens_light import beyond, border, cell_of
from lfflow.kernels.lattice.radial import Radial
from lfflow.lattice import Lattice

FINE = (np.arange(400) + 0.5) / 400 - 0.5


@pytest.mark.parametrize("arrangement", ["hexagonal", "square"])
def test_light_from_beyond_the_border_is_that_of_the_mirrored_lens(arrangement) -> None:
    lattice = Lattice(9.93, 9.93, 0.02, 0, 0, arrangement)
    cell, growth = cell_of(lattice), np.array([0.02, -0.05])
    for angle in np.radians([3.0, 25.0, 47.0, 88.0, 200.0]):
        for radius in (4.2, 4.5, 4.8):
            dx, dy = radius * np.cos(angle), radius * np.sin(angle)
            distance, nx, ny = border(dx, dy, cell)
            if distance < 0:
                continue
            normal = np.array([np.cos(0.02) * nx - np.sin(0.02) * ny, np.sin(0.02) * nx + np.cos(0.02) * ny])
            light, slope = 0.3, np.array([-0.2, -0.11])
            a, b = np.meshgrid(FINE, FINE)
            over = normal[0] * a + normal[1] * b - distance
            own = light + slope[0] * a + slope[1] * b
            mirrored = own - 2 * over * (normal @ slope)
            seen = np.where(over > 0, mirrored * (1 + normal @ growth), own).mean()
            added, share = beyond(distance, tuple(normal), light, tuple(slope), tuple(growth))
            assert light + added == pytest.approx(seen, abs=2e-3 * abs(normal @ growth) + 2e-5)
            assert share == pytest.approx((over > 0).mean(), abs=5e-3)


def test_two_discs_in_exchanged_roles_are_the_same_light() -> None:
    def edge(middle: float, width: float):
        return lambda r: 0.5 * (1 - np.tanh((r - middle) / width))

    f = Radial.like(lambda r: (1 - 0.01 * r**2) * edge(4.3, 0.5)(r), 0, 5.8, 0.15)
    h = Radial.like(edge(4.7, 0.5), 2.5, 6.6, 0.15)
    middle = np.array([500.0, 400.0])
    first = Aperture(
        f, None, h, np.eye(2) * 2e-3, np.array([0.05, 0.02]), middle, sharp=True, hidden=0.0, width=0.5, droop=-0.01
    )
    second = first.exchanged()
    assert first.order == pytest.approx(0.4, abs=0.01)
    assert second.order == pytest.approx(-0.4, abs=0.01)
    offset = first.offsets(np.array([[900.0, 700.0]]))[0]

    def light(aperture: Aperture, x: np.ndarray, y: np.ndarray, other: np.ndarray) -> np.ndarray:
        radius, far = np.hypot(x, y), np.hypot(x - other[0], y - other[1])
        values = [table[:, 0] for table in (aperture.f.table(), aperture.h.table())]
        f, h = (
            np.interp(at * 64, np.arange(len(value)), value) for at, value in zip((radius, far), values, strict=True)
        )
        return f / (1 - 0.01 * radius**2) * h

    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-4, 4, 30), np.linspace(-4, 4, 30)))
    np.testing.assert_allclose(
        light(second, x - offset[0], y - offset[1], -offset), light(first, x, y, offset), rtol=0, atol=4e-3
    )


def test_a_part_of_the_lenses_is_the_same_one_after_a_small_move() -> None:
    shape, lattice = (600, 640), Lattice(9.93, 9.94, -0.0047, 3.3, 4.4)
    some = lens_centres(lattice, *shape, margin=0.0, every=7)
    assert len(some) == pytest.approx(len(lens_centres(lattice, *shape, margin=0.0)) / 7, rel=0.02)
    for shift in (0.02, 0.4, 4.0):
        moved = Lattice(9.93, 9.94, -0.0047, 3.3 + shift, 4.4)
        others = lens_centres(moved, *shape, margin=0.0, every=7)
        inside = some[(some[:, 0] > 5) & (some[:, 0] < shape[1] - 6)]
        nearest = np.hypot(*(inside[:, None] + (shift, 0) - others).transpose(2, 0, 1)).min(axis=1)
        assert nearest.max() < 1e-6
