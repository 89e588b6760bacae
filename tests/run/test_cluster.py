"""Processes and clusters: the same bits as one thread, over TLS too, and small messages only."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import cloudpickle
import dask
import numpy as np
import pytest
from distributed import LocalCluster, Security
from distributed.scheduler import KilledWorker
from fake_chain import FAKE, write_capture
from fake_stores import store_content
from fault_tools import run

from lfflow.collection import open_collection
from lfflow.run import cluster as cluster_module
from lfflow.run import make_plan
from lfflow.run.chain import CHAIN
from lfflow.run.config import ConfigError, check_config
from lfflow.run.executors import Workers, parse_workers
from lfflow.run.options import Options
from lfflow.run.task import Work
from lfflow.run.versions import WorkersError

HERE = str(Path(__file__).parent)


@pytest.fixture(autouse=True)
def _importable_by_workers(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", HERE)


def test_threads_processes_and_a_cluster_give_the_bits_of_one_thread(tmp_path, captures, caplog):
    run(tmp_path / "one", captures, workers=Workers("threads", 1))
    expected = store_content(tmp_path / "one")
    run(tmp_path / "many", captures, workers=Workers("threads", 5))
    assert store_content(tmp_path / "many") == expected
    with caplog.at_level("INFO", "lfflow.run"):
        assert run(tmp_path / "two", captures, workers=Workers("processes", 2)).counts == {"done": 7}
    assert "dashboard: http://127.0.0.1:" in caplog.text
    assert store_content(tmp_path / "two") == expected
    with LocalCluster(n_workers=1, threads_per_worker=3, host="127.0.0.1", dashboard_address="127.0.0.1:0") as cluster:
        workers = Workers("cluster", address=cluster.scheduler_address)
        assert run(tmp_path / "tcp", captures, workers=workers).exit_code == 0
    assert store_content(tmp_path / "tcp") == expected


def test_what_is_read_does_not_depend_on_the_scheduler(tmp_path, captures):
    run(tmp_path / "col", captures)
    ds = open_collection(tmp_path / "col").open("disparity")["disparity"]
    means = []
    for scheduler in ("sync", "threads"):
        with dask.config.set(scheduler=scheduler):
            means.append(ds.mean("capture").values)
    assert np.array_equal(*means, equal_nan=True)


@pytest.fixture
def certificate(tmp_path):
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("no openssl to make a certificate with")
    files = {"tls_ca_file": tmp_path / "cert.pem", "tls_client_cert": tmp_path / "cert.pem",
             "tls_client_key": tmp_path / "key.pem"}  # fmt: skip
    command = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    subprocess.run([*command, "-keyout", str(tmp_path / "key.pem"), "-out", str(tmp_path / "cert.pem")],
                   check=True, capture_output=True)  # fmt: skip
    return {name: str(path) for name, path in files.items()}


def test_a_cluster_behind_tls_takes_who_has_the_keys(tmp_path, captures, certificate, monkeypatch):
    pem = {"tls_ca_file": certificate["tls_ca_file"]}
    for role in ("scheduler", "worker", "client"):
        pem |= {f"tls_{role}_cert": certificate["tls_client_cert"], f"tls_{role}_key": certificate["tls_client_key"]}
    security = Security(require_encryption=True, **pem)
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tls://", host="127.0.0.1", security=security,
        dashboard_address="127.0.0.1:0",
    ) as cluster:  # fmt: skip
        assert cluster.scheduler_address.startswith("tls://")
        workers = Workers("cluster", address=cluster.scheduler_address)
        outcome = run(tmp_path / "col", captures, workers=workers, config={"cluster": certificate})
        assert outcome.counts == {"done": 7}
        monkeypatch.setattr(cluster_module, "_CONNECT_SECONDS", 1.0)
        with pytest.raises(WorkersError, match="no scheduler answers at tls://"):
            run(tmp_path / "other", captures, workers=workers)


def test_the_cluster_table_is_checked_and_changes_no_result(tmp_path, captures):
    assert check_config({"cluster": {"patience": 5}}, FAKE) == {"cluster": {"patience": 5}}
    with pytest.raises(ConfigError, match=r"\[cluster\] has no key 'tls'; there are tls_ca_file"):
        check_config({"cluster": {"tls": "x"}}, FAKE)
    run(tmp_path / "col", captures)
    assert run(tmp_path / "col", captures, config={"cluster": {"patience": 5}}).counts == {"kept": 7}


class Erred:
    def __init__(self, error):
        self._error = error

    def exception(self, timeout):  # noqa: ARG002 - as the futures of distributed have it
        return self._error


def test_a_worker_that_cannot_run_the_chain_is_told_from_one_that_died():
    fault = cluster_module._own_fault(Erred(ModuleNotFoundError("No module named 'lfflow'")))
    assert fault == "the worker cannot run it: ModuleNotFoundError: No module named 'lfflow'"
    assert cluster_module._own_fault(Erred(KilledWorker("task", None, 0))) == ""


def test_nothing_big_passes_the_client(tmp_path, captures):
    for number in range(20):
        write_capture(captures / f"MORE_{number}.lfp", seed=100 + number)
    run(tmp_path / "col", captures)
    jobs = make_plan(tmp_path / "col", Options(force=True), FAKE)
    for chain in (FAKE, CHAIN):
        sizes = [len(cloudpickle.dumps(Work(str(tmp_path / "col"), chain, job))) for job in jobs]
        assert max(sizes) < 20_000
    stored = [path for path in (tmp_path / "col").rglob("*") if path.is_file()]
    assert not [path for path in stored if path.read_bytes()[:1] == b"\x80" and path.suffix in ("", ".json", ".pkl")
                and ".zarr" not in str(path)]  # fmt: skip


def test_workers_are_said_in_words():
    assert parse_workers("processes:3") == Workers("processes", 3)
    assert parse_workers("tls://h:1") == Workers("cluster", address="tls://h:1")
    for wrong in ("threads:0", "many", "processes:x"):
        with pytest.raises(WorkersError, match="threads:N"):
            parse_workers(wrong)
