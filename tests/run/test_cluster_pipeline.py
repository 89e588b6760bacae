from __future__ import annotations

from pathlib import Path

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
