"""`lfflow simulate` from the command line to files that the reader takes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from lfflow.cli import app
from lfflow.schema import RAW, lattice_of
from lfflow.simulate import open_truth, simulate_capture, simulate_collection

SIZE = {"height": 200, "width": 240}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulated")
    simulate_collection(out, 2, 7, zooms=2, **SIZE)
    return out


def test_files_and_truth_are_there(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names == {"WHITE_0001.lfp", "WHITE_0002.lfp", "IMG_0001.lfp", "IMG_0002.lfp", "truth.zarr"}
    truth = open_truth(folder, "IMG_0001")
    assert set(truth["disparity"].dims) == {"v", "u", "t", "s"}
    assert open_truth(folder, "IMG_0001/views")["rgb"].sizes["channel"] == 3


def test_the_container_gives_back_the_samples_and_their_metadata(folder: Path) -> None:
    for name, kind in (("IMG_0001", "scene"), ("WHITE_0001", "white")):
        raw = xr.open_dataset(folder / f"{name}.lfp", engine="lfp")
        RAW.check(raw)
        assert raw["kind"].item() == kind
        assert raw["camera_serial"].item() == "A303134643"
    first = xr.open_dataset(folder / "IMG_0001.lfp", engine="lfp")
    memory, truth = simulate_capture(seed=7, views=(0,), setting=_setting(first), **SIZE)
    np.testing.assert_array_equal(first["raw"], memory["raw"])
    assert lattice_of(open_truth(folder, "IMG_0001")) == lattice_of(truth)
    for name in ("iso", "focal_length", "exit_pupil_offset", "mla_rotation", "time", "gamma", "cfa_pattern"):
        assert first[name].item() == memory[name].item()


def _setting(raw: xr.Dataset) -> object:
    from lfflow.simulate.body import Setting

    return Setting(*(float(raw[name]) for name in ("zoom_step", "focus_step", "iso", "exposure_time")))


def test_the_pitch_follows_the_exit_pupil(folder: Path) -> None:
    """Pitch = lens pitch / pixel pitch · (1 + f/Z), with every number from the file (METHOD 6.2.3)."""
    pitches = []
    for name in ("IMG_0001", "IMG_0002"):
        raw = xr.open_dataset(folder / f"{name}.lfp", engine="lfp")
        magnification = 1 + float(raw["mla_offset_z"]) / float(raw["exit_pupil_offset"])
        expected = float(raw["lens_pitch"]) / float(raw["pixel_pitch"]) * magnification
        pitches.append(float(open_truth(folder, name)["dh"]))
        assert pitches[-1] == pytest.approx(expected, abs=1e-9)
    assert abs(pitches[0] - pitches[1]) > 1e-3


def test_same_seed_same_bytes(folder: Path, tmp_path: Path) -> None:
    simulate_collection(tmp_path, 1, 7, zooms=2, **SIZE)
    assert (tmp_path / "IMG_0001.lfp").read_bytes() == (folder / "IMG_0001.lfp").read_bytes()


def test_the_command_prints_json_and_refuses_nonsense(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from lfflow.simulate import collection

    def small(out: Path, captures: int, seed: int, camera: str, **options: Any) -> list[Path]:
        return simulate_collection(out, captures, seed, camera, **options, **SIZE)

    monkeypatch.setattr(collection, "simulate_collection", small)
    assert app(["simulate", str(tmp_path), "--captures", "0", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["files"] == [str(tmp_path / "WHITE_0001.lfp")]
    assert app(["simulate", str(tmp_path), "--captures", "-1"]) == 1
