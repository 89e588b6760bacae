"""The chain on small simulated pictures of two cameras, with the white image of one in its calibration archive."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from lfflow.cli.status import status
from lfflow.collection import open_collection
from lfflow.formats.archives import write_storage
from lfflow.formats.raw_pair import pair_bytes
from lfflow.run import Options, run_collection
from lfflow.run.executors import Workers
from lfflow.simulate import simulate_collection

SIZES = {"f01": (300, 320), "illum": (330, 350)}


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, Path]:
    """Folder of pictures, and the collection that one run makes of both cameras."""
    folder = tmp_path_factory.mktemp("cameras")
    for camera, (height, width) in SIZES.items():
        simulate_collection(folder / "in" / camera, 1, 5, camera, height=height, width=width)
    into_archive(folder / "in/f01/WHITE_0001.lfp", folder / "in/f01/data.C.0")
    outcome = run(folder / "col", folder / "in")
    assert outcome.failed == {}
    assert outcome.counts == {"done": 6}
    return folder / "in", folder / "col"


def into_archive(white: Path, archive: Path) -> None:
    """Move a white image into an archive as the F01's backup is."""
    with xr.open_dataset(white, engine="lfp") as raw:
        private = json.loads(raw.attrs["private_metadata"])
        image, text = pair_bytes(raw["raw"].values, json.loads(raw.attrs["metadata"]), private)
    write_storage(archive, {"C:\\T1CALIB\\MOD_0001.RAW": image, "C:\\T1CALIB\\MOD_0001.TXT": text})
    white.unlink()


def run(out: Path, *inputs: Path, **options: object):
    return run_collection(out, Options(inputs=inputs, workers=Workers("threads", 1), pictures=False, **options))


def test_each_camera_has_a_group_and_its_own_white_image(finished, capsys):
    col = open_collection(finished[1])
    table = col.catalogue().set_index("id")
    scenes = table[table["kind"] == "scene"]
    assert sorted(scenes["white"]) == ["MOD_0001", "WHITE_0001"]
    assert scenes["group"].is_unique
    for name, scene in scenes.iterrows():
        ds = col.open("lightfield", camera=scene["group"])
        assert list(ds["capture"].values) == [name]
        assert ds["white"].item() == scene["white"]
        calibration = col.open("calibration", camera=scene["group"]).sel(capture=scene["white"])
        assert ds["dh"].item() == calibration["dh"].item()
    assert status(str(finished[1]), why=str(scenes.index[scenes["white"] == "MOD_0001"][0])) == 0
    assert "MOD_0001: zoom 0 and focus 0 steps away" in capsys.readouterr().out


def test_the_white_image_of_the_archive_gave_the_lattice_of_the_simulation(finished):
    col = open_collection(finished[1])
    group = col.catalogue().set_index("id").loc["MOD_0001", "group"]
    found = col.open("calibration", camera=group).sel(capture="MOD_0001")
    assert found["method"].item() == 0, "calibrated as a white image"
    truth = xr.open_zarr(finished[0] / "f01/truth.zarr", group="WHITE_0001", consolidated=False)
    np.testing.assert_allclose([found["dh"], found["theta"]], [truth["dh"], truth["theta"]], atol=2e-4)


def test_another_run_keeps_everything_and_a_lost_catalogue_is_no_loss(finished):
    inputs, out = finished
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.zarr/*/*/c/**/*") if path.is_file()}
    assert run(out, inputs).counts == {"kept": 6}
    ids = open_collection(out).query()
    (out / "catalogue.parquet").unlink()
    assert run(out).counts == {"kept": 6}
    assert open_collection(out).query() == ids
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_results_stay_when_the_pictures_go(finished):
    inputs, out = finished
    moved = inputs.rename(inputs.with_name("elsewhere"))
    try:
        assert run(out).counts == {"kept": 6}
        assert open_collection(out).table("missing").shape[0] == 4
    finally:
        moved.rename(inputs)
    run(out)
    assert open_collection(out).query("missing") == []
