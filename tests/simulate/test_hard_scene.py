"""The hard scene is what it says: plain, with thin things, occlusions and steep planes."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from lfflow.simulate import simulate_capture

SIZE = {"height": 640, "width": 640, "noise": False, "views": (-4, 0, 4)}


@pytest.fixture(scope="module")
def truths() -> dict[str, xr.Dataset]:
    return {kind: simulate_capture(scene=kind, seed=4, **SIZE)[1] for kind in ("natural", "hard")}


def local_contrast(truth: xr.Dataset) -> np.ndarray:
    """Relative standard deviation of green in windows of 5 × 5 lenses of the central view."""
    green = truth["rgb"].sel(v=0, u=0, channel="G").isel(t=slice(2, -2), s=slice(2, -2))
    windows = green.rolling(t=5, s=5, center=True)
    return (windows.std() / windows.mean()).values[2:-2, 2:-2]


def test_much_of_it_is_plainer_than_the_noise_of_a_sample(truths: dict[str, xr.Dataset]) -> None:
    plain = {kind: float((local_contrast(truth) < 0.02).mean()) for kind, truth in truths.items()}
    assert plain["hard"] > 0.25
    assert plain["hard"] > 5 * plain["natural"]


def test_thin_things_stand_before_far_ones(truths: dict[str, xr.Dataset]) -> None:
    """In many windows of 5 × 5 lenses the foreground covers less than a third and leaps by more than 0.2."""
    d = truths["hard"]["disparity"].sel(v=0, u=0)
    windows = d.rolling(t=5, s=5, center=True).construct(t="i", s="j").values[2:-2, 2:-2].reshape(-1, 25)
    low, high = windows.min(axis=1), windows.max(axis=1)
    share = (windows > ((low + high) / 2)[:, None]).mean(axis=1)
    assert ((high - low > 0.2) & (share < 1 / 3)).mean() > 0.03


def test_disparities_fill_the_range_and_planes_are_slanted(truths: dict[str, xr.Dataset]) -> None:
    d = truths["hard"]["disparity"].sel(v=0, u=0)
    assert float(d.min()) < -0.4
    assert float(d.max()) > 0.4
    assert float(abs(d).max()) < 0.6
    step = abs(d.diff("s"))
    assert float(((step > 0.002) & (step < 0.05)).mean()) > 0.1


def test_something_is_hidden_from_the_outer_views(truths: dict[str, xr.Dataset]) -> None:
    d = truths["hard"]["disparity"]
    for v, u in ((0, 4), (4, 0), (-4, -4)):
        assert float((abs(d.sel(v=v, u=u) - d.sel(v=0, u=0)) > 0.1).mean()) > 0.02


def test_a_seed_names_a_scene() -> None:
    first, again, other = (simulate_capture(scene="hard", seed=s, **SIZE)[0]["raw"].values for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5
    with pytest.raises(KeyError, match="unheard"):
        simulate_capture(scene="unheard of", **SIZE)
