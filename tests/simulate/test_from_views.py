"""Views through a mosaic and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from lfflow.schema import RAW, lattice_of
from lfflow.simulate import simulate_white
from lfflow.simulate.from_views import simulate_from_views


def test_every_view_arrives_at_its_own_pixel_in_its_own_colour() -> None:
    rng = np.random.default_rng(0)
    colours = rng.uniform(0.1, 0.9, (3, 3, 1, 1, 3))
    rgb = np.broadcast_to(colours, (3, 3, 20, 24, 3))
    axis = [-1, 0, 1]
    views = xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), rgb)}, {"v": axis, "u": axis})
    truth_map = xr.DataArray(np.arange(20.0)[:, None] + np.zeros(24), dims=("t", "s"))
    raw, truth = simulate_from_views(views, truth_map, noise=False)
    RAW.check(raw)
    lattice = lattice_of(truth)
    t, s = np.meshgrid(np.arange(6, 14), np.arange(6, 14), indexing="ij")
    cx, cy = lattice.centres(t, s)
    pattern = np.array([[2, 1], [1, 0]])
    level = (raw["raw"].values - 168.0) / (4095 - 168)
    for v in axis:
        for u in axis:
            y, x = np.rint(cy).astype(int) + v, np.rint(cx).astype(int) + u
            expected = colours[v + 1, u + 1, 0, 0][pattern[y % 2, x % 2]]
            ratio = level[y, x] / expected
            assert (ratio > 0.6).all()
            assert (ratio <= 1.001).all()
    # rows of lenses are √3/2 of a pixel of the views apart
    steps = np.diff(truth["disparity"].values[6:14, 10])
    assert set(steps) <= {0.0, 1.0}
    assert (~np.isfinite(truth["disparity"].values)).any()


@pytest.mark.parametrize("d", [0.7, -0.4])
def test_every_sample_is_taken_at_its_exact_place_in_the_aperture(d) -> None:
    """Of a plane at disparity d, sample (u, v) of lens (X, Y) is its picture at (X, Y) + d·((u, v) + ρ)."""

    def picture(X, Y):
        return 0.5 + 0.2 * np.sin(2 * np.pi * (0.09 * X + 0.05 * Y)) + 0.2 * np.cos(2 * np.pi * (0.04 * X - 0.08 * Y))

    axis = np.arange(-2, 3)
    Y, X = np.mgrid[:40, :44]
    rgb = np.array([[picture(X + d * u, Y + d * v) for u in axis] for v in axis])[..., None] * np.ones(3)
    views = xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), rgb)}, {"v": axis, "u": axis})
    truth_map = xr.DataArray(np.full((40, 44), d), dims=("t", "s"))
    raw, truth = simulate_from_views(views, truth_map, noise=False)
    height, width = raw["raw"].shape
    lattice = lattice_of(truth)
    _, white = simulate_white(lattice, height=height, width=width, noise=False)
    first = replace(lattice, cx=lattice.dh / 2, cy=lattice.dv / 2)
    t, s = np.meshgrid(np.arange(8, 32), np.arange(8, 32), indexing="ij")
    cx, cy = first.centres(t, s)
    px, py = np.floor(cx + 0.5).astype(int), np.floor(cy + 0.5).astype(int)
    level = (raw["raw"].values - 168.0) / (4095 - 168)
    own = s + first.row_offset(t), t * first.row_pitch
    for v in axis:
        for u in axis:
            found = level[py + v, px + u] / white["vignetting"].values[py + v, px + u]
            a, b = u + px - cx, v + py - cy
            expected = picture(own[0] + d * a, own[1] + d * b)
            unmoved = picture(own[0] + d * u, own[1] + d * v)
            assert np.abs(found - expected).max() < 0.004
            assert np.abs(found - unmoved).max() > 0.03
