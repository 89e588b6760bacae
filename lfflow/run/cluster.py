"""Tasks on worker processes: a cluster of this machine on the loopback, or one that is already there."""

from __future__ import annotations

import contextlib
import logging
from collections import deque
from collections.abc import Iterator
from typing import Any

import dask

from lfflow.run.executors import Report, WorkersError
from lfflow.run.task import Status, Work, crashed, perform, thread_environment

_log = logging.getLogger(__name__)
_POLL_SECONDS = 2.0
_CONNECT_SECONDS = 30.0
LOOPBACK = "127.0.0.1"
SETTINGS = {
    # With the default (15 s), workers that are killed again and again hang a batch for ever.
    "distributed.deploy.lost-worker-timeout": "1h",
    "distributed.scheduler.no-workers-timeout": "60s",
    # One death of a worker is one crash of its task: the coordinator counts, and tries a crasher again alone.
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.daemon": True,
    "distributed.admin.log-format": "%(name)s - %(levelname)s - %(message)s",
}


@contextlib.contextmanager
def local_client(count: int, memory: int | None) -> Iterator[Any]:
    """Client of a new cluster of worker processes of one thread each; nothing listens off the loopback."""
    from distributed import Client, LocalCluster

    with dask.config.set(SETTINGS), thread_environment():
        limit = memory // count if memory else "auto"
        with (
            LocalCluster(
                n_workers=count, threads_per_worker=1, processes=True, host=LOOPBACK, memory_limit=limit,
                dashboard_address=f"{LOOPBACK}:0", silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster) as client,
        ):  # fmt: skip
            _log.info("dashboard: %s", cluster.dashboard_link)
            yield client


@contextlib.contextmanager
def remote_client(address: str) -> Iterator[Any]:
    """Client of the scheduler at an address; TLS as dask's own configuration says. Raises WorkersError."""
    from distributed import Client

    try:
        client = Client(address, timeout=_CONNECT_SECONDS)
    except (OSError, ValueError, TypeError) as error:
        raise WorkersError(f"no scheduler answers at {address}: {error}") from error
    with client:
        yield client


class ClusterExecutor:
    """Keeps as many tasks in flight as there are threads, and takes every outcome from statuses or from the ledger.

    A task whose worker dies is tried again, `retries` times, each time alone on the cluster, so that it cannot take
    others with it and cannot be blamed for them.
    """

    def __init__(self, client: Any, in_flight: int | None = None, retries: int = 2) -> None:
        self._client = client
        self._limit = in_flight
        self._retries = retries

    def run(self, works: Iterator[Work], report: Report) -> None:
        """Return when all tasks have been reported."""
        suspects: deque[tuple[Work, int]] = deque()
        self._drain(works, report, suspects)
        while suspects:
            work, crashes = suspects.popleft()
            if crashes > self._retries:
                report(crashed(work, f"its process crashed {crashes} times"))
                continue
            again: deque[tuple[Work, int]] = deque()
            self._drain(iter((work,)), report, again)
            suspects.extend((suspect, crashes + 1) for suspect, _ in again)

    def _drain(self, works: Iterator[Work], report: Report, suspects: deque[tuple[Work, int]]) -> None:
        """Run all tasks once; those whose process died are added to the suspects."""
        flying: dict[Any, Work] = {}
        exhausted = False
        while flying or not exhausted:
            while not exhausted and len(flying) < self._threads():
                work = next(works, None)
                if work is None:
                    exhausted = True
                else:
                    flying[self._client.submit(perform, work, pure=False, retries=0)] = work
            if not flying:
                continue
            self._wait(list(flying))
            for future in [future for future in flying if future.done()]:
                self._collect(future, flying.pop(future), report, suspects)
            if self._lost():
                for work in [*flying.values(), *works]:
                    report(
                        tuple(Status(s.stage, s.capture, "failed", "the scheduler was lost") for s in work.job.steps)
                    )
                return

    def _threads(self) -> int:
        threads = sum(self._client.nthreads().values()) if not self._lost() else 1
        return max(1, min(threads, self._limit) if self._limit else threads)

    def _lost(self) -> bool:
        return bool(self._client.status != "running")

    @staticmethod
    def _wait(futures: list[Any]) -> None:
        from distributed import wait

        with contextlib.suppress(TimeoutError):
            wait(futures, timeout=_POLL_SECONDS, return_when="FIRST_COMPLETED")

    def _collect(self, future: Any, work: Work, report: Report, suspects: deque[tuple[Work, int]]) -> None:
        if future.status == "finished":
            with contextlib.suppress(Exception):
                report(future.result(timeout=_CONNECT_SECONDS))
                return
        # Lost, cancelled or killed: the ledger knows what is done, and the task skips it when it runs again.
        _log.warning("the process of %s died", work.job.capture)
        suspects.append((work, 1))
