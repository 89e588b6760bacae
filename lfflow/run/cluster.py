"""Tasks on worker processes: a cluster of this machine on the loopback, or one that is already there."""

from __future__ import annotations

import contextlib
import itertools
import logging
import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import dask

from lfflow.run.executors import Report
from lfflow.run.limits import PROCESS
from lfflow.run.task import Work, crashed, lost, perform, thread_environment
from lfflow.run.versions import WorkersError, check_scheduler, check_workers, version_question

_log = logging.getLogger(__name__)
_POLL_SECONDS = 2.0
_CONNECT_SECONDS = 30.0
_STARTS = 5
PATIENCE_SECONDS = 60.0
"""A run whose workers are all gone for so long ends, with what it has."""
QUEUE_SECONDS = 24 * 3600.0
"""A queueing system may take so long to start the first worker."""
LOOPBACK = "127.0.0.1"
SETTINGS = {
    # With the default (15 s), workers that are killed again and again hang a batch for ever.
    "distributed.deploy.lost-worker-timeout": "1h",
    "distributed.scheduler.no-workers-timeout": "60s",
    # One death of a worker is one crash of its task: the coordinator counts.
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    # A worker that is paused because its allocator gave nothing back would never be asked again.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    # Logs of what went to and fro hold the tasks themselves: tens of kilobytes a capture, up to ten thousand times.
    "distributed.admin.log-length": 100,
    "distributed.admin.low-level-log-length": 100,
    # A worker keeps its call stacks of the last hour: tens of megabytes that no task asked for.
    "distributed.worker.profile.enabled": False,
    "distributed.worker.daemon": True,
    "distributed.admin.log-format": "%(name)s - %(levelname)s - %(message)s",
}
TLS_KEYS = ("tls_ca_file", "tls_client_cert", "tls_client_key")


@contextlib.contextmanager
def local_client(count: int, memory: int | None) -> Iterator[Any]:
    """Client of a new cluster of worker processes of one thread each; nothing listens off the loopback.

    `memory` is what one worker may use before it is taken for a crash; None: no bound.
    """
    from distributed import Client

    with (
        dask.config.set(SETTINGS),
        thread_environment(),
        _local_cluster(count, memory or 0) as cluster,
        Client(cluster) as client,
    ):
        _log.info("dashboard: %s", cluster.dashboard_link)
        yield client


def _local_cluster(count: int, memory: int) -> Any:
    """Cluster of this machine; one whose workers die while they start is started again. Raises WorkersError."""
    from distributed import LocalCluster

    for _ in range(_STARTS):
        try:
            return LocalCluster(
                n_workers=count, threads_per_worker=1, processes=True, host=LOOPBACK, memory_limit=memory,
                dashboard_address=f"{LOOPBACK}:0", silence_logs=logging.CRITICAL,
            )  # fmt: skip
        except RuntimeError as error:
            _log.warning("the workers did not start: %s", error)
            reason = str(error)
    raise WorkersError(f"the workers of this machine do not start: {reason}")


@contextlib.contextmanager
def remote_client(address: str, tls: Mapping[str, Any]) -> Iterator[Any]:
    """Client of the scheduler at an address; raises WorkersError when none answers, or one with another lfflow.

    `tls` has paths of PEM files (`TLS_KEYS`); without it, TLS is as dask's own configuration says.
    """
    from distributed import Client, Security

    try:
        security = Security(require_encryption=True, **tls) if tls else None
        client = Client(address, timeout=_CONNECT_SECONDS, security=security)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise WorkersError(f"no scheduler answers at {address}: {error}") from error
    with client:
        _log.info("dashboard: %s", client.dashboard_link)
        check_scheduler(client)
        yield client


@dataclass
class _Batch:
    """The tasks of one run: those that wait, those that fly, and those whose process died and that come again."""

    fresh: Iterator[tuple[Work, int]]
    report: Report
    again: deque[tuple[Work, int]] = field(default_factory=deque)
    last: deque[tuple[Work, int]] = field(default_factory=deque)
    flying: dict[Any, tuple[Work, int]] = field(default_factory=dict)

    def next(self) -> tuple[Work, int] | None:
        """The next task; those whose last attempt it is come alone."""
        found = next(self.fresh, None)
        if found is None and self.again:
            found = self.again.popleft()
        if found is None and self.last and not self.flying:
            found = self.last.popleft()
        return found

    def rest(self) -> Iterator[tuple[Work, int]]:
        return itertools.chain(self.flying.values(), self.again, self.last, self.fresh)


