from __future__ import annotations

import time
from pathlib import Path

import pytest
from distributed import LocalCluster
from fake_chain import FAKE, write_capture
from fake_stores import store_content

from lfflow.collection import open_collection
from lfflow.run import Options, run_collection
from lfflow.run.executors import Workers, WorkersError, parse_workers

HERE = str(Path(__file__).parent)


@pytest.fixture(autouse=True)
def _importable_by_workers(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", HERE)


def run(out, captures, workers, **options):
    return run_collection(out, Options(inputs=(captures,), workers=workers, **options), FAKE)


def test_processes_and_a_cluster_give_the_bits_of_one_thread(tmp_path, captures):
    run(tmp_path / "one", captures, Workers("threads", 1))
    expected = store_content(tmp_path / "one")
    assert run(tmp_path / "two", captures, Workers("processes", 2)).counts == {"done": 7}
    assert store_content(tmp_path / "two") == expected
    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
        assert run(tmp_path / "tcp", captures, Workers("cluster", address=cluster.scheduler_address)).exit_code == 0
    assert store_content(tmp_path / "tcp") == expected


def test_a_capture_that_kills_its_process_is_recorded_and_the_others_are_finished(tmp_path, captures):
    write_capture(captures / "POISON.lfp", seed=99, behaviour="crash")
    started = time.monotonic()
    outcome = run(tmp_path / "col", captures, Workers("processes", 2), retries=1)
    assert outcome.exit_code == 2
    assert list(outcome.failed) == ["POISON"]
    assert "crashed 2 times" in outcome.failed["POISON"]
    assert open_collection(tmp_path / "col").open("disparity").sizes["capture"] == 3
    assert time.monotonic() - started < 60


def test_workers_are_said_in_words():
    assert parse_workers("processes:3") == Workers("processes", 3)
    assert parse_workers("tls://h:1") == Workers("cluster", address="tls://h:1")
    for wrong in ("threads:0", "many", "processes:x"):
        with pytest.raises(WorkersError, match="threads:N"):
            parse_workers(wrong)
