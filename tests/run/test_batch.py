from __future__ import annotations

import dask
import numpy as np
import pytest
from fake_chain import FAKE, write_capture
from fake_stores import store_content

from lfflow.collection import open_collection
from lfflow.collection.validate import validate
from lfflow.errors import CollectionError, SchemaError
from lfflow.run import Options, make_plan, run_collection
from lfflow.run.executors import Workers


def run(out, *inputs, **options):
    return run_collection(out, Options(inputs=inputs, workers=Workers("threads", 2), **options), FAKE)


def test_a_run_finishes_every_stage_of_every_capture(tmp_path, captures, calls):
    outcome = run(tmp_path / "col", captures)
    assert outcome.counts == {"done": 7}
    assert outcome.exit_code == 0
    assert sorted(calls.read_text().split("\n"))[1:] == sorted(
        ["calibration WHITE_1", *(f"{s} IMG_{n}" for s in ("lightfield", "disparity") for n in range(3))]
    )


def test_a_collection_at_a_url_is_that_on_a_disk(tmp_path, captures):
    url = f"memory://{tmp_path.name}"
    assert run(url, captures).counts == {"done": 7}
    run(tmp_path / "col", captures)
    remote, local = open_collection(url), open_collection(tmp_path / "col")
    assert remote.open("disparity").load().identical(local.open("disparity").load())
    assert validate(remote) == []
    victim = next(name for name in remote.storage.files_below("disparity.zarr") if "/disparity/c/1/" in name)
    remote.storage.remove(victim)
    with pytest.raises(CollectionError, match="is lost"):
        remote.open("disparity")["disparity"].load()
    assert [finding.capture for finding in validate(remote)] == ["IMG_1"]
    assert run(url, captures).counts == {"done": 1, "kept": 6}


def test_a_second_run_does_nothing(tmp_path, captures, calls):
    run(tmp_path / "col", captures)
    before = store_content(tmp_path / "col")
    calls.write_text("")
    assert run(tmp_path / "col", captures).counts == {"kept": 7}
    assert calls.read_text() == ""
    assert store_content(tmp_path / "col") == before


def test_opened_results_are_those_of_the_stages_up_to_the_kept_bits(tmp_path, captures):
    run(tmp_path / "col", captures)
    col = open_collection(tmp_path / "col")
    lightfield, disparity = col.open("lightfield"), col.open("disparity")
    assert list(lightfield.capture.values) == ["IMG_0", "IMG_1", "IMG_2"]
    assert lightfield.mosaic.dims == ("capture", "v", "u", "t", "s")
    assert np.array_equal(lightfield.iso, [100, 200, 300])
    np.testing.assert_allclose(disparity.disparity, lightfield.mosaic - 0.5, atol=1e-4)
    calibration = col.open("calibration")
    assert np.array_equal(lightfield.dh.values, np.repeat(calibration.dh.values, 3))
    assert list(lightfield.white.values) == ["WHITE_1"] * 3


def test_opening_and_selecting_computes_nothing(tmp_path, captures, no_compute):
    with dask.config.set(scheduler="threads"):
        run(tmp_path / "col", captures)
    col = open_collection(tmp_path / "col")
    chosen = col.open("disparity").sel(capture=col.query("iso > 150 and disparity_state == 'done'"))
    assert list(chosen.capture.values) == ["IMG_1", "IMG_2"]


def test_a_broken_file_is_reported_and_the_others_are_finished(tmp_path, captures):
    (captures / "BROKEN.lfp").write_text("nothing")
    outcome = run(tmp_path / "col", captures)
    assert outcome.exit_code == 2
    assert "BROKEN" in outcome.failed
    assert "expected JSON" in outcome.failed["BROKEN"]
    assert outcome.counts == {"done": 7}
    assert run(tmp_path / "col", captures).exit_code == 2


def test_a_stage_that_raises_fails_its_capture_only_and_is_not_tried_again(tmp_path, captures, calls):
    write_capture(captures / "BAD.lfp", seed=5, behaviour="raise")
    assert run(tmp_path / "col", captures).counts == {"blocked": 1, "done": 7, "failed": 1}
    calls.write_text("")
    outcome = run(tmp_path / "col", captures)
    assert outcome.counts == {"blocked": 1, "failed": 1, "kept": 7}
    assert "cannot be done" in outcome.failed["BAD"]
    assert calls.read_text() == ""
    write_capture(captures / "BAD.lfp", seed=5)
    assert run(tmp_path / "col", captures).counts == {"done": 2, "kept": 7}


