"""Where the tasks run: dask's threads, processes of this machine, or a cluster that is already there."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import dask.threaded

from lfflow.run.task import Status, Work, perform
from lfflow.run.versions import WorkersError

_log = logging.getLogger(__name__)
Report = Callable[[tuple[Status, ...]], None]
_LAST_SECONDS = 600.0


class Executor(Protocol):
    """Runs tasks, a bounded number at a time, and reports the statuses of each."""

    def run(self, works: Iterator[Work], report: Report) -> None:
        """Return when all tasks have been reported."""


@dataclass(frozen=True, slots=True)
class Workers:
    """What ``--workers`` asks for: kind "threads", "processes" or "cluster"; a count, or the scheduler's address."""

    kind: str
    count: int = 1
    address: str = ""


def parse_workers(text: str) -> Workers:
    """Workers from ``threads:N``, ``processes:N``, ``tcp://…`` or ``tls://…``; raises WorkersError."""
    if text.startswith(("tcp://", "tls://")):
        return Workers("cluster", address=text)
    kind, _, number = text.partition(":")
    count = number or str(os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count() or 1)
    if kind not in ("threads", "processes") or not count.isdigit() or int(count) < 1:
        raise WorkersError(f"no such workers: {text!r}; say threads:N, processes:N, tcp://HOST:PORT or tls://HOST:PORT")
    return Workers(kind, int(count))


class ThreadExecutor:
    """Dask's threaded scheduler: each thread takes the next task when it is free, so that the graph stays as small as
    the number of threads however many captures there are.
    """  # noqa: D205

    def __init__(self, count: int) -> None:
        self._count = count

    def run(self, works: Iterator[Work], report: Report) -> None:
        """Return when all tasks have been reported; when interrupted, as soon as those at work are."""
        guard, stop, idle = threading.Lock(), threading.Event(), threading.Semaphore(0)

        def lane(_: int) -> None:
            try:
                while not stop.is_set():
                    with guard:
                        work = next(works, None)
                    if work is None:
                        return
                    statuses = perform(work)
                    with guard:
                        report(statuses)
            finally:
                idle.release()

        graph = {("lane", number): (lane, number) for number in range(self._count)}
        try:
            dask.threaded.get(graph, list(graph), num_workers=self._count)
        except BaseException:
            stop.set()
            for _ in range(self._count):
                idle.acquire(timeout=_LAST_SECONDS)
            raise
