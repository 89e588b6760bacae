"""The coordinator of a run: scan, choose white images, plan, let the tasks run, bring the stores up to date."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

from lfflow.collection import Collection, catalogue
from lfflow.collection.collection import select
from lfflow.collection.leases import run_lease
from lfflow.collection.storage import explain
from lfflow.collection.update import update
from lfflow.collection.whites import MAX_STEPS, choose
from lfflow.run.chain import CHAIN, Chain, Grid, Parameters, camera_grid, lattice_grid
from lfflow.run.config import WHITES
from lfflow.run.executors import Executor, ThreadExecutor, Workers
from lfflow.run.limits import in_flight, task_memory
from lfflow.run.plan import BLOCKED, FAILED_BEFORE, RUN, Job, Planner, Request, Step
from lfflow.run.task import Status, Work

_MANY = 1 << 20
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True)
class Options:
    """What a run is asked to do.

    Parameters
    ----------
    inputs
        Files, folders and globs; none: the files that the catalogue knows.
    white, dark
        Files that are white or dark images whatever their metadata say.
    config
        Tables of keyword arguments per stage.
    stages
        Stages to work on; none: all.
    where
        Expression over the catalogue that selects captures.
    force
        Redo what is done.
    retries
        How often a task that crashes its process is tried again.
    memory
        Bytes that all tasks together may use; None: what the machine has free.
    pictures
        Draw a quicklook of every finished capture.
    accept_damaged
        Take files whose checksums are wrong.
    """

    inputs: Sequence[str | Path] = ()
    white: Sequence[str | Path] = ()
    dark: Sequence[str | Path] = ()
    config: Parameters = field(default_factory=dict)
    workers: Workers = field(default_factory=lambda: Workers("threads", os.cpu_count() or 1))
    stages: tuple[str, ...] = ()
    where: str = ""
    force: bool = False
    retries: int = 2
    memory: int | None = None
    pictures: bool = True
    accept_damaged: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run has done: counts of (stage, capture) by state, and the captures that failed with their reasons."""

    counts: dict[str, int]
    failed: dict[str, str]

    @property
    def exit_code(self) -> int:
        """0, or 2 when some captures failed."""
        return 2 if self.failed else 0


def scan_collection(out: str | os.PathLike[str], options: Options, chain: Chain = CHAIN) -> pd.DataFrame:
    """Bring the catalogue up to date with the input files; returns it."""
    collection = Collection(out)
    chain = chain.accepting_damage() if options.accept_damaged else chain
    with run_lease(collection.storage):
        return _scan(collection, options, chain)


def run_collection(
    out: str | os.PathLike[str], options: Options, chain: Chain = CHAIN, progress: Progress | None = None
) -> Outcome:
    """Do what is missing in a collection; raises CollectionError when another run holds it or it cannot be written."""
    collection = Collection(out)
    chain = chain.accepting_damage() if options.accept_damaged else chain
    try:
        with run_lease(collection.storage):
            return _Run(collection, options, chain, progress).outcome()
    except OSError as error:
        raise explain(error) from error


def make_plan(out: str | os.PathLike[str], options: Options, chain: Chain = CHAIN) -> list[Job]:
    """Jobs that a run would go through, with what each step would do and why."""
    collection = Collection(out)
    run = _Run(collection, options, chain, None)
    return [*run.planner().jobs(kind="white"), *run.planner().jobs(kind="scene")]


def _scan(collection: Collection, options: Options, chain: Chain) -> pd.DataFrame:
    table = update(
        collection, chain.open_raw, options.inputs, white=options.white, dark=options.dark, again=options.accept_damaged
    )
    table = choose(table, max_steps=_max_steps(options))
    catalogue.save(collection.storage, table)
    return table


def _max_steps(options: Options) -> float:
    return float(options.config.get(WHITES, {}).get("max_steps", MAX_STEPS))


