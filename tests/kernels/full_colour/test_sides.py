from __future__ import annotations

import cv2
import numpy as np
import pytest

from lfflow.kernels.full_colour.field import ViewField, view_field
from lfflow.kernels.full_colour.lines import lines_of
from lfflow.kernels.full_colour.sides import choose_sides

SIZE, NEAR, FAR = 64, np.float32(0.8), np.float32(-0.6)


@pytest.fixture(scope="module")
def square() -> tuple[ViewField, np.ndarray]:
    """Nine views each way of a textured square before a textured plane, and where the square is."""
    generator = np.random.default_rng(7)
    back, front = (cv2.GaussianBlur(generator.random((128, 128)).astype(np.float32), (0, 0), 1.2) for _ in range(2))
    offsets = np.arange(-4, 5)
    t, s = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    rgb = np.empty((9, 9, SIZE, SIZE, 3), dtype=np.float32)
    for i, v in enumerate(offsets.astype(np.float32)):
        for j, u in enumerate(offsets.astype(np.float32)):
            x, y = s + NEAR * u, t + NEAR * v
            inside = np.maximum(np.abs(x - 32), np.abs(y - 32)) < 12
            behind = cv2.remap(back, s + FAR * u + 30, t + FAR * v + 30, cv2.INTER_CUBIC)
            rgb[i, j] = np.where(inside, cv2.remap(front, x + 30, y + 30, cv2.INTER_CUBIC), behind)[..., None]
    return view_field(rgb, offsets, offsets, 1), np.maximum(np.abs(s - 32), np.abs(t - 32)) < 12


@pytest.mark.parametrize("wrong_by", [2, -2])
def test_places_beside_a_jump_move_to_the_side_that_the_views_show(square, wrong_by) -> None:
    field, inside = square
    window = np.ones((2 * abs(wrong_by) + 1,) * 2, dtype=np.uint8)
    shape = (cv2.dilate if wrong_by > 0 else cv2.erode)(inside.astype(np.uint8), window)
    start = np.where(shape > 0, NEAR, FAR).astype(np.float32)
    lines = lines_of(field, np.array([30, 30], dtype=np.float32), 1.0, 1)
    found = choose_sides(lines, field, start, 1e-5)
    assert set(np.unique(found)) == {NEAR, FAR}
    before, after = ((np.abs(map_ - np.where(inside, NEAR, FAR)) > 0.1).sum() for map_ in (start, found))
    assert after < 0.2 * before


def test_what_is_right_stays(square) -> None:
    field, inside = square
    truth = np.where(inside, NEAR, FAR).astype(np.float32)
    lines = lines_of(field, np.array([30, 30], dtype=np.float32), 1.0, 1)
    moved = choose_sides(lines, field, truth, 1e-5) != truth
    assert moved.sum() < 10
