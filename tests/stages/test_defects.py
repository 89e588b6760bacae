"""Injected hot and dead pixels are found, and little else: on a white image, in one picture, in many, in the dark."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

from lfflow.errors import LfflowError
from lfflow.simulate import simulate_capture, simulate_white
from lfflow.simulate.body import BODIES
from lfflow.stages.calibrate import calibrate
from lfflow.stages.defects import aberrant, dark_defects, defect_counts, defect_map, saturated_pixels, with_defects
from lfflow.stages.demultiplex import demultiplex

mpl.use("Agg")
SIZE = {"height": 420, "width": 420}
CAPTURES = 8
LIT = 0.1
"""Vignetting from which on samples are used: what happens in the dark between the subimages does no harm."""


def body(camera: str = "f01", dead: float = 2e-3) -> object:
    one = BODIES[camera]
    return replace(one, sensor=replace(one.sensor, hot_share=8e-4, dead_share=dead))


@pytest.fixture(scope="module")
def white() -> tuple[xr.Dataset, xr.Dataset]:
    return simulate_white(camera=body(), **SIZE)


@pytest.fixture(scope="module")
def captures(white: tuple[xr.Dataset, xr.Dataset]) -> list[tuple[xr.Dataset, xr.Dataset]]:
    cal = white[1][["dh", "dv", "theta", "cx", "cy", "arrangement", "vignetting"]].drop_vars("capture").reset_coords()
    cal = cal.assign(pixel_flags=xr.zeros_like(white[0]["raw"].reset_coords(drop=True), dtype=np.uint8))
    names = [f"IMG_{number}" for number in range(CAPTURES)]
    return [(simulate_capture(views=[0], seed=5, capture=name, camera=body(), **SIZE)[0], cal) for name in names]


@pytest.fixture(scope="module")
def pipeline() -> ModuleType:
    path = Path(__file__).parents[2] / "pipelines" / "dead_pixels.py"
    spec = importlib.util.spec_from_file_location("dead_pixels", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def truth_of(white: tuple[xr.Dataset, xr.Dataset]) -> tuple[np.ndarray, np.ndarray]:
    return white[1]["defects"].values, white[1]["vignetting"].values >= LIT


@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_a_white_image_shows_every_defect_that_has_light(camera: str) -> None:
    raw, truth = simulate_white(camera=body(camera, dead=6e-4), height=640, width=640)
    flags = calibrate(raw, precise=False)["pixel_flags"].values
    defects, lit = truth_of((raw, truth))
    assert (flags & 1 > 0)[defects == 1].mean() >= 0.99
    assert (flags & 2 > 0)[(defects == 2) & lit].mean() >= 0.98
    assert (flags > 0)[(defects > 0) & lit].mean() >= 0.99
    assert (flags > 0)[defects == 0].mean() <= 1e-5


def test_many_captures_tell_defects_from_highlights(
    captures: list[tuple[xr.Dataset, xr.Dataset]], white: tuple[xr.Dataset, xr.Dataset], pipeline: ModuleType,
    tmp_path: Path,
) -> None:  # fmt: skip
    defects, lit = truth_of(white)
    found = pipeline.count_defects(captures)
    flags = found["pixel_flags"].values
    assert (flags == 1)[defects == 1].mean() >= 0.99
    assert (flags == 2)[(defects == 2) & lit].mean() >= 0.99
    assert (flags > 0)[defects == 0].mean() <= 1e-5
    assert found["hot"].values.max() == CAPTURES
    pipeline.plot_defects(found, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 5000
    with pytest.raises(LfflowError, match="no pictures"):
        pipeline.count_defects([])


def test_one_picture_finds_hot_pixels_and_the_dead_ones_that_have_light(
    captures: list[tuple[xr.Dataset, xr.Dataset]], white: tuple[xr.Dataset, xr.Dataset]
) -> None:
    defects, lit = truth_of(white)
    found = aberrant(*captures[0])
    flags, tested = found["pixel_flags"].values, found["tested"].values
    assert (flags == 1)[defects == 1].mean() >= 0.99
    assert (flags == 2)[(defects == 2) & tested].mean() >= 0.99
    assert tested[lit].mean() > 0.9
    assert (flags > 0)[defects == 0].sum() <= 2


def test_a_pixel_is_dead_when_it_is_dark_wherever_that_would_show() -> None:
    flags = xr.DataArray(np.array([[1, 1, 0, 1], [2, 0, 0, 0], [2, 2, 0, 0]]).T[:, None], dims=("capture", "y", "x"))
    tested = xr.DataArray(np.array([[1, 1, 1, 1], [1, 0, 1, 1], [1, 1, 0, 0]], bool).T[:, None], dims=flags.dims)
    found = xr.Dataset({"pixel_flags": flags.astype(np.uint8), "tested": tested})
    np.testing.assert_array_equal(defect_map(defect_counts(found)), [[1, 0, 2]])
    halves = [defect_counts(found.isel(capture=part)) for part in (slice(0, 1), slice(1, 4))]
    np.testing.assert_array_equal(defect_map((halves[0] + halves[1]).assign_attrs(captures=4)), [[1, 0, 2]])
    with pytest.raises(LfflowError, match="capture"):
        defect_counts(found.isel(capture=0))


def test_lazy_and_eager_agree(captures: list[tuple[xr.Dataset, xr.Dataset]], no_compute: None) -> None:
    raw, cal = captures[0]
    lazy = aberrant(raw.chunk(y=100), cal)
    assert lazy["pixel_flags"].chunks
    xr.testing.assert_equal(lazy.compute(scheduler="synchronous"), aberrant(raw, cal))


def dark_frames(size: int = 300) -> tuple[xr.Dataset, np.ndarray]:
    rng = np.random.default_rng(0)
    counts = np.rint(168 + 4 * rng.standard_normal((2, size, size)))
    hot = rng.random((size, size)) < 1e-3
    counts[:, hot] += rng.uniform(300, 3000, hot.sum())
    levels = {"black_level": ("site", [168.0] * 4), "white_level": ("site", [4095.0] * 4)}
    coords = {"site": ["r", "gr", "gb", "b"], "cfa_pattern": "BGGR", "capture": ["D0", "D1"], **levels}
    return xr.Dataset({"raw": (("capture", "y", "x"), counts.astype(np.uint16))}, coords), hot


def test_dark_frames_show_hot_pixels_exactly() -> None:
    dark, hot = dark_frames()
    flags = dark_defects(dark)
    np.testing.assert_array_equal(flags, np.broadcast_to(hot, (2, *hot.shape)))
    np.testing.assert_array_equal(defect_map(defect_counts(flags)), hot)


def test_calibration_and_light_field_leave_out_what_dark_frames_show(white: tuple[xr.Dataset, xr.Dataset]) -> None:
    dark, hot = dark_frames(SIZE["height"])
    known = defect_map(defect_counts(dark_defects(dark)))
    raw = white[0]
    plain, warned = calibrate(raw, precise=False), calibrate(raw, precise=False, defects=known)
    np.testing.assert_array_equal(warned["pixel_flags"], plain["pixel_flags"].values | hot)
    assert warned["pixel_flags"].attrs["flag_meanings"] == plain["pixel_flags"].attrs["flag_meanings"]
    xr.testing.assert_identical(demultiplex(raw, warned), demultiplex(raw, plain, defects=known))
    with pytest.raises(LfflowError, match="another sensor"):
        with_defects(plain, known.isel(y=slice(0, 9)))


def test_flagged_pixels_are_no_samples(captures: list[tuple[xr.Dataset, xr.Dataset]]) -> None:
    raw, cal = captures[0]
    flags = aberrant(raw, cal)["pixel_flags"].variable
    clean, lf = demultiplex(raw, cal), demultiplex(raw, cal.assign(pixel_flags=flags))
    lost = int((clean.cfa != 255).sum() - (lf.cfa != 255).sum())
    assert lost == int(((flags > 0) & (cal["vignetting"] >= LIT)).sum()) > 0


def test_saturated_pixels_are_those_at_the_white_level(captures: list[tuple[xr.Dataset, xr.Dataset]]) -> None:
    raw, _ = captures[0]
    np.testing.assert_array_equal(saturated_pixels(raw).values == 4, raw.raw.values >= 4095)
