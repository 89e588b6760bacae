"""Views through a mosaic and back."""

from __future__ import annotations

import numpy as np
import xarray as xr

from lfflow.schema import RAW, lattice_of
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
