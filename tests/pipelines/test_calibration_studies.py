"""The two calibration studies run as a whole, small, with known truth."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from lfflow.lattice import Lattice
from pipelines import shape_functions

SIZE = 300
GAP, PIXEL, LENS = 25e-6, 1.4e-6, 14e-6


def load(name: str) -> ModuleType:
    path = Path(__file__).parents[2] / "pipelines" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def white(zoom: int, pupil: float) -> xr.Dataset:
    pitch = LENS / PIXEL * (1 + GAP / pupil)
    lattice = Lattice(pitch, pitch * 1.0005, 0.0015, 2.0, 3.0)
    y, x = np.mgrid[:SIZE, :SIZE].astype(float)
    centre_x, centre_y = lattice.centres(*lattice.nearest(x, y))
    light = 2500 / (1 + np.exp((np.hypot(x - centre_x, y - centre_y) - 4.4) / 0.5))
    raw = np.random.default_rng(zoom).normal(light + 168, np.sqrt(light + 25)).clip(0).round().astype(np.uint16)
    scalars = {"zoom_step": zoom, "focus_step": 500, "exit_pupil_offset": pupil, "mla_offset_z": GAP}
    scalars |= {"lens_pitch": LENS, "pixel_pitch": PIXEL, "mla_scale_x": 1.0, "mla_scale_y": 1.0005}
    levels = {"black_level": ("site", np.full(4, 168.0)), "white_level": ("site", np.full(4, 4095.0))}
    return xr.Dataset(
        {"raw": (("y", "x"), raw)},
        coords={**{k: float(v) for k, v in scalars.items()}, **levels, "mla_rotation": 0.00143}
        | {"kind": "white", "cfa_pattern": "BGGR", "capture": f"W{zoom}", "site": ["r", "gr", "gb", "b"]},
    )


def test_rotation_study_separates_magnification_from_rotation() -> None:
    module = load("rotation_study")
    table = module.study(white(zoom, pupil) for zoom, pupil in ((100, 0.02), (500, 0.03), (900, 0.05)))
    assert np.abs(table["dh_difference"]).max() < 2e-4
    assert np.abs(table["dv_difference"]).max() < 2e-4
    assert table["theta"].to_numpy() == pytest.approx(0.0015, abs=2e-5)
    assert "theta_difference: mean +" in module.systematic(table)
    assert "systematic" in module.systematic(table).splitlines()[0]


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