def test_changed_parameters_redo_what_depends_on_them_and_nothing_else(tmp_path, captures, calls):
    run(tmp_path / "col", captures)
    calls.write_text("")
    run(tmp_path / "col", captures, config={"disparity": {"offset": 1.0}})
    assert {line.split()[0] for line in calls.read_text().splitlines()} == {"disparity"}
    calls.write_text("")
    run(tmp_path / "col", captures, config={"disparity": {"offset": 1.0}, "lightfield": {"power": 2.0}})
    assert {line.split()[0] for line in calls.read_text().splitlines()} == {"lightfield", "disparity"}


def test_new_captures_do_not_touch_the_regions_of_old_ones(tmp_path, captures):
    run(tmp_path / "col", captures)
    before = {name: hash_ for name, hash_ in store_content(tmp_path / "col").items() if "/c/0/0/0/0" in name}
    write_capture(captures / "AAA.lfp", seed=77)
    assert run(tmp_path / "col", captures).counts == {"done": 2, "kept": 7}
    after = store_content(tmp_path / "col")
    assert {name: after[name] for name in before} == before
    assert list(open_collection(tmp_path / "col").open("disparity").capture.values) == [
        "IMG_0",
        "IMG_1",
        "IMG_2",
        "AAA",
    ]


def test_scenes_without_a_white_image_calibrate_themselves(tmp_path):
    write_capture(tmp_path / "in" / "A.lfp", seed=3)
    write_capture(tmp_path / "in" / "W.lfp", seed=4, kind="white", serial="OTHER")
    assert run(tmp_path / "col", tmp_path / "in").counts == {"done": 4}
    assert list(open_collection(tmp_path / "col").catalogue()["white"]) == ["self", ""]


def test_a_camera_without_metadata_gets_its_grid_from_the_first_calibration(tmp_path):
    for number in range(2):
        write_capture(tmp_path / "in" / f"A{number}.lfp", seed=number, model="X", lens_pitch=float("nan"))
    assert run(tmp_path / "col", tmp_path / "in").counts["done"] >= 6
    assert open_collection(tmp_path / "col").open("disparity").sizes["capture"] == 2


def test_several_camera_models_have_a_group_each(tmp_path, captures):
    write_capture(captures / "ILLUM.lfp", seed=8, model="B01", lens_pitch=2e-5)
    assert run(tmp_path / "col", captures).exit_code == 0
    col = open_collection(tmp_path / "col")
    with pytest.raises(CollectionError, match="which camera"):
        col.open("disparity")
    assert list(col.open("disparity", camera="B01-40x40").capture.values) == ["ILLUM"]


def test_where_and_stages_limit_the_work(tmp_path, captures):
    outcome = run(tmp_path / "col", captures, where="iso == 200", stages=("calibration", "lightfield"))
    assert outcome.counts == {"blocked": 1, "done": 2}
    assert outcome.exit_code == 0
    assert open_collection(tmp_path / "col").open("lightfield").capture.values.tolist() == ["IMG_1"]


def test_force_redoes_and_gives_the_same_bits(tmp_path, captures, calls):
    run(tmp_path / "col", captures)
    before = store_content(tmp_path / "col")
    calls.write_text("")
    assert run(tmp_path / "col", captures, force=True).counts == {"done": 7}
    assert store_content(tmp_path / "col") == before


def test_duplicates_are_recognised_and_not_computed(tmp_path, captures):
    (captures / "COPY.lfp").write_bytes((captures / "IMG_1.lfp").read_bytes())
    assert run(tmp_path / "col", captures).counts == {"done": 7}
    table = open_collection(tmp_path / "col").catalogue().set_index("id")
    assert table.loc["IMG_1", "duplicate_of"] == "COPY"


def test_the_plan_says_what_would_run_and_why(tmp_path, captures):
    run(tmp_path / "col", captures)
    jobs = make_plan(tmp_path / "col", Options(config={"disparity": {"offset": 2.0}}), FAKE)
    actions = {(step.stage, step.action) for job in jobs for step in job.steps}
    assert actions == {("calibration", "skip"), ("lightfield", "skip"), ("disparity", "run")}


def test_a_store_that_differs_from_its_declaration_is_refused_with_the_difference(tmp_path, captures):
    run(tmp_path / "col", captures)
    metadata = tmp_path / "col" / "disparity.zarr" / "T1-40x40" / "disparity" / "zarr.json"
    metadata.write_text(metadata.read_text().replace('"float32"', '"float64"').replace("crc32c", "another_codec"))
    with pytest.raises(SchemaError, match="data_type: found float64, expected float32"):
        run(tmp_path / "col", captures)
