"""The two calibration studies run as a whole, small, with known truth."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from lfflow.lattice import Lattice
from lfflow.run import Options, run_collection
from lfflow.schema import lattice_of
from lfflow.simulate import open_truth, simulate_collection
from lfflow.stages.calibrate import calibrate
from pipelines import lattice_systematics, rotation_study, shape_functions
from pipelines.lattice_prediction import predict

SIZE = 300
GAP, PIXEL, LENS, OFFSET = 25e-6, 1.4e-6, 14e-6, (-2.7e-6, 5.7e-7)
TRUE_THETA, TOLD_THETA = 0.0015, 0.00143


def white(zoom: int, focus: int, pupil: float, told_pupil: float | None = None) -> tuple[xr.Dataset, xr.Dataset]:
    """White image through an exit pupil, drawn from the formula alone, and its calibration."""
    magnification = 1 + GAP / pupil
    pitch, middle = LENS / PIXEL * magnification, (SIZE - 1) / 2
    place = (middle + OFFSET[0] / PIXEL * magnification, middle + OFFSET[1] / PIXEL * magnification)
    lattice = Lattice(pitch, pitch * 1.0005, TRUE_THETA, *place)
    y, x = np.mgrid[:SIZE, :SIZE].astype(float)
    centre_x, centre_y = lattice.centres(*lattice.nearest(x, y))
    light = 2500 / (1 + np.exp((np.hypot(x - centre_x, y - centre_y) - 4.4) / 0.5))
    noisy = np.random.default_rng([zoom, focus]).normal(light + 168, np.sqrt(light + 25))
    scalars = {"zoom_step": zoom, "focus_step": focus, "exit_pupil_offset": told_pupil or pupil, "mla_offset_z": GAP}
    scalars |= {"lens_pitch": LENS, "pixel_pitch": PIXEL, "mla_scale_x": 1.0, "mla_scale_y": 1.0005}
    scalars |= {"mla_rotation": TOLD_THETA, "mla_offset_x": OFFSET[0], "mla_offset_y": OFFSET[1]}
    levels = {"black_level": ("site", np.full(4, 168.0)), "white_level": ("site", np.full(4, 4095.0))}
    raw = xr.Dataset(
        {"raw": (("y", "x"), noisy.clip(0).round().astype(np.uint16))},
        coords={**{k: float(v) for k, v in scalars.items()}, **levels}
        | {"kind": "white", "cfa_pattern": "BGGR", "capture": f"W{zoom}_{focus}", "site": ["r", "gr", "gb", "b"]},
    )
    return raw, calibrate(raw)


@pytest.fixture(scope="module")
def zoomed() -> pd.DataFrame:
    pupils = {100: 0.02, 500: 0.03, 900: 0.05}
    settings = [(zoom, focus) for zoom in pupils for focus in (400, 800)]
    return rotation_study.study(white(zoom, focus, pupils[zoom] + 2e-6 * focus) for zoom, focus in settings)


def test_rotation_study_separates_magnification_from_rotation(zoomed: pd.DataFrame) -> None:
    for name in ("dh", "dv"):
        assert np.abs(zoomed[f"{name}_difference"]).max() < 2e-4
    assert np.abs(zoomed[["cx_difference", "cy_difference"]].to_numpy()).max() < 0.02
    assert zoomed["theta"].to_numpy() == pytest.approx(TRUE_THETA, abs=2e-5)
    lines = {line.split(":")[0]: line for line in lattice_systematics.statements(zoomed)}
    mean = re.search(r"mean (\S+) rad", lines["theta"])
    assert mean is not None
    assert float(mean[1]) == pytest.approx(TRUE_THETA - TOLD_THETA, abs=5e-6)
    assert "systematic" in lines["theta"]
    for name in ("dh", "dv", "dv/dh"):
        assert "agrees" in lines[name]


def test_the_pitches_tell_the_gap_and_the_bare_pitch(zoomed: pd.DataFrame) -> None:
    line = next(line for line in lattice_systematics.statements(zoomed) if line.startswith("dh against 1/Z"))
    numbers = [float(number) for number in re.findall(r"[0-9]+\.[0-9]+", line)]
    assert numbers[0] == pytest.approx(LENS / PIXEL, abs=1e-3)
    assert numbers[2] == pytest.approx(GAP * 1e6, rel=0.1)
    assert zoomed["implied_pupil"].to_numpy() == pytest.approx(zoomed["exit_pupil_offset"].to_numpy(), rel=0.1)


def test_a_pupil_that_is_told_wrongly_shows_as_a_trend_with_zoom() -> None:
    true = {100: 0.015, 300: 0.018, 500: 0.023, 700: 0.032, 900: 0.05}
    table = rotation_study.study(white(zoom, 500, pupil, told_pupil=0.025) for zoom, pupil in true.items())
    text = "\n".join(lattice_systematics.statements(table))
    assert re.search(r"dh: .*\n  changes by -\S+ ± \S+ per 100 steps of zoom", text)
    assert "of focus" not in text, "focus did not vary"


def test_an_unknown_pupil_predicts_no_magnification() -> None:
    raw, _ = white(100, 400, 0.02, told_pupil=10_000.0)
    told = predict(raw)
    assert told.magnification == 1
    assert np.isnan(told.pupil)
    assert told.lattice.dh == pytest.approx(LENS / PIXEL)


def test_the_signs_of_the_offset_are_found(zoomed: pd.DataFrame) -> None:
    assert "best: ++" in lattice_systematics.convention(zoomed)


def test_metadata_that_say_nothing_are_no_obstacle(zoomed: pd.DataFrame, tmp_path: Path) -> None:
    raw, cal = white(100, 400, 0.02)
    table = rotation_study.study([(raw.drop_vars(["mla_offset_x", "mla_rotation", "mla_scale_y"]), cal)])
    lines = lattice_systematics.statements(table)
    assert "theta: the metadata say nothing" in lines
    lattice_systematics.plot(table, str(tmp_path / "plot.png"))


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated")
    simulate_collection(folder, 0, 1, zooms=2, focuses=2, height=420, width=440)
    return folder


def test_a_collection_is_studied_from_its_store(simulated: Path, tmp_path: Path) -> None:
    run_collection(tmp_path / "collection", Options(inputs=(simulated,), stages=("calibration",)))
    text = rotation_study.main([str(tmp_path / "collection")], tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "lattices.csv").set_index("capture")
    assert sorted(table.index) == [f"WHITE_000{number}" for number in range(1, 5)]
    assert table[["zoom_step", "focus_step"]].drop_duplicates().shape == (4, 2)
    for name, numbers in table.iterrows():
        truth = lattice_of(open_truth(simulated, str(name)))
        assert numbers["predicted_dh"] == pytest.approx(truth.dh, abs=1e-9)
        assert numbers["dh"] == pytest.approx(truth.dh, abs=3e-4)
        assert numbers["theta"] == pytest.approx(truth.theta, abs=3e-5)
        assert abs(numbers["cx_difference"]) < 0.02
    assert "theta: mean +8." in text
    assert (tmp_path / "out" / "lattices.png").stat().st_size > 10_000


def test_a_folder_of_files_is_calibrated(simulated: Path) -> None:
    table = rotation_study.study(rotation_study.pairs([str(simulated)]))
    assert len(table) == 4
    assert set(table["method"]) == {"white"}


@pytest.fixture(scope="module")
def experiments(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("experiments")
    shape_functions.main(out, size=240)
    return out


def test_table_2_of_the_seed_is_met(experiments: Path) -> None:
    table = pd.read_csv(experiments / "table2.csv")
    assert len(table) == 15
    for shape, rows in table.groupby("shape"):
        assert np.abs(rows["here"] - rows["seed"]).max() < 0.06 * rows["seed"].max(), shape


def test_figure_19_peaks_at_no_error(experiments: Path) -> None:
    curves = pd.read_csv(experiments / "figure19.csv")
    wide = curves.pivot_table(index="error", columns=["parameter", "shape", "sigma"], values="upsilon")
    for name in (("dh", "gaussian", 2), ("theta", "cosine4", 3), ("theta", "rectangular", 4)):
        assert abs(wide[name].dropna().idxmax()) < 1e-12
    assert wide["theta", "gaussian", 2].max() > wide["dh", "gaussian", 2].max()


def test_colours_agree_after_the_fit(experiments: Path) -> None:
    table = pd.read_csv(experiments / "figure20.csv").set_index("colour")
    assert list(table.index) == ["gray", "red", "green", "blue"]
    assert (table["model_to_gray"] < 0.03).all()
    assert (
        table.loc[["red", "green", "blue"], "single_rms"] > 2 * table.loc[["red", "green", "blue"], "model_to_gray"]
    ).all()


def test_global_and_local_find_the_truth(experiments: Path) -> None:
    table = pd.read_csv(experiments / "table3.csv")
    smooth = table[table["method"].isin(["global, gaussian", "global, cosine4", "local, sub-pixel"])]
    assert len(smooth) == 6
    assert (smooth["rms"] < 0.03).all()
    worst = table.groupby("method")["rms"].max()
    assert worst["local, whole pixels"] > 3 * worst["local, sub-pixel"]


def test_every_printed_value_is_compared(experiments: Path) -> None:
    lines = (experiments / "agreement.txt").read_text().splitlines()
    assert sum("σ = " in line and ": seed" in line for line in lines) == 15
    assert sum("axis ends at" in line for line in lines) == 6
    assert sum("seed" in line and ("here" in line) for line in lines) >= 15 + 6 + 4
    for name in ("figure19.png", "figure20.png"):
        assert (experiments / name).stat().st_size > 10_000
