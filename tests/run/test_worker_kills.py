"""kill -9 of workers, nannies and the scheduler; crashing tasks; clusters that are gone."""

from __future__ import annotations

import os
import random
import shutil
import sys
import threading
import time

import psutil
import pytest
from fake_chain import FAKE, write_capture
from fake_stores import store_content
from fault_tools import (
    assert_nothing_reads_as_finished_that_is_not,
    kill,
    processes_below,
    records,
    run,
    start,
    wait_until,
)

from lfflow.run import cluster
from lfflow.run.cluster import ClusterExecutor
from lfflow.run.executors import Workers
from lfflow.run.plan import RUN, Job, Step
from lfflow.run.task import Work

SECONDS_PER_KILL = 20


def kill_workers(captures, out, *, kills, pause):
    """Run on two worker processes and kill one of them again and again; returns the exit code and the kills made."""
    process = start(captures, out, "processes:2")
    rng, made, limit = random.Random(2), 0, time.monotonic() + 120 + SECONDS_PER_KILL * kills  # noqa: S311
    try:
        while process.poll() is None and made < kills:
            assert time.monotonic() < limit, "the run hangs"
            time.sleep(rng.uniform(0, pause))
            workers = processes_below(process.pid, "spawn_main")
            if workers and any(out.glob("ledger/*/done/*.json")):
                rng.choice(workers).kill()
                made += 1
        errors = process.communicate(timeout=max(1.0, limit - time.monotonic()))[1]
    finally:
        kill(process)
    assert process.returncode in (0, 2), errors
    return process.returncode, made


def sleepers(captures, count, seconds):
    for number in range(count):
        write_capture(captures / f"MORE_{number}.lfp", seed=100 + number, behaviour=f"sleep{seconds}")


def test_workers_that_are_killed_lose_nothing(tmp_path, captures):
    sleepers(captures, 4, 0.3)
    run(tmp_path / "whole", captures)
    expected = store_content(tmp_path / "whole")
    assert kill_workers(captures, tmp_path / "col", kills=3, pause=0.6)[1] >= 1
    assert_nothing_reads_as_finished_that_is_not(tmp_path / "col", expected)
    assert run(tmp_path / "col", captures).exit_code == 0
    assert store_content(tmp_path / "col") == expected


@pytest.mark.heavy
def test_workers_that_are_killed_a_hundred_times_lose_nothing(tmp_path, captures):
    sleepers(captures, 40, 0.5)
    run(tmp_path / "whole", captures)
    expected = store_content(tmp_path / "whole")
    made = runs = 0
    codes = set()
    while made < 100:
        shutil.rmtree(tmp_path / "col", ignore_errors=True)
        code, killed = kill_workers(captures, tmp_path / "col", kills=100 - made, pause=2.0)
        made, runs = made + killed, runs + 1
        codes.add(code)
        assert_nothing_reads_as_finished_that_is_not(tmp_path / "col", expected)
        assert run(tmp_path / "col", captures).exit_code == 0
        assert store_content(tmp_path / "col") == expected
    sys.stdout.write(f"{made} kills in {runs} runs, exit codes {sorted(codes)}\n")


@pytest.fixture
def by_hand(monkeypatch, tmp_path):
    from pathlib import Path

    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    from pipelines.cluster import by_hand

    return by_hand


def kill_when_some_are_done(out, word, done):
    """Kill a process of the cluster as soon as some results are finished."""

    def wait_and_kill():
        wait_until(lambda: (out / "catalogue.parquet").exists() and len(records(out)) >= done)
        processes_below(os.getpid(), word)[0].kill()

    thread = threading.Thread(target=wait_and_kill)
    thread.start()
    return thread