class _Run:
    """One run, under the lease of its collection."""

    def __init__(self, collection: Collection, options: Options, chain: Chain, progress: Progress | None) -> None:
        self._collection, self._options, self._chain, self._progress = collection, options, chain, progress
        self._statuses: list[Status] = []
        self._stack = contextlib.ExitStack()
        self._client: Any = None

    def outcome(self) -> Outcome:
        with self._stack:
            return self._outcome()

    def _outcome(self) -> Outcome:
        _scan(self._collection, self._options, self._chain)
        self._check_stores()
        self._execute(self.planner().jobs(kind="white"))
        self._leave_failed_whites_out()
        self._measure_unknown_cameras()
        self._execute(self.planner().jobs(kind="scene"))
        self._finalise()
        counts = Counter(status.state for status in self._statuses)
        return Outcome(dict(sorted(counts.items())), self._failures())

    def planner(self) -> Planner:
        table = self._collection.catalogue_rows()
        captures = None
        if self._options.where:
            found = select(self._collection.with_states(table), self._options.where)
            captures = frozenset(map(str, found["id"]))
        request = Request(
            self._options.config, self._options.stages, captures, self._options.force, self._options.accept_damaged
        )
        return Planner(self._collection, self._chain, request, self._grids(table))

    def _grids(self, table: pd.DataFrame) -> dict[str, Grid]:
        """Grid of every group: that of its store, else of its camera model, else not known yet."""
        grids: dict[str, Grid] = {}
        store = self._collection.store("lightfield")
        for group, rows in table[table["reason"] == ""].groupby("group"):
            manifest = store.manifest(str(group))
            first = rows.iloc[0]
            if manifest is not None:
                sizes = manifest.sizes
                grids[str(group)] = Grid(sizes["t"], sizes["s"], sizes["v"] // 2)
                continue
            pitch = first["lens_pitch"] / first["pixel_pitch"]
            grid = camera_grid(first["camera_model"], int(first["height"]), int(first["width"]), pitch)
            if grid is not None:
                grids[str(group)] = grid
        return grids

    def _check_stores(self) -> None:
        for stage in self._chain.stages:
            store = self._collection.store(stage.name)
            for group in store.groups():
                manifest = store.manifest(group)
                if manifest is not None:
                    store.check(group, manifest)

    def _leave_failed_whites_out(self) -> None:
        failed = [s.capture for s in self._statuses if s.stage == "calibration" and s.state == "failed"]
        if failed:
            table = choose(self._collection.catalogue_rows(), max_steps=_max_steps(self._options), excluded=failed)
            catalogue.save(self._collection.storage, table)

    def _measure_unknown_cameras(self) -> None:
        """Calibrate pictures of a camera without metadata until one gives the shape of its group's grid."""
        jobs = [job for job in self.planner().jobs(kind="scene") if job.grid is None]
        for group, members in itertools.groupby(sorted(jobs, key=lambda job: job.group), key=lambda job: job.group):
            for job in members:
                self._execute([replace(job, steps=job.steps[:1])])
                record = self._collection.ledger.find("calibration", job.capture)
                if record is not None:
                    calibration = self._collection.store("calibration").read(record)
                    sizes = calibration.sizes
                    grid = lattice_grid(calibration, sizes["y"], sizes["x"])
                    self._make_room("lightfield", group, grid, sizes, [])
                    break

    def _execute(self, jobs: list[Job]) -> None:
        self._statuses += [
            Status(step.stage, step.capture, _PLANNED[step.action], step.why)
            for job in jobs
            for step in job.steps
            if step.action != RUN and not any(other.action == RUN for other in job.steps)
        ]
        jobs = self._with_slots([job for job in jobs if any(step.action == RUN for step in job.steps)])
        finished = itertools.count(1)

        def report(statuses: tuple[Status, ...]) -> None:
            self._statuses.extend(statuses)
            if self._progress is not None and statuses:
                self._progress(next(finished), len(jobs), statuses[-1].capture)

        if jobs:
            lanes = in_flight(max(task_memory(job, self._chain) for job in jobs), *self._room())
            spare = lanes // len(jobs) if self._options.workers.kind == "threads" else 1
            url, pictures = self._collection.storage.url, self._options.pictures
            works = (Work(url, self._chain, job, pictures, max(1, spare)) for job in jobs)
            self._executor(lanes).run(works, report)

    def _executor(self, lanes: int) -> Executor:
        from lfflow.run.cluster import ClusterExecutor, local_client, remote_client

        workers = self._options.workers
        if workers.kind == "threads":
            return ThreadExecutor(lanes)
        if self._client is None:
            here = workers.kind == "processes"
            manager = local_client(workers.count, self._options.memory) if here else remote_client(workers.address)
            self._client = self._stack.enter_context(manager)
        return ClusterExecutor(self._client, lanes, self._options.retries)

    def _room(self) -> tuple[int, int | None]:
        """Workers and bytes; the memory of another machine's workers is for its owner to say."""
        elsewhere = self._options.workers.kind == "cluster" and self._options.memory is None
        return (_MANY, _MANY << 30) if elsewhere else (self._options.workers.count, self._options.memory)

    def _with_slots(self, jobs: list[Job]) -> list[Job]:
        """Jobs with the place of each region; stores grow here, once, before anything is written."""
        slots: dict[tuple[str, str], dict[str, int]] = {}
        for stage in self._chain.names:
            for group in sorted({job.group for job in jobs}):
                members = [job for job in jobs if job.group == group and any(s.stage == stage for s in job.steps)]
                if members:
                    names = [job.capture for job in members]
                    sizes = self._sensor(group)
                    slots[stage, group] = self._make_room(stage, group, members[0].grid, sizes, names)
        return [
            replace(job, steps=tuple(_placed(step, slots[step.stage, job.group]) for step in job.steps)) for job in jobs
        ]

    def _sensor(self, group: str) -> dict[str, int]:
        table = self._collection.catalogue_rows()
        row = table[table["group"] == group].iloc[0]
        return {"y": int(row["height"]), "x": int(row["width"])}

    def _make_room(
        self, stage: str, group: str, grid: Grid | None, sensor: Any, captures: Iterable[str]
    ) -> dict[str, int]:
        if stage == "calibration":
            sizes = {"y": int(sensor["y"]), "x": int(sensor["x"])}
        elif grid is not None:
            views = 2 * grid.radius + 1
            sizes = {"v": views, "u": views, "t": grid.rows, "s": grid.columns}
        else:
            return {}
        return self._collection.store(stage).ensure(group, sizes, sorted(captures))

    def _finalise(self) -> None:
        for stage in self._chain.stages:
            records = self._collection.ledger.records(stage.name)
            store = self._collection.store(stage.name)
            for group in store.groups():
                store.finalise(group, {name: r for name, r in records.items() if r.group == group})

    def _failures(self) -> dict[str, str]:
        table = self._collection.catalogue_rows()
        failed = {str(row["id"]): str(row["reason"]) for _, row in table[table["reason"] != ""].iterrows()}
        for status in self._statuses:
            if status.state in ("failed", "blocked") and status.reason != "not asked for":
                failed.setdefault(status.capture, f"{status.stage}: {status.reason}")
        return failed


_PLANNED = {"skip": "kept", FAILED_BEFORE: "failed", BLOCKED: "blocked"}


def _placed(step: Step, slots: dict[str, int]) -> Step:
    return replace(step, slot=slots.get(step.capture, -1))
