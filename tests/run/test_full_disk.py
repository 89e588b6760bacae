"""No room, no permission, no file: said clearly, nothing finished is harmed, and the run goes on later."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import fake_chain
import pytest
from fake_chain import write_capture
from fake_stores import store_content
from fault_tools import lines, records, remount, run, small_disk, start

from lfflow.errors import CollectionError

NOBODY = 65534
only_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount, or become another user")


@pytest.fixture
def disk(tmp_path):
    try:
        with small_disk(tmp_path / "disk", "24m") as path:
            yield path
    except PermissionError as error:
        pytest.skip(f"no file system may be mounted here: {error}")


@pytest.fixture
def open_folder():
    """A folder that every user may enter, unlike pytest's own."""
    path = Path(tempfile.mkdtemp())
    path.chmod(0o755)
    yield path
    shutil.rmtree(path)


def fill(disk: Path, room: int) -> Path:
    """Fill a disk up to some bytes."""
    filler = disk / "filler"
    free = os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize
    filler.write_bytes(bytes(max(0, free - room)))
    return filler


def outcome_of(out, captures):
    """Failures of a run on a disk that may be too small for it."""
    try:
        return run(out, captures).failed
    except CollectionError as error:
        return {"": str(error)}


@only_root
def test_a_full_disk_is_said_and_the_run_resumes_when_there_is_room(tmp_path, captures, calls, disk):
    run(tmp_path / "whole", captures)
    before, said = set(), 0
    for room in (20_000, 400_000, 600_000, 700_000):
        filler = fill(disk, room)
        failed = outcome_of(disk / "col", captures)
        said += bool(failed)
        assert all("no space left on the disk" in reason for reason in failed.values()), failed
        after = {(record.stage, record.capture) for record in records(disk / "col")} if before or not failed else set()
        assert before <= after, "a full disk harmed what was finished"
        before = after
        filler.unlink()
    assert said >= 2
    done = {f"{stage} {capture}" for stage, capture in before}
    calls.write_text("")
    assert run(disk / "col", captures).exit_code == 0
    assert not done & set(lines(calls))
    assert store_content(disk / "col") == store_content(tmp_path / "whole")


@only_root
def test_a_disk_that_fills_up_in_the_middle_ends_the_run_instead_of_failing_all(tmp_path, captures, disk, monkeypatch):
    for number in range(20):
        write_capture(captures / f"MORE_{number}.lfp", seed=100 + number)
    original, made = fake_chain.disparity, []

    def full_after_three(lf, **parameters):
        made.append(lf["capture"].item())
        if len(made) == 3:
            fill(disk, 0)
        return original(lf, **parameters)

    monkeypatch.setattr(fake_chain, "disparity", full_after_three)
    failed = run(disk / "col", captures).failed
    assert len(made) < 8, "what cannot be written was computed all the same"
    assert any(reason.startswith("lightfield: not tried: cannot write") for reason in failed.values())
    (disk / "filler").unlink()
    assert run(disk / "col", captures).exit_code == 0


@only_root
def test_a_collection_on_a_read_only_disk_is_said(captures, disk):
    run(disk / "col", captures)
    whole = store_content(disk / "col")
    write_capture(captures / "NEW.lfp", seed=77)
    remount(disk, "ro")
    with pytest.raises(CollectionError, match="read-only"):
        run(disk / "col", captures)
    remount(disk, "rw")
    assert store_content(disk / "col") == whole
    assert run(disk / "col", captures).counts == {"done": 2, "kept": 7}


def test_a_file_that_may_not_grow_is_said(tmp_path, captures, monkeypatch):
    monkeypatch.setenv("FILE_LIMIT", "3000")
    process = start(captures, tmp_path / "col")
    errors = process.communicate(timeout=120)[1]
    assert process.returncode in (2, 3)
    assert "cannot write to the collection: File too large" in errors
    monkeypatch.delenv("FILE_LIMIT")
    assert run(tmp_path / "col", captures).exit_code == 0


@only_root
def test_what_another_user_may_not_write_or_read_is_said(captures, open_folder, monkeypatch):
    monkeypatch.setenv("RUN_AS", str(NOBODY))
    monkeypatch.setenv("TMPDIR", str(open_folder))
    folder = shutil.copytree(captures, open_folder / "in")
    process = start(folder, open_folder / "col")
    errors = process.communicate(timeout=120)[1]
    assert process.returncode == 3
    assert "permission denied" in errors
    (open_folder / "col").mkdir()
    os.chown(open_folder / "col", NOBODY, NOBODY)
    (folder / "IMG_1.lfp").chmod(0o600)
    process = start(folder, open_folder / "col")
    errors = process.communicate(timeout=120)[1]
    assert process.returncode == 2
    assert next(line for line in errors.splitlines() if line.startswith("IMG_1: ")).endswith("Permission denied")
    assert len(records(open_folder / "col")) == 5


def test_a_file_that_vanishes_between_scan_and_read_fails_alone_and_is_tried_again(tmp_path, captures, monkeypatch):
    victim, kept = captures / "IMG_1.lfp", (captures / "IMG_1.lfp").read_bytes()
    original = fake_chain.calibrate

    def vanish(raw, **parameters):
        victim.unlink(missing_ok=True)
        return original(raw, **parameters)

    monkeypatch.setattr(fake_chain, "calibrate", vanish)
    outcome = run(tmp_path / "col", captures)
    assert outcome.exit_code == 2
    assert "No such file" in outcome.failed["IMG_1"]
    assert outcome.counts["done"] == 5
    victim.write_bytes(kept)
    assert run(tmp_path / "col", captures).exit_code == 0


def test_a_file_that_changes_between_scan_and_read_is_not_taken_for_the_old_one(tmp_path, captures, monkeypatch):
    original = fake_chain.calibrate

    def change(raw, **parameters):
        write_capture(captures / "IMG_1.lfp", seed=12345, iso=400.0)
        return original(raw, **parameters)

    with monkeypatch.context() as patch:
        patch.setattr(fake_chain, "calibrate", change)
        assert "has changed since it was scanned" in run(tmp_path / "col", captures).failed["IMG_1"]
    assert run(tmp_path / "col", captures).counts == {"done": 2, "kept": 5}
