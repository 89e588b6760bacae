"""Several runs on one collection, locks that the dead left, holders on other machines."""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from dataclasses import asdict

import pytest
from fake_chain import write_capture
from fake_stores import store_content
from fault_tools import kill, lines, run, start, wait_until

from lfflow.collection import leases, object_lease
from lfflow.collection.leases import Holder, abandoned, lease, run_lease
from lfflow.collection.storage import open_storage
from lfflow.errors import CollectionError


def rivals(captures, out, count):
    """Exit codes and messages of runs that are started at once."""
    processes = [start(captures, out) for _ in range(count)]
    errors = [process.communicate(timeout=600)[1] for process in processes]
    return sorted(process.returncode for process in processes), errors


def check_rivals(tmp_path, captures, calls, count):
    run(tmp_path / "whole", captures)
    calls.write_text("")
    codes, errors = rivals(captures, tmp_path / "col", count)
    assert codes[0] == 0
    assert set(codes) <= {0, 3}
    refused = [text for text in errors if "another run works on" in text]
    assert len(refused) == codes.count(3)
    assert all("process" in text and " on " in text for text in refused)
    assert len(lines(calls)) == len(set(lines(calls))), "a capture was computed twice"
    assert len(lines(calls)) == 2 * len(list(captures.glob("*.lfp"))) - 1
    assert store_content(tmp_path / "col") == store_content(tmp_path / "whole")


def test_of_two_runs_started_at_once_each_capture_is_computed_once(tmp_path, captures, calls):
    check_rivals(tmp_path, captures, calls, 2)


@pytest.mark.heavy
@pytest.mark.parametrize("count", [4, 8])
def test_of_many_runs_started_at_once_each_capture_is_computed_once(tmp_path, captures, calls, count):
    for number in range(20):
        write_capture(captures / f"MORE_{number}.lfp", seed=100 + number, behaviour="sleep0.05")
    check_rivals(tmp_path, captures, calls, count)


def test_the_lock_of_a_run_that_was_killed_is_taken_over(tmp_path, captures):
    write_capture(captures / "SLOW.lfp", seed=5, behaviour="sleep60")
    process = start(captures, tmp_path / "col")
    lock = tmp_path / "col" / "leases"
    wait_until(lambda: (lock / "lightfield" / "SLOW").exists())
    with pytest.raises(CollectionError, match=rf"another run works on .*\(process {process.pid} on "):
        run(tmp_path / "col", captures)
    kill(process)
    assert (lock / "run").exists()
    assert abandoned(open_storage(tmp_path / "col"))["SLOW"] == 1
    write_capture(captures / "SLOW.lfp", seed=5)
    assert run(tmp_path / "col", captures).exit_code == 0
    assert not (lock / "run").exists()
    assert abandoned(open_storage(tmp_path / "col")) == {}


@pytest.fixture
def impatient(monkeypatch):
    for module in (leases, object_lease):
        monkeypatch.setattr(module, "BEAT_SECONDS", 0.05)
        monkeypatch.setattr(module, "PATIENCE_SECONDS", 0.5)
    monkeypatch.setattr(object_lease, "SETTLE_SECONDS", 0.1)


def left_elsewhere(path, beat=0):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(asdict(Holder(7, "far", "another kernel", "2020-01-01 00:00:00", beat))))


def test_the_lock_that_another_machine_left_is_taken_over_when_its_heart_stands_still(tmp_path, impatient):
    left_elsewhere(tmp_path / "leases" / "run")
    started = time.monotonic()
    with run_lease(open_storage(tmp_path)):
        assert time.monotonic() - started >= 0.5


def test_the_lock_of_another_machine_is_respected_while_its_heart_beats(tmp_path, impatient):
    path, stop = tmp_path / "leases" / "run", threading.Event()

    left_elsewhere(path, 10000)

    def beat():
        number = 10000
        with path.open("r+b", buffering=0) as stream:
            while not stop.wait(0.05):
                number += 1
                os.pwrite(stream.fileno(), path.read_bytes().replace(b"%d" % (number - 1), b"%d" % number), 0)

    heart = threading.Thread(target=beat)
    heart.start()
    try:
        with pytest.raises(CollectionError, match="process 7 on far"), run_lease(open_storage(tmp_path)):
            pass
    finally:
        stop.set()
        heart.join()


def test_a_held_lock_beats_and_counts_the_deaths_before_it(tmp_path, impatient):
    path = tmp_path / "leases" / "lightfield" / "A%2FB"
    path.parent.mkdir(parents=True)
    mine = leases._myself(deaths=1)
    path.write_text(json.dumps(asdict(mine)))
    assert abandoned(open_storage(tmp_path)) == {"A/B": 2}
    with lease(open_storage(tmp_path), "lightfield", "A/B"):
        first = json.loads(path.read_text())
        assert first["deaths"] == 2
        wait_until(lambda: json.loads(path.read_text())["beat"] > first["beat"], 10)
    assert not path.exists()


def test_a_lease_waits_for_its_holder(tmp_path):
    storage = open_storage(tmp_path)
    with lease(storage, "disparity", "A"):
        again = lease(storage, "disparity", "A", timeout=0.1)
        with pytest.raises(CollectionError, match="disparity of A is held by another process"), again:
            pass
        with lease(storage, "disparity", "B", timeout=0.1):
            pass


def test_on_an_object_store_a_lease_is_an_object_that_beats(tmp_path, impatient):
    storage = open_storage(f"memory://{tmp_path.name}")
    with run_lease(storage) as tenure:
        assert not tenure.lost
        first = storage.read(object_lease.NAME)
        wait_until(lambda: storage.read(object_lease.NAME) != first, 10)
    assert object_lease.NAME not in storage.files_below("leases")


def test_on_an_object_store_the_lease_of_a_dead_machine_is_taken_over_and_a_living_one_is_told(tmp_path, impatient):
    storage = open_storage(f"memory://{tmp_path.name}")
    theirs = {"token": "x", "pid": 7, "host": "far", "machine": "another kernel", "since": "today", "beat": 0}
    storage.write(object_lease.NAME, json.dumps(theirs).encode())
    with run_lease(storage) as tenure:
        assert not tenure.lost
        storage.write(object_lease.NAME, json.dumps(theirs).encode())
        wait_until(lambda: tenure.lost, 10)
    assert json.loads(storage.read(object_lease.NAME)) == theirs, "a lease that was lost is not this run's to remove"


def test_a_run_whose_lease_was_taken_over_begins_nothing_more(tmp_path, captures, monkeypatch):
    from lfflow.run import batch

    class Lost:
        lost = True

    monkeypatch.setattr(batch, "run_lease", lambda _: contextlib.nullcontext(Lost()))
    failed = run(tmp_path / "col", captures).failed
    assert failed["IMG_0"].endswith("not tried: another run has taken the collection over")
