"""Injected hot and dead pixels are found, and little else, in simulated captures of a natural scene."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import xarray as xr

from lfflow.simulate import simulate_capture
from lfflow.simulate.body import BODIES
from lfflow.stages.defects import aberrant, dark_defects, saturated_pixels
from lfflow.stages.demultiplex import demultiplex

SIZE = 420


@pytest.fixture(scope="module")
def captures() -> list[tuple[xr.Dataset, xr.Dataset]]:
    body = BODIES["f01"]
    body = replace(body, sensor=replace(body.sensor, hot_share=8e-4, dead_share=2e-4))
    return [
        simulate_capture(height=SIZE, width=SIZE, views=[0], seed=5, capture=f"IMG_{k}", camera=body) for k in range(5)
    ]


@pytest.fixture(scope="module")
def pipeline() -> ModuleType:
    path = Path(__file__).parents[2] / "pipelines" / "dead_pixels.py"
    spec = importlib.util.spec_from_file_location("dead_pixels", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_many_captures_tell_defects_from_highlights(
    captures: list[tuple[xr.Dataset, xr.Dataset]], pipeline: ModuleType, tmp_path: Path
) -> None:
    defects = captures[0][1].defects.values
    found = pipeline.count_defects(captures)
    hot = defects == 1
    assert (found.pixel_flags.values == 1)[hot].mean() >= 0.99
    assert (found.pixel_flags.values > 0)[defects == 0].mean() <= 1e-5
    assert found.hot.values.max() == len(captures)
    pipeline.plot_defects(found, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 5000


def test_one_picture_finds_nearly_all_hot_pixels(captures: list[tuple[xr.Dataset, xr.Dataset]]) -> None:
    raw, truth = captures[0]
    hot = truth.defects.values == 1
    flags = aberrant(raw, truth).values
    assert (flags == 1)[hot].mean() >= 0.97
    assert (flags > 0)[truth.defects.values == 0].sum() <= 3


def test_lazy_and_eager_agree(captures: list[tuple[xr.Dataset, xr.Dataset]], no_compute: None) -> None:
    raw, truth = captures[0]
    lazy = aberrant(raw.chunk(y=100), truth)
    assert lazy.chunks
    np.testing.assert_array_equal(lazy.compute(scheduler="synchronous"), aberrant(raw, truth))


def test_dark_frames_show_hot_pixels_exactly() -> None:
    rng = np.random.default_rng(0)
    counts = np.rint(168 + 4 * rng.standard_normal((2, 300, 300)))
    hot = rng.random((300, 300)) < 1e-3
    counts[:, hot] += rng.uniform(300, 3000, hot.sum())
    levels = {"black_level": ("site", [168.0] * 4), "white_level": ("site", [4095.0] * 4)}
    dark = xr.Dataset(
        {"raw": (("capture", "y", "x"), counts.astype(np.uint16))},
        coords={"site": ["r", "gr", "gb", "b"], "cfa_pattern": "BGGR", "capture": ["D0", "D1"], **levels},
    )
    np.testing.assert_array_equal(dark_defects(dark), np.broadcast_to(hot, (2, 300, 300)))


def test_flagged_pixels_are_no_samples(captures: list[tuple[xr.Dataset, xr.Dataset]]) -> None:
    raw, truth = captures[0]
    cal = truth[["dh", "dv", "theta", "cx", "cy", "arrangement", "defects"]].drop_vars("capture").reset_coords()
    cal = cal.rename(defects="pixel_flags").assign(vignetting=xr.ones_like(raw.raw, dtype=np.float32))
    clean = demultiplex(raw, cal.assign(pixel_flags=xr.zeros_like(cal.pixel_flags)))
    lf = demultiplex(raw, cal)
    lost = int((clean.cfa != 255).sum() - (lf.cfa != 255).sum())
    assert 0 < lost <= int((cal.pixel_flags > 0).sum())


def test_saturated_pixels_are_those_at_the_white_level(captures: list[tuple[xr.Dataset, xr.Dataset]]) -> None:
    raw, _ = captures[0]
    np.testing.assert_array_equal(saturated_pixels(raw).values == 4, raw.raw.values >= 4095)
