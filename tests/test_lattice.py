"""The lattice against its definition and against brute force."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfflow.cameras import F01, ILLUM
from lfflow.lattice import Lattice

SEED_LATTICE = Lattice(10.00861, 10.01028, 0.00143, 3.2, 4.1)


@st.composite
def lattices(draw: st.DrawFn) -> Lattice:
    def number(low: float, high: float) -> float:
        return draw(st.floats(low, high, allow_nan=False))

    pitch = number(6, 60)
    return Lattice(
        pitch,
        pitch * number(0.99, 1.01),
        number(-0.05, 0.05),
        number(-100, 100),
        number(-100, 100),
        draw(st.sampled_from(["hexagonal", "square"])),
    )


def test_matrix_is_rotation_times_scale_times_arrangement() -> None:
    lattice = Lattice(10.0, 12.0, math.pi / 2, 0.0, 0.0)
    # quarter turn: the first basis vector (10, 0) becomes (0, 10), the second (5, 12·√3/2) becomes (−12·√3/2, 5)
    np.testing.assert_allclose(lattice.matrix, [[0.0, -6 * math.sqrt(3)], [10.0, 5.0]], atol=1e-12)


def test_brick_layout_moves_odd_rows_by_half_a_pitch_and_takes_the_shear_out() -> None:
    lattice = Lattice(10.0, 10.0, 0.0, 1.0, 2.0)
    x, y = lattice.centres(np.arange(5), 0)
    np.testing.assert_allclose(x, [1.0, 6.0, 1.0, 6.0, 1.0])
    np.testing.assert_allclose(np.diff(y), 5 * math.sqrt(3))


def test_row_pitch_of_the_seed_camera() -> None:
    assert SEED_LATTICE.row_pitch * SEED_LATTICE.dh == pytest.approx(8.66917, abs=1e-4)


def test_square_array_has_no_brick_offset() -> None:
    lattice = Lattice(15.0, 15.0, 0.0, 0.0, 0.0, "square")
    np.testing.assert_allclose(lattice.centres(3, 4), [60.0, 45.0])
    assert lattice.row_pitch == 1.0


@given(lattices(), st.integers(0, 2**32 - 1))
def test_nearest_agrees_with_trying_every_lens(lattice: Lattice, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 10 * lattice.dh, (2, 40))
    t, s = lattice.nearest(x, y)
    # in the undistorted metric, where cells are regular
    ideal = replace(lattice, dh=1.0, dv=1.0, theta=0.0, cx=0.0, cy=0.0)
    cos, sin = math.cos(lattice.theta), math.sin(lattice.theta)
    from_origin = np.stack([x - lattice.cx, y - lattice.cy])
    local = np.linalg.solve(np.array([[cos, -sin], [sin, cos]]), from_origin) / [[lattice.dh], [lattice.dv]]
    tt, ss = np.meshgrid(np.arange(-40, 41), np.arange(-40, 41), indexing="ij")
    cx, cy = ideal.centres(tt.ravel(), ss.ravel())
    distance = (local[0][:, None] - cx) ** 2 + (local[1][:, None] - cy) ** 2
    mine_x, mine_y = ideal.centres(t, s)
    mine = (local[0] - mine_x) ** 2 + (local[1] - mine_y) ** 2
    within = (np.abs(t) < 39) & (np.abs(s) < 39)
    np.testing.assert_allclose(mine[within], distance.min(axis=1)[within], atol=1e-9)


@given(lattices(), st.integers(-20, 20), st.integers(-20, 20))
def test_anchoring_does_not_depend_on_the_numbering(lattice: Lattice, k1: int, k2: int) -> None:
    dx, dy = lattice.matrix @ np.array([k1, k2])
    renumbered = replace(lattice, cx=lattice.cx + float(dx), cy=lattice.cy + float(dy))
    a, b = lattice.anchored(900, 1000), renumbered.anchored(900, 1000)
    same_centre = a.distance_to(b, 900, 1000)
    assert same_centre == pytest.approx(0.0, abs=1e-6)


@given(lattices())
def test_the_grid_holds_the_lens_of_every_pixel(lattice: Lattice) -> None:
    height, width = 97, 130
    placed = lattice.anchored(height, width)
    rows, columns = placed.grid_shape(height, width)
    t, s = placed.nearest(*np.meshgrid(np.arange(width), np.arange(height)))
    assert t.min() >= 0
    assert s.min() >= 0
    assert t.max() < rows
    assert s.max() < columns


@pytest.mark.parametrize("camera", [F01, ILLUM])
@pytest.mark.parametrize("theta", [-0.009, 0.0, 0.0049])
def test_grid_of_a_camera_covers_its_sensor(camera: object, theta: float) -> None:
    assert camera in (F01, ILLUM)
    model = F01 if camera is F01 else ILLUM
    height, width = model.height, model.width
    rows, columns = model.grid_shape
    lattice = Lattice(model.pitch + 0.01, model.pitch + 0.02, theta, 5.0, -3.0).anchored(height, width, (rows, columns))
    x, y = np.meshgrid(np.linspace(0, width - 1, 200), np.linspace(0, height - 1, 200))
    t, s = lattice.nearest(x, y)
    assert t.min() >= 0
    assert s.min() >= 0
    assert t.max() < rows
    assert s.max() < columns


def test_camera_grids_have_the_size_that_stores_rely_on() -> None:
    assert F01.grid_shape == (389, 337)
    assert F01.view_radius == 5
    assert ILLUM.view_radius == 7


def test_distance_counts_pitch_errors_over_the_sensor_and_ignores_whole_lenses() -> None:
    shifted = replace(SEED_LATTICE, cx=SEED_LATTICE.cx + SEED_LATTICE.dh * math.cos(SEED_LATTICE.theta),
                      cy=SEED_LATTICE.cy + SEED_LATTICE.dh * math.sin(SEED_LATTICE.theta))  # fmt: skip
    assert SEED_LATTICE.distance_to(shifted, 3280, 3280) == pytest.approx(0.0, abs=1e-9)
    moved = replace(SEED_LATTICE, cx=SEED_LATTICE.cx + 0.3, cy=SEED_LATTICE.cy + 0.4)
    assert SEED_LATTICE.distance_to(moved, 3280, 3280) == pytest.approx(0.5, abs=1e-9)
