"""One task: the steps of one capture, from the raw file to committed regions; returns statuses, never raises."""

from __future__ import annotations

import contextlib
import errno
import functools
import logging
import os
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import dask
import xarray as xr

from lfflow import __version__
from lfflow.collection import Collection
from lfflow.collection.inputs import file_state
from lfflow.collection.leases import lease
from lfflow.collection.records import DAMAGED, DONE, FAILED, Record
from lfflow.collection.storage import explain
from lfflow.errors import CollectionError, FormatError, LfflowError
from lfflow.run.chain import Chain, Stage, StageInput
from lfflow.run.darks import Dark
from lfflow.run.pictures import draw, picture_name
from lfflow.run.plan import BLOCKED, FAILED_BEFORE, SKIP, Job, Step
from lfflow.run.versions import WorkersError, versions

_log = logging.getLogger(__name__)
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


class BlockedError(CollectionError):
    """A stage cannot run because what it needs is not there."""


class NotWrittenError(CollectionError):
    """A result could not be written; `errno` is that of the operating system."""

    def __init__(self, error: OSError) -> None:
        super().__init__(str(explain(error)))
        self.errno = error.errno


@dataclass(frozen=True, slots=True)
class Work:
    """Everything that a worker needs for one task; small, so that nothing big passes the client."""

    url: str
    chain: Chain
    job: Job
    pictures: bool = True
    threads: int = 1
    version: str = __version__


@dataclass(frozen=True, slots=True)
class Status:
    """What became of one (stage, capture): "done", "kept", "failed" or "blocked".

    With `halts`, no other capture would fare better: the disk is full or read-only.
    """

    stage: str
    capture: str
    state: str
    reason: str = ""
    seconds: float = 0.0
    halts: bool = False


def perform(work: Work) -> tuple[Status, ...]:
    """Run the steps of one capture one after the other; the first that fails blocks the rest.

    Raises WorkersError in a process that has another lfflow than the one that sent the work.
    """
    if work.version != __version__:
        raise WorkersError(f"this worker runs lfflow {__version__}, the run lfflow {work.version}")
    _single_threaded_libraries()
    frame = _Frame(work.chain, work.job)
    statuses: list[Status] = []
    try:
        collection = Collection(work.url)
        with dask.config.set(scheduler="synchronous"):
            for step in work.job.steps:
                statuses.append(_perform_step(collection, work, step, frame, statuses))
            if work.pictures:
                _draw(collection, work, statuses)
    except Exception as error:  # noqa: BLE001 - a task never raises: its outcome is a status
        done = {status.stage for status in statuses}
        reason = _reason(error)
        halts = _halts(error)
        statuses += [
            Status(s.stage, s.capture, "failed", reason, halts=halts) for s in work.job.steps if s.stage not in done
        ]
    return tuple(statuses)


def crashed(work: Work, reason: str) -> tuple[Status, ...]:
    """Record, for a task that cannot do so itself, that its process crashed; what it had finished stays."""
    collection = Collection(work.url)
    statuses: list[Status] = []
    for step in work.job.steps:
        record = collection.ledger.find(step.stage, step.capture)
        if record is not None and record.fingerprint == step.fingerprint:
            statuses.append(Status(step.stage, step.capture, "kept"))
            continue
        blocked = any(status.state == "failed" for status in statuses)
        if not blocked:
            _record_failure(collection, work.job, step, CollectionError(reason))
        statuses.append(Status(step.stage, step.capture, "blocked" if blocked else "failed", reason))
    return tuple(statuses)


def lost(work: Work, reason: str) -> tuple[Status, ...]:
    """Statuses of a task that did not come back: what it had finished stays, the rest is for the next run."""
    ledger = Collection(work.url).ledger
    statuses = []
    for step in work.job.steps:
        record = ledger.find(step.stage, step.capture)
        done = record is not None and record.fingerprint == step.fingerprint
        statuses.append(Status(step.stage, step.capture, "kept" if done else "failed", "" if done else reason))
    return tuple(statuses)


class _Frame:
    """The raw frame of a job, read once, when the first stage asks for it, and the dark images of its camera.

    `damaged` says what is wrong with the files read so far although they were accepted.
    """

    def __init__(self, chain: Chain, job: Job) -> None:
        self._chain, self._job = chain, job
        self.damaged: dict[str, str] = {}

    @functools.cached_property
    def raw(self) -> xr.Dataset:
        job = self._job
        return self._read(job).assign_coords(capture=job.capture, kind=job.kind)

    def darks(self) -> Iterator[xr.Dataset]:
        """Dark images of the camera, one in memory at a time."""
        for dark in self._job.darks:
            yield self._read(dark)

    def _read(self, file: Job | Dark) -> xr.Dataset:
        if file_state(file.path) != (file.size, file.mtime_ns):
            raise CollectionError(f"{file.path} has changed since it was scanned")
        with self._chain.open_raw(file.path) as raw:
            if raw.attrs.get("damaged"):
                self.damaged[file.path] = str(raw.attrs["damaged"])
            return raw.load()


