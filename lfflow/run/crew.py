"""Who does the work of a run: how many at a time, on which executor, and when there is no point in going on."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

from lfflow.collection import Collection
from lfflow.collection.leases import abandoned
from lfflow.collection.object_lease import Tenure
from lfflow.run.chain import Chain
from lfflow.run.config import CLUSTER
from lfflow.run.executors import Executor, Report, ThreadExecutor
from lfflow.run.limits import PROCESS, in_flight, room
from lfflow.run.options import Options
from lfflow.run.plan import Job
from lfflow.run.task import Status, Work, lost

_log = logging.getLogger(__name__)
DEATHS = 2
"""A capture whose process died so often in a row is worked on in a process of its own."""
_MARGIN = 1.5
"""A worker process that uses so much more than its estimate is taken for one that runs away."""


class Crew:
    """Executors that are made when they are first needed and closed with this.

    Parameters
    ----------
    collection, options, chain
        Of the run.
    memory
        Bytes of the task that needs most.
    tenure
        The lease of the run; when it is lost, nothing more is begun.
    """

    def __init__(self, collection: Collection, options: Options, chain: Chain, memory: int, tenure: Tenure) -> None:
        self._collection, self._options, self._chain = collection, options, chain
        self._memory, self._tenure = memory, tenure
        self._stack = contextlib.ExitStack()
        self._client: Any = None
        self._halted = ""
        workers = options.workers
        elsewhere = workers.kind == "cluster"
        self.lanes = None if elsewhere else in_flight(memory, workers.kind, workers.count, options.memory)
        self._deaths = abandoned(collection.storage) if workers.kind == "threads" else {}

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:  # fmt: skip
        self._stack.__exit__(kind, error, trace)

    @property
    def halted(self) -> str:
        """Why the rest was not tried; empty while there is no reason."""
        return "another run has taken the collection over" if self._tenure.lost else self._halted

    def run(self, jobs: list[Job], report: Report) -> None:
        """Run all jobs and report each; what is not begun any more is reported as failed."""
        suspects = [job for job in jobs if self._deaths.get(job.capture, 0) >= DEATHS]
        suspected = {job.capture for job in suspects}
        self._run(self._executor(), [job for job in jobs if job.capture not in suspected], report)
        if suspects:
            _log.warning("%s took the process down before: each alone now", ", ".join(sorted(suspected)))
            with self._alone() as executor:
                self._run(executor, suspects, report)

    def _run(self, executor: Callable[[], Executor], jobs: list[Job], report: Report) -> None:
        if not jobs:
            return
        threads = max(1, (self.lanes or 1) // len(jobs)) if self._options.workers.kind == "threads" else 1
        url, pictures = self._collection.storage.url, self._options.pictures
        pending = (Work(url, self._chain, job, pictures, threads) for job in jobs)

        def works() -> Iterator[Work]:
            while not self.halted and (work := next(pending, None)) is not None:
                yield work

        def watch(statuses: tuple[Status, ...]) -> None:
            self._halted = self._halted or next((status.reason for status in statuses if status.halts), "")
            report(statuses)

        executor().run(works(), watch)
        for work in pending:
            report(lost(work, f"not tried: {self.halted}"))

    def _executor(self) -> Callable[[], Executor]:
        workers, lanes = self._options.workers, self.lanes
        if workers.kind == "threads":
            return lambda: ThreadExecutor(lanes or 1)
        return self._cluster

    def _cluster(self) -> Executor:
        from lfflow.run.cluster import PATIENCE_SECONDS, ClusterExecutor, local_client, remote_client

        options = self._options
        told = dict(options.config.get(CLUSTER, {}))
        patience = float(told.pop("patience", PATIENCE_SECONDS))
        here = options.workers.kind == "processes"
        if self._client is None:
            manager = local_client(self.lanes or 1, self._bound()) if here else remote_client(
                options.workers.address, told)  # fmt: skip
            self._client = self._stack.enter_context(manager)
        return ClusterExecutor(
            self._client, self.lanes, options.retries, memory=self._memory, patience=patience, elsewhere=not here
        )

    def _bound(self) -> int:
        """What one worker process of this machine may use: its share, and at least what its task is known to need."""
        share = room(self._options.memory) // (self.lanes or 1)
        return max(share, round(_MARGIN * (PROCESS + self._memory)))

    @contextlib.contextmanager
    def _alone(self) -> Iterator[Callable[[], Executor]]:
        from lfflow.run.cluster import ClusterExecutor, local_client

        with local_client(1, None) as client:
            yield lambda: ClusterExecutor(client, 1, self._options.retries)
