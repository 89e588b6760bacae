from __future__ import annotations

import os
from pathlib import Path

import pytest
from fake_chain import FAKE

from lfflow.collection import open_collection


def test_the_cluster_program_runs_on_two_worker_processes(tmp_path, captures, monkeypatch):
    root = Path(__file__).parents[2]
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    monkeypatch.syspath_prepend(root)
    from pipelines.cluster import by_hand, run_on

    with by_hand(2) as address:
        outcome = run_on(address, captures, tmp_path / "col", FAKE)
    assert outcome.counts == {"done": 7}
    assert open_collection(tmp_path / "col").open("disparity").sizes["capture"] == 3


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
