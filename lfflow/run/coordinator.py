"""The coordinator of a run: scan, choose white images, plan, let the tasks run, bring the stores up to date."""

from __future__ import annotations

import contextlib
import itertools
import logging
import signal
import threading
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import pandas as pd

from lfflow.collection import Collection, catalogue
from lfflow.collection.object_lease import Tenure
from lfflow.collection.query import select
from lfflow.collection.update import update
from lfflow.collection.whites import MAX_STEPS, choose
from lfflow.run.chain import Chain, Grid, camera_grid, lattice_grid
from lfflow.run.config import WHITES
from lfflow.run.crew import Crew
from lfflow.run.limits import largest
from lfflow.run.options import Options, Outcome, Progress
from lfflow.run.plan import BLOCKED, FAILED_BEFORE, RUN, Job, Planner, Request, Step
from lfflow.run.task import Status

_log = logging.getLogger(__name__)


def scan(collection: Collection, options: Options, chain: Chain) -> pd.DataFrame:
    """Bring the catalogue up to date and choose the white image of every scene; returns the catalogue, saved."""
    table = update(
        collection, chain.open_raw, options.inputs, white=options.white, dark=options.dark, again=options.accept_damaged
    )
    table = choose(table, max_steps=_max_steps(options))
    catalogue.save(collection.storage, table)
    return table


def _max_steps(options: Options) -> float:
    return float(options.config.get(WHITES, {}).get("max_steps", MAX_STEPS))


class Run:
    """One run, under the lease of its collection."""

    def __init__(
        self,
        collection: Collection,
        options: Options,
        chain: Chain,
        progress: Progress | None = None,
        tenure: Tenure | None = None,
    ) -> None:
        self._collection, self._options, self._chain, self._progress = collection, options, chain, progress
        self._tenure = tenure or Tenure()
        self._statuses: list[Status] = []

    def outcome(self) -> Outcome:
        """Run everything; an interruption says what is kept and goes on its way."""
        try:
            with _terminated_as_interrupted():
                return self._outcome()
        except KeyboardInterrupt:
            made = Counter(status.state for status in self._statuses)["done"]
            _log.warning("interrupted: the %d results made so far are kept; run again to go on", made)
            raise

    def jobs(self) -> list[Job]:
        """Jobs that the run would go through: white images, then scenes."""
        planner = self.planner()
        return [*planner.jobs(kind="white"), *planner.jobs(kind="scene")]

    def _outcome(self) -> Outcome:
        scan(self._collection, self._options, self._chain)
        self._check_stores()
        planned = self.jobs()
        memory = largest(planned, self._chain)
        with Crew(self._collection, self._options, self._chain, memory, self._tenure) as crew:
            self._execute(crew, [job for job in planned if job.kind == "white"])
            if not crew.halted:
                self._leave_failed_whites_out()
            self._measure_unknown_cameras(crew)
            self._execute(crew, self.planner().jobs(kind="scene"))
        with contextlib.suppress(OSError) if crew.halted else contextlib.nullcontext():
            self._finalise()
        counts = Counter(status.state for status in self._statuses)
        return Outcome(dict(sorted(counts.items())), self._failures())

    def planner(self) -> Planner:
        """What compares catalogue and ledger as they are now."""
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
                if store.manifest_damage(group):
                    records = self._collection.ledger.records(stage.name).values()
                    store.mend_manifest(group, [record for record in records if record.group == group])
                manifest = store.manifest(group)
                if manifest is not None:
                    store.check(group, manifest)

    def _leave_failed_whites_out(self) -> None:
        failed = [s.capture for s in self._statuses if s.stage == "calibration" and s.state == "failed"]
        if failed:
            table = choose(self._collection.catalogue_rows(), max_steps=_max_steps(self._options), excluded=failed)
            catalogue.save(self._collection.storage, table)

    def _measure_unknown_cameras(self, crew: Crew) -> None:
        """Calibrate pictures of a camera without metadata until one gives the shape of its group's grid."""
        jobs = [job for job in self.planner().jobs(kind="scene") if job.grid is None]
        for group, members in itertools.groupby(sorted(jobs, key=lambda job: job.group), key=lambda job: job.group):
            for job in members:
                self._execute(crew, [replace(job, steps=job.steps[:1])])
                record = self._collection.ledger.find("calibration", job.capture)
                if record is not None:
                    calibration = self._collection.store("calibration").read(record)
                    sizes = calibration.sizes
                    grid = lattice_grid(calibration, sizes["y"], sizes["x"])
                    self._make_room("lightfield", group, grid, sizes, [])
                    break

    def _execute(self, crew: Crew, jobs: list[Job]) -> None:
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

        crew.run(jobs, report)

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


@contextlib.contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """A polite request to end, as queueing systems send it, ends a run like Ctrl-C does."""
    mine = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    if not mine:
        yield
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
