"""Memory: what a task needs against what was said of it, what the bound does, and what ten times the captures cost."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from fake_chain import write_capture
from fault_tools import run

from lfflow.collection import open_collection
from lfflow.run import Options, make_plan, scan_collection
from lfflow.run.chain import CHAIN, Grid
from lfflow.run.estimate import estimate
from lfflow.run.executors import Workers
from lfflow.run.limits import PROCESS, in_flight, task_memory
from lfflow.run.plan import RUN, Job, Step

MIB = 1 << 20
F01 = Grid(388, 337, 5)
ILLUM = Grid(442, 546, 7)


@pytest.fixture
def measure(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    from benchmarks import collection

    return collection


def job(height, width, grid, kind="scene", config=None):
    stages = ("lightfield", "disparity") if kind == "scene" else ("calibration",)
    steps = tuple(Step(stage, "A", "mark", RUN, "", config or {}) for stage in stages)
    return Job("A", "a.lfp", 1, 1, "", "G", height, width, kind, grid, steps)


def test_the_estimate_follows_the_camera_and_the_parameters():
    white = task_memory(job(3280, 3280, F01, "white"), CHAIN)
    scene = task_memory(job(3280, 3280, F01), CHAIN)
    illum = task_memory(job(5368, 7728, ILLUM), CHAIN)
    assert 200 * MIB < white < 400 * MIB
    assert 500 * MIB < scene < 1200 * MIB
    assert scene * 1.5 < illum < scene * 5
    narrow = {"disparity": {"hypotheses": [-0.5, 0.0, 0.5]}}
    assert task_memory(job(3280, 3280, F01, config=narrow), CHAIN) < scene
    assert task_memory(job(3280, 3280, None), CHAIN) == pytest.approx(scene, rel=0.5)


def test_tasks_in_flight_and_their_processes_stay_within_the_limit():
    task = 500 * MIB
    assert in_flight(task, "threads", 8, PROCESS + 3 * task) == 3
    assert in_flight(task, "processes", 8, PROCESS + 3 * (PROCESS + task)) == 3
    assert in_flight(task, "threads", 2, 1 << 40) == 2
    assert in_flight(task, "threads", 8, 1) == 1, "one always runs"
    assert in_flight(0, "threads", 8, 1) == 8
    assert in_flight(1 << 60, "threads", 8, None) == 1, "what the machine has free is the limit"


def test_the_limit_holds_back_captures(tmp_path, captures, monkeypatch):
    import threading
    import time

    import fake_chain

    from lfflow.run import crew

    monkeypatch.setattr(crew, "in_flight", lambda _, kind, workers, limit: in_flight(MIB, kind, workers, limit))
    for number in range(4):
        write_capture(captures / f"MORE_{number}.lfp", seed=number + 50)
    original, guard, now, most = fake_chain.disparity, threading.Lock(), [0], [0]

    def counted(lf, **parameters):
        with guard:
            now[0] += 1
            most[0] = max(most[0], now[0])
        time.sleep(0.05)
        with guard:
            now[0] -= 1
        return original(lf, **parameters)

    monkeypatch.setattr(fake_chain, "disparity", counted)
    assert run(tmp_path / "col", captures, workers=Workers("threads", 6), memory=PROCESS + 2 * MIB).exit_code == 0
    assert most[0] <= 2


def test_the_plan_says_what_it_needs(tmp_path, captures):
    run(tmp_path / "col", captures)
    options = Options(force=True, workers=Workers("processes", 2), memory=16 << 30)
    from fake_chain import FAKE

    needs = estimate(tmp_path / "col", make_plan(tmp_path / "col", options, FAKE), options, FAKE)
    assert needs["steps"] == 7
    assert needs["tasks_in_flight"] == 2
    assert 0 <= needs["memory"] - 3 * PROCESS < MIB
    assert open_collection(tmp_path / "col").status()["files"] == 4


def test_the_plan_takes_its_time_from_the_ledger_once_there_is_one(tmp_path, captures):
    from fake_chain import FAKE

    constants = replace(FAKE, stages=tuple(replace(stage, seconds_per_megapixel=625.0) for stage in FAKE.stages))
    options = Options(force=True, inputs=(captures,), workers=Workers("threads", 2), memory=16 << 30)

    def told():
        return estimate(tmp_path / "col", make_plan(tmp_path / "col", options, FAKE), options, constants)

    scan_collection(tmp_path / "col", options, FAKE)
    assert told()["seconds"] == 7 * 1.0 / 2
    assert told()["seconds_from"] == dict.fromkeys(FAKE.names, "constants")
    run(tmp_path / "col", captures)
    ledger = open_collection(tmp_path / "col").ledger
    for stage, taken in (("lightfield", (2.0, 4.0, 90.0)), ("disparity", (1.0, 1.0, 1.0))):
        for record, seconds in zip(ledger.records(stage).values(), taken, strict=True):
            ledger.write(replace(record, seconds=seconds))
    ledger.remove("calibration", "WHITE_1")
    needs = told()
    assert needs["seconds"] == (1.0 + 3 * 4.0 + 3 * 1.0) / 2
    assert needs["seconds_from"] == {"calibration": "constants", "lightfield": "ledger", "disparity": "ledger"}


def test_a_small_real_capture_stays_below_its_estimate(measure):
    for row in measure.memory(600, 600):
        assert row["peak"] <= 1.2 * row["estimate"], row


@pytest.mark.heavy
def test_a_whole_capture_stays_below_its_estimate(measure):
    for config in (None, measure.WIDE):
        for row in measure.memory(None, None, config):
            sys.stdout.write(f"{row}\n")
            assert 0.4 * row["estimate"] <= row["peak"] <= 1.2 * row["estimate"], row


@pytest.mark.heavy
def test_ten_times_the_captures_need_the_same_memory_and_the_same_graph(measure):
    small, large = measure.growth(40, 400)
    sys.stdout.write(f"{small}\n{large}\n")
    assert large["worker_peak"] <= 1.1 * small["worker_peak"]
    assert large["client_peak"] <= 1.2 * small["client_peak"]
    assert large["tasks_in_flight"] == small["tasks_in_flight"] == 2
    assert large["bytes_per_task"] <= small["bytes_per_task"] + 100 < 20_000
