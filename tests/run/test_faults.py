"""What may go wrong while a collection is made, and what must hold then."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from fake_chain import FAKE, write_capture
from fake_stores import store_content

from lfflow.collection import open_collection
from lfflow.collection.validate import validate
from lfflow.errors import CollectionError
from lfflow.run import Options, run_collection
from lfflow.run.executors import Workers

HERE = Path(__file__).parent
SCRIPT = str(HERE / "run_fake.py")


def run(out, captures, **options):
    return run_collection(out, Options(inputs=(captures,), workers=Workers("threads", 2), **options), FAKE)


def start(captures, out, workers="threads:2"):
    environment = {**os.environ, "PYTHONPATH": str(HERE)}
    command = [sys.executable, SCRIPT, str(captures), str(out), workers]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, env=environment, start_new_session=True, text=True, **pipes)


def lines(log):
    return log.read_text().splitlines()


@pytest.fixture
def finished(tmp_path, captures):
    run(tmp_path / "whole", captures)
    return store_content(tmp_path / "whole")


def assert_nothing_reads_as_finished_that_is_not(col, expected):
    """Every region that the ledger calls done has the bytes of the uninterrupted run."""
    for kind in ("calibration", "lightfield", "disparity"):
        for record in open_collection(col).ledger.records(kind).values():
            assert {name: expected[name] for name in record.files} == dict(record.files)


def kill_again_and_again(captures, out, expected, calls, *, kills, longest):
    rng = random.Random(1)  # noqa: S311
    for _ in range(kills):
        process = start(captures, out)
        while process.poll() is None and not (out / "catalogue.parquet").exists():
            time.sleep(0.01)
        try:
            process.communicate(timeout=rng.uniform(0.0, longest))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
        assert_nothing_reads_as_finished_that_is_not(out, expected)
    done = {f"{r.stage} {r.capture}" for kind in ("calibration", "lightfield", "disparity")
            for r in open_collection(out).ledger.records(kind).values()}  # fmt: skip
    calls.write_text("")
    assert run(out, captures).exit_code == 0
    assert not done & set(lines(calls)), "a finished result was made again"
    assert store_content(out) == expected


def test_a_run_that_is_killed_resumes_to_the_same_bits(tmp_path, captures, calls, finished):
    kill_again_and_again(captures, tmp_path / "col", finished, calls, kills=3, longest=2.0)


@pytest.mark.heavy
def test_a_run_that_is_killed_two_hundred_times_resumes_to_the_same_bits(tmp_path, captures, calls):
    for number in range(60):
        write_capture(captures / f"MORE_{number}.lfp", seed=100 + number)
    run(tmp_path / "whole", captures)
    expected = store_content(tmp_path / "whole")
    for _ in range(10):
        shutil.rmtree(tmp_path / "col", ignore_errors=True)
        kill_again_and_again(captures, tmp_path / "col", expected, calls, kills=20, longest=4.0)


def test_of_runs_started_at_once_each_capture_is_computed_once(tmp_path, captures, calls, finished):
    calls.write_text("")
    processes = [start(captures, tmp_path / "col") for _ in range(2)]
    outputs = [process.communicate(timeout=120)[1] for process in processes]
    codes = sorted(process.returncode for process in processes)
    assert codes in ([0, 0], [0, 3])
    if codes == [0, 3]:
        assert any("another run works on" in text and "process" in text for text in outputs)
    assert len(lines(calls)) == len(set(lines(calls))) == 7
    assert store_content(tmp_path / "col") == finished


def flip(path: Path, place: float = 0.5) -> None:
    data = bytearray(path.read_bytes())
    data[int(len(data) * place)] ^= 4
    path.write_bytes(data)


@pytest.mark.parametrize(
    "pattern",
    [
        "disparity.zarr/*/disparity/c/1/0/0/0/0",
        "calibration.zarr/*/vignetting/c/0/*/0",
        "lightfield.zarr/*/mosaic/zarr.json",
        "lightfield.zarr/*/dh/c/0",
        "ledger/disparity/done/IMG_1.json",
        "catalogue.parquet",
    ],
)
def test_a_flipped_bit_is_found_and_mended_by_the_next_run(tmp_path, captures, pattern, finished):
    col = tmp_path / "whole"
    flip(next(col.glob(pattern)))
    assert validate(open_collection(col))
    assert run(col, captures).exit_code == 0
    assert validate(open_collection(col)) == []
    assert store_content(col) == finished


def test_a_damaged_region_is_never_a_wrong_number(tmp_path, captures):
    run(tmp_path / "col", captures)
    flip(next((tmp_path / "col").glob("disparity.zarr/*/disparity/c/1/0/0/0/0")))
    with pytest.raises(Exception, match=r"(?i)crc|checksum"):
        open_collection(tmp_path / "col").open("disparity")["disparity"].sel(capture="IMG_1").load()


def test_a_file_that_vanishes_between_scan_and_read_fails_alone_and_is_tried_again(tmp_path, captures, monkeypatch):
    import fake_chain

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


def test_a_full_disk_is_said_and_the_run_resumes_when_there_is_room(tmp_path, captures, monkeypatch, finished):
    import errno

    from lfflow.collection.stores import Store

    original = Store.write

    def full(self, group, slot, ds, threads=1):
        if self.schema.name == "disparity" and slot > 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return original(self, group, slot, ds, threads)

    with monkeypatch.context() as patch:
        patch.setattr(Store, "write", full)
        outcome = run(tmp_path / "col", captures)
    assert outcome.exit_code == 2
    assert all("no space left on the disk" in reason for reason in outcome.failed.values())
    assert run(tmp_path / "col", captures).counts == {"done": 2, "kept": 5}
    assert store_content(tmp_path / "col") == finished


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_said(tmp_path, captures):
    (tmp_path / "col").mkdir(mode=0o500)
    with pytest.raises(CollectionError, match="permission denied"):
        run(tmp_path / "col", captures)


def test_a_default_run_opens_no_socket_off_the_loopback(tmp_path, captures):
    process = start(captures, tmp_path / "col")
    seen = []
    watched = psutil.Process(process.pid)
    while process.poll() is None:
        try:
            seen += [c.laddr.ip for c in watched.net_connections("inet") if c.laddr]
        except psutil.Error:
            break
        time.sleep(0.05)
    process.communicate()
    assert set(seen) <= {"127.0.0.1", "::1"}


def test_a_collection_at_a_url_is_a_collection(tmp_path, captures):
    url = f"memory://{tmp_path.name}/col"
    assert run(url, captures).counts == {"done": 7}
    assert run(url, captures).counts == {"kept": 7}
    col = open_collection(url)
    assert col.open("disparity").disparity.isel(capture=1).load().notnull().all()
    assert validate(col) == []


def kill_workers(captures, out, *, kills, pause):
    """Run on two worker processes and kill one of them again and again; returns the exit code and the kills made."""
    process = start(captures, out, "processes:2")
    rng, made, limit = random.Random(2), 0, time.monotonic() + 60 + 10 * kills  # noqa: S311
    while process.poll() is None and made < kills:
        assert time.monotonic() < limit, "the run hangs"
        time.sleep(rng.uniform(0, pause))
        workers = [
            child for child in psutil.Process(process.pid).children(recursive=True)
            if "spawn_main" in " ".join(_command(child))
        ]  # fmt: skip
        if (out / "ledger").exists() and workers:
            rng.choice(workers).kill()
            made += 1
    process.communicate(timeout=300)
    return process.returncode, made


def _command(process):
    try:
        return process.cmdline()
    except psutil.Error:
        return []


@pytest.mark.heavy
def test_workers_that_are_killed_again_and_again_lose_nothing(tmp_path, captures):
    for number in range(40):
        write_capture(captures / f"MORE_{number}.lfp", seed=100 + number, behaviour="sleep0.5")
    run(tmp_path / "whole", captures)
    expected = store_content(tmp_path / "whole")
    made = 0
    while made < 100:
        shutil.rmtree(tmp_path / "col", ignore_errors=True)
        code, killed = kill_workers(captures, tmp_path / "col", kills=100 - made, pause=2.0)
        made += max(1, killed)
        assert code in (0, 2)
        assert_nothing_reads_as_finished_that_is_not(tmp_path / "col", expected)
        assert run(tmp_path / "col", captures).exit_code == 0
        assert store_content(tmp_path / "col") == expected


@pytest.mark.heavy
def test_ten_times_the_captures_need_the_same_memory(tmp_path):
    peaks = []
    for count in (40, 400):
        for number in range(count):
            write_capture(tmp_path / f"in{count}" / f"IMG_{number}.lfp", seed=number)
        process = start(tmp_path / f"in{count}", tmp_path / f"col{count}")
        peaks.append(int(process.communicate(timeout=600)[0]))
    assert peaks[1] <= 1.2 * peaks[0]