class ClusterExecutor:
    """Keeps as many tasks in flight as fit on the workers, and takes every outcome from statuses or from the ledger.

    A task whose worker dies is tried again `retries` times, the last time alone on the cluster, so that it can neither
    take others with it nor be blamed for them. A run without workers, or without its scheduler, ends with what it has.
    Workers that somebody else started (`elsewhere`) are asked for their version of lfflow as they appear; raises
    WorkersError when it is another.
    """

    def __init__(
        self,
        client: Any,
        in_flight: int | None = None,
        retries: int = 2,
        *,
        memory: int = 0,
        patience: float = PATIENCE_SECONDS,
        elsewhere: bool = False,
    ) -> None:
        self._client = client
        self._limit = in_flight
        self._retries = retries
        self._memory = memory
        self._patience = patience
        self._elsewhere = elsewhere
        self._met: set[str] = set()
        self._seen_at = time.monotonic() + QUEUE_SECONDS - patience
        self._asked_at = -_POLL_SECONDS
        self._room = 0

    def run(self, works: Iterator[Work], report: Report) -> None:
        """Return when all tasks have been reported."""
        batch = _Batch(((work, 0) for work in works), report)
        try:
            self._drain(batch)
        except BaseException:
            with contextlib.suppress(Exception):
                self._client.cancel(list(batch.flying))
            raise

    def _drain(self, batch: _Batch) -> None:
        if self._elsewhere and not self._met:
            self._await_worker()
        while True:
            self._look_at_workers()
            self._submit(batch)
            if not batch.flying:
                return
            self._wait(list(batch.flying))
            for future in [future for future in batch.flying if future.done()]:
                self._collect(future, *batch.flying.pop(future), batch)
            trouble = self._trouble()
            if trouble:
                for work, _ in batch.rest():
                    batch.report(lost(work, trouble))
                return

    def _await_worker(self) -> None:
        """Let the first worker say what it is before it gets a task: a stranger dies of one that it cannot unpack.

        The question is a task itself, for a cluster that grows with its queue has no worker before.
        """
        question = self._client.submit(version_question(), pure=False, retries=10)
        while not question.done() and not self._trouble():
            self._wait([question])
            self._look_at_workers()
        self._meet(self._workers_there())

    def _submit(self, batch: _Batch) -> None:
        while len(batch.flying) < self._room:
            item = batch.next()
            if item is None:
                return
            batch.flying[self._client.submit(perform, item[0], pure=False, retries=0)] = item

    def _look_at_workers(self) -> None:
        """Tasks for which there is room; one or two more on a cluster that grows with its queue."""
        now = time.monotonic()
        if now - self._asked_at < _POLL_SECONDS:
            return
        self._asked_at = now
        there = self._workers_there()
        if there:
            self._seen_at = now
        self._meet(there)
        workers = there.values()
        room = sum(self._fits(worker["nthreads"], worker["memory_limit"]) for worker in workers)
        full = room == sum(worker["nthreads"] for worker in workers)
        self._room = min(room, self._limit) if self._limit else (2 * room if full else room)
        self._room = max(1, self._room)

    def _meet(self, there: Mapping[str, Any]) -> None:
        """Ask the workers that were not seen before for their version; raises WorkersError."""
        strangers = there.keys() - self._met if self._elsewhere else ()
        if strangers:
            self._met.update(check_workers(self._client, strangers))

    def _workers_there(self) -> dict[str, Any]:
        """What the scheduler says of its workers, by address."""
        with contextlib.suppress(OSError, RuntimeError, TimeoutError, AttributeError):
            if self._client.status == "running":
                return dict(self._client.scheduler_info(n_workers=-1)["workers"])
        return {}

    def _fits(self, threads: int, memory: int) -> int:
        if not memory or not self._memory:
            return threads
        return max(1, min(threads, (memory - PROCESS) // self._memory))

    def _trouble(self) -> str:
        """Why there is no point in going on; empty while there is."""
        if self._client.status not in ("running", "connecting"):
            return "the scheduler was lost"
        if time.monotonic() - self._seen_at > self._patience:
            return f"there was no worker for {self._patience:g} s"
        return ""

    @staticmethod
    def _wait(futures: list[Any]) -> None:
        from concurrent.futures import CancelledError

        from distributed import wait

        with contextlib.suppress(TimeoutError, CancelledError):
            wait(futures, timeout=_POLL_SECONDS, return_when="FIRST_COMPLETED")

    def _collect(self, future: Any, work: Work, crashes: int, batch: _Batch) -> None:
        if future.status == "finished":
            with contextlib.suppress(Exception):
                batch.report(future.result(timeout=_CONNECT_SECONDS))
                return
        elif future.status == "error" and (reason := _own_fault(future)):
            batch.report(lost(work, reason))
            return
        # Lost, cancelled or killed: the ledger knows what is done, and the task skips it when it runs again.
        crashes += 1
        _log.warning("the process of %s died", work.job.capture)
        if crashes > self._retries:
            batch.report(crashed(work, f"its process crashed {crashes} times"))
        else:
            (batch.last if crashes == self._retries else batch.again).append((work, crashes))


def _own_fault(future: Any) -> str:
    """What a task could not be sent or started for, such as a worker without lfflow; empty when its worker died."""
    from distributed.scheduler import KilledWorker

    try:
        error = future.exception(timeout=_CONNECT_SECONDS)
    except Exception:  # noqa: BLE001 - a future that is lost says nothing: its task is tried again
        return ""
    return "" if isinstance(error, KilledWorker) else f"the worker cannot run it: {type(error).__name__}: {error}"
