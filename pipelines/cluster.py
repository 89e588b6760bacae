"""The batch on a cluster: workers started by hand, or by a queueing system.

    python -m pipelines.cluster CAPTURES COLLECTION --workers 2            # scheduler and workers on this machine
    python -m pipelines.cluster CAPTURES COLLECTION --slurm 40             # as jobs of a queue (needs dask-jobqueue)

By hand over several machines (the raw files and the collection on a file system that all of them see):

    dask scheduler --host 127.0.0.1 --scheduler-file cluster.json          # remote workers: --protocol tls and keys
    dask worker --scheduler-file cluster.json --nthreads 1 --memory-limit 4GiB
    lfflow run CAPTURES --out COLLECTION --workers tcp://127.0.0.1:8786

The scheduler's port executes what it is sent: keep it on the loopback or behind TLS.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from lfflow.run import Options, Outcome, run_collection
from lfflow.run.chain import CHAIN, Chain
from lfflow.run.executors import Workers

ENVIRONMENT = {
    "DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT": "1h",
    "DASK_DISTRIBUTED__SCHEDULER__NO_WORKERS_TIMEOUT": "60s",
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
    "DASK_DISTRIBUTED__ADMIN__LOG_LENGTH": "100",
    "DASK_DISTRIBUTED__ADMIN__LOW_LEVEL_LOG_LENGTH": "100",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}


@contextmanager
def by_hand(workers: int, memory: str = "4GiB") -> Iterator[str]:
    """Address of a scheduler with workers of one thread each, all processes of this machine on the loopback."""
    with ExitStack() as stack:
        file = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "cluster.json"
        common = ["--host", "127.0.0.1", "--scheduler-file", str(file)]
        stack.enter_context(_process("scheduler", *common, "--port", "0", "--no-dashboard"))
        while not file.exists():
            time.sleep(0.1)
        for _ in range(workers):
            stack.enter_context(
                _process("worker", *common, "--nthreads", "1", "--memory-limit", memory, "--no-dashboard")
            )
        yield json.loads(file.read_text())["address"]


@contextmanager
def _process(*command: str) -> Iterator[None]:
    program = [sys.executable, "-m", "dask", *command]
    with subprocess.Popen(program, env=os.environ | ENVIRONMENT, stderr=subprocess.DEVNULL) as process:  # noqa: S603
        try:
            yield
        finally:
            process.terminate()


@contextmanager
def by_slurm(jobs: int) -> Iterator[str]:
    """Address of a scheduler whose workers are jobs of a Slurm queue; the other queues of dask-jobqueue work alike."""
    from dask_jobqueue import SLURMCluster

    prologue = [f"export {name}={value}" for name, value in ENVIRONMENT.items()]
    with SLURMCluster(
        cores=1, processes=1, memory="4GiB", walltime="12:00:00", job_script_prologue=prologue
    ) as cluster:
        cluster.adapt(minimum_jobs=1, maximum_jobs=jobs)
        yield cluster.scheduler_address


def run_on(address: str, captures: Path, out: Path, chain: Chain = CHAIN) -> Outcome:
    """Run the batch on the scheduler at an address."""
    return run_collection(out, Options(inputs=(captures,), workers=Workers("cluster", address=address)), chain)


def main() -> int:
    """Run the command line above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--workers", type=int, default=2, help="worker processes on this machine")
    parser.add_argument("--slurm", type=int, default=0, help="jobs of a Slurm queue instead")
    given = parser.parse_args()
    with by_slurm(given.slurm) if given.slurm else by_hand(given.workers) as address:
        outcome = run_on(address, given.captures, given.out)
    print(outcome.counts)
    for capture, reason in outcome.failed.items():
        print(f"{capture}\tfailed: {reason}", file=sys.stderr)
    return outcome.exit_code


if __name__ == "__main__":
    sys.exit(main())
