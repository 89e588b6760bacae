"""The two calibration studies run as a whole, small, with known truth."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import xarray as xr

from lfflow.lattice import Lattice

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


def test_shape_functions_make_tables_and_a_plot(tmp_path: Path) -> None:
    report = load("shape_functions").main(tmp_path, size=160)
    assert (tmp_path / "figure19.png").stat().st_size > 10_000
    assert "global" in report
    rows = [line.split() for line in report.splitlines()[1:6]]
    gaussian = {int(row[0]): float(row[1]) for row in rows}
    assert gaussian[3] > gaussian[1], "the mask must be about as wide as a subimage"