def test_a_killed_nanny_and_a_killed_scheduler_lose_nothing(tmp_path, captures, by_hand, monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT_SECONDS", 2.0)
    sleepers(captures, 4, 0.4)
    run(tmp_path / "whole", captures)
    expected = store_content(tmp_path / "whole")
    with by_hand(2) as address:
        workers = Workers("cluster", address=address)
        killer = kill_when_some_are_done(tmp_path / "nanny", " worker ", 2)
        assert run(tmp_path / "nanny", captures, workers=workers).exit_code in (0, 2)
        killer.join()
        assert_nothing_reads_as_finished_that_is_not(tmp_path / "nanny", expected)
        killer = kill_when_some_are_done(tmp_path / "scheduler", " scheduler ", 2)
        started = time.monotonic()
        outcome = run(tmp_path / "scheduler", captures, workers=workers)
        killer.join()
        assert time.monotonic() - started < 90, "the run hangs"
    assert outcome.exit_code == 2
    assert any("the scheduler was lost" in reason for reason in outcome.failed.values())
    for out in (tmp_path / "nanny", tmp_path / "scheduler"):
        before = len(records(out))
        assert before >= 2
        assert run(out, captures).exit_code == 0
        assert store_content(out) == expected


def test_a_capture_that_kills_its_process_is_recorded_and_the_others_are_finished(tmp_path, captures):
    write_capture(captures / "POISON.lfp", seed=99, behaviour="crash")
    started = time.monotonic()
    outcome = run(tmp_path / "col", captures, workers=Workers("processes", 2), retries=1)
    assert outcome.exit_code == 2
    assert list(outcome.failed) == ["POISON"]
    assert "crashed 2 times" in outcome.failed["POISON"]
    assert outcome.counts == {"blocked": 1, "done": 7, "failed": 1}
    assert time.monotonic() - started < 120


def test_a_capture_that_kills_a_run_of_threads_is_isolated_by_the_third(tmp_path, captures):
    write_capture(captures / "AAA_POISON.lfp", seed=99, behaviour="crash")
    codes = []
    for _ in range(3):
        process = start(captures, tmp_path / "col", "threads:1")
        errors = process.communicate(timeout=120)[1]
        codes.append(process.returncode)
    assert codes == [-9, -9, 2]
    assert "AAA_POISON took the process down before" in errors
    assert "AAA_POISON: lightfield: its process crashed 2 times" in errors
    assert len(records(tmp_path / "col")) == 7


class NoWorkers:
    """A client of a scheduler that never gets a worker."""

    status = "running"

    class Future:
        status = "pending"

        @staticmethod
        def done():
            return False

    def scheduler_info(self, **_):
        return {"workers": {}}

    def submit(self, *_, **__):
        return self.Future()


def test_a_run_whose_workers_never_come_back_ends_with_the_list(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "QUEUE_SECONDS", 0.5)
    monkeypatch.setattr(ClusterExecutor, "_wait", staticmethod(lambda _: time.sleep(0.05)))
    step = Step("lightfield", "A", "mark", RUN, "not done yet")
    job = Job("A", "a.lfp", 1, 1, "", "G", 40, 40, "scene", None, (step,))
    works = (Work(str(tmp_path), FAKE, job) for _ in range(5))
    reported = []
    ClusterExecutor(NoWorkers(), patience=0.3).run(works, reported.append)
    assert [status.reason for statuses in reported for status in statuses] == ["there was no worker for 0.3 s"] * 5


def test_worker_memory_bounds_the_tasks_in_flight(monkeypatch):
    executor = ClusterExecutor(NoWorkers(), memory=1 << 30)
    assert [executor._fits(8, memory << 30) for memory in (0, 1, 3, 6, 64)] == [8, 1, 2, 5, 8]


def test_nothing_of_a_run_is_left_when_it_ends(tmp_path, captures):
    run(tmp_path / "col", captures, workers=Workers("processes", 2))
    wait_until(lambda: not [p for p in psutil.Process().children(recursive=True) if "spawn_main" in str(p.cmdline())])
    assert not list((tmp_path / "col" / "leases").glob("*/*"))