def _perform_step(collection: Collection, work: Work, step: Step, frame: _Frame, before: list[Status]) -> Status:
    if step.action in (FAILED_BEFORE, BLOCKED):
        return Status(step.stage, step.capture, "failed" if step.action == FAILED_BEFORE else "blocked", step.why)
    if step.action == SKIP:
        return Status(step.stage, step.capture, "kept")
    lost = next((s for s in before if s.state in ("failed", "blocked")), None)
    if lost is not None:
        return Status(step.stage, step.capture, "blocked", f"its {lost.stage} has failed")
    started = time.perf_counter()
    stage = work.chain[step.stage]
    with lease(collection.storage, step.stage, step.capture):
        record = collection.ledger.find(step.stage, step.capture)
        if step.why != "forced" and record is not None and record.fingerprint == step.fingerprint:
            return Status(step.stage, step.capture, "kept")
        try:
            _commit(collection, work, stage, step, frame, started)
        except Exception as error:  # noqa: BLE001 - whatever goes wrong is this capture's failure and no one else's
            _log.debug("%s of %s", step.stage, step.capture, exc_info=True)
            _record_failure(collection, work.job, step, error)
            seconds = time.perf_counter() - started
            return Status(step.stage, step.capture, "failed", _reason(error), seconds, _halts(error))
    return Status(step.stage, step.capture, "done", seconds=time.perf_counter() - started)


def _commit(collection: Collection, work: Work, stage: Stage, step: Step, frame: _Frame, started: float) -> None:
    """Compute, write the region, flush it, write the record: in this order, under the lease."""
    job, threads = work.job, work.threads
    raw = frame.raw if stage.reads_raw else None
    darks = frame.darks() if stage.uses_darks else ()
    before = {name: _upstream(collection, name, *wanted) for name, wanted in step.upstream.items()}
    missing = [name for name in stage.upstream if name not in before]
    if missing:
        raise BlockedError(f"{stage.name} of {job.capture} has no {missing[0]}")
    results = {name: result for name, (_, result) in before.items()}
    result = stage.function(StageInput(raw, results, job.grid, step.parameters, threads, darks))
    result = stage.schema.check(result.compute(), f"result of {stage.name} of {job.capture}")
    with _writing():
        store = collection.store(stage.name)
        collection.ledger.remove(stage.name, job.capture)
        files = store.write(job.group, step.slot, result, threads)
        collection.ledger.write(Record(
            stage.name, job.capture, DONE, step.fingerprint,
            source={"path": job.path, "sha256": job.sha256},
            group=job.group, slot=step.slot, files=files, scalars=store.scalars(result),
            parameters={name: dict(table) for name, table in step.parameters.items()},
            upstream={name: mark for name, (_, mark) in step.upstream.items()},
            versions=versions(), finished=datetime.now(UTC).isoformat(timespec="seconds"),
            seconds=round(time.perf_counter() - started, 3),
            damaged={**_damage(record for record, _ in before.values()), **frame.damaged},
        ))  # fmt: skip


def _damage(records: Iterable[Record]) -> dict[str, str]:
    """What is wrong with the files that results were made of."""
    return {file: words for record in records for file, words in record.damaged.items()}


def _upstream(collection: Collection, stage: str, capture: str, mark: str) -> tuple[Record, xr.Dataset]:
    """Record and result of a stage before, as on the disk: the same bits whether this run made it or an earlier one."""
    record = collection.ledger.find(stage, capture)
    if record is None or record.fingerprint != mark:
        raise BlockedError(f"the {stage} of {capture} is not there")
    try:
        return record, collection.store(stage).read(record)
    except Exception as error:
        collection.ledger.move(record, DAMAGED)
        raise CollectionError(f"the {stage} of {capture} is damaged ({error}); the next run makes it anew") from error


def _record_failure(collection: Collection, job: Job, step: Step, error: Exception) -> None:
    transient = isinstance(error, OSError | MemoryError | CollectionError) and not isinstance(error, FormatError)
    with contextlib.suppress(OSError):
        collection.ledger.write(Record(
            step.stage, job.capture, FAILED, step.fingerprint, source={"path": job.path, "sha256": job.sha256},
            group=job.group, versions=versions(), finished=datetime.now(UTC).isoformat(timespec="seconds"),
            reason=_reason(error), transient=transient,
        ))  # fmt: skip


@contextlib.contextmanager
def _writing() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NotWrittenError(error) from error


def _halts(error: Exception) -> bool:
    return isinstance(error, OSError | NotWrittenError) and error.errno in _NO_ROOM


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename and error.errno not in _NO_ROOM:
        return f"{error.strerror}: {error.filename}"
    if isinstance(error, OSError):
        return str(explain(error))
    return str(error) if isinstance(error, LfflowError) else f"{type(error).__name__}: {error}"


def _draw(collection: Collection, work: Work, statuses: list[Status]) -> None:
    """Draw the capture when its disparity is new or its picture is missing; a picture that fails loses nothing."""
    last = statuses[-1] if statuses else None
    if work.chain.draw is None or last is None or last.stage != "disparity" or last.state not in ("done", "kept"):
        return
    try:
        if last.state == "done" or not collection.storage.has(picture_name(work.job.capture)):
            draw(collection, work.job.capture, work.chain, work.threads)
    except Exception as error:  # noqa: BLE001 - see the docstring
        _log.warning("no picture of %s: %s", work.job.capture, error)


@functools.cache
def _single_threaded_libraries() -> None:
    """Stop OpenCV and BLAS from making threads of their own: the work is parallel over captures."""
    import cv2
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(1)
    threadpool_limits(1)


@contextlib.contextmanager
def thread_environment() -> Iterator[None]:
    """Environment for worker processes: one thread for every numeric library."""
    names = (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
    )
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
