from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from fake_chain import FAKE

from lfflow import __version__
from lfflow.collection import open_collection
from lfflow.run.versions import WorkersError


def test_the_cluster_program_runs_on_two_worker_processes(tmp_path, captures, monkeypatch):
    root = Path(__file__).parents[2]
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    monkeypatch.syspath_prepend(root)
    from pipelines.cluster import by_hand, run_on

    with by_hand(2) as address:
        outcome = run_on(address, captures, tmp_path / "col", FAKE)
    assert outcome.counts == {"done": 7}
    assert open_collection(tmp_path / "col").open("disparity").sizes["capture"] == 3


@contextmanager
def worker_of_another_version(address, folder):
    """A worker process with an lfflow 0.0.1."""
    (folder / "lfflow").mkdir(parents=True)
    (folder / "lfflow" / "__init__.py").write_text('__version__ = "0.0.1"')
    command = [sys.executable, "-m", "dask", "worker", address, "--nthreads", "1", "--host", "127.0.0.1"]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    with subprocess.Popen(command, env=environment, cwd=folder, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


def test_workers_and_schedulers_of_another_version_are_refused_by_name(tmp_path, captures, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    from pipelines.cluster import by_hand, run_on

    both = rf"at tcp://\S+ runs lfflow {{}}, this is lfflow {re.escape(__version__)}"
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    words = "the worker " + both.format(r"0\.0\.1")
    with (
        by_hand(0) as address,
        worker_of_another_version(address, tmp_path / "older"),
        pytest.raises(WorkersError, match=words),
    ):
        run_on(address, captures, tmp_path / "col", FAKE)
    assert open_collection(tmp_path / "col").status()["stages"]["calibration"] == {"pending": 1}
    (tmp_path / "older" / "lfflow" / "__init__.py").write_text("raise ImportError")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "older"))
    monkeypatch.chdir(tmp_path)
    with by_hand(0) as address, pytest.raises(WorkersError, match="the scheduler " + both.format("none")):
        run_on(address, captures, tmp_path / "col", FAKE)


@pytest.mark.heavy
def test_the_cluster_program_runs_as_jobs_of_a_queue(tmp_path, captures, monkeypatch):
    """The commands of Slurm are stand-ins that run a job's script on this machine."""
    pytest.importorskip("dask_jobqueue", reason="needs dask-jobqueue")
    tools = tmp_path / "bin"
    tools.mkdir()
    for name, text in {
        "sbatch": 'bash "$1" > /dev/null 2>&1 & echo "$!" >> "$JOBS"; echo "Submitted batch job $!"',
        "scancel": 'for job in "$@"; do kill "$job"; done',
    }.items():
        (tools / name).write_text(f"#!/bin/sh\n{text}\n")
        (tools / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}:{os.environ['PATH']}")
    monkeypatch.setenv("JOBS", str(tmp_path / "jobs"))
    root = Path(__file__).parents[2]
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    monkeypatch.syspath_prepend(root)
    from pipelines.cluster import by_slurm, run_on

    with by_slurm(2) as address:
        outcome = run_on(address, captures, tmp_path / "col", FAKE)
    assert outcome.counts == {"done": 7}
    assert (tmp_path / "jobs").read_text().strip()
