"""What a run would do and why: fingerprints compared with the ledger."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import pandas as pd

from lfflow.collection import Collection
from lfflow.collection.collection import needed_stages
from lfflow.collection.records import FAILED, canonical
from lfflow.collection.whites import SELF
from lfflow.run.chain import Chain, Grid, Parameters, Stage
from lfflow.run.darks import Dark, darks_by_camera

RUN, SKIP, FAILED_BEFORE, BLOCKED = "run", "skip", "failed", "blocked"


@dataclass(frozen=True, slots=True)
class Step:
    """One (stage, capture) as planned.

    `action` is "run", "skip" (done), "failed" (failed before with the same input and parameters) or "blocked" (what
    it needs has failed); `why` says so in words.
    """

    stage: str
    capture: str
    fingerprint: str
    action: str
    why: str
    parameters: Parameters = field(default_factory=dict)
    upstream: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    slot: int = -1


@dataclass(frozen=True, slots=True)
class Job:
    """The steps of one capture that run one after the other in one task."""

    capture: str
    path: str
    size: int
    mtime_ns: int
    sha256: str
    group: str
    height: int
    width: int
    kind: str
    grid: Grid | None
    steps: tuple[Step, ...]
    darks: tuple[Dark, ...] = ()


@dataclass(frozen=True, slots=True)
class Request:
    """Which part of the collection to work on, and how; `failed_again` tries what failed with the same input."""

    config: Parameters = field(default_factory=dict)
    stages: tuple[str, ...] = ()
    captures: frozenset[str] | None = None
    force: bool = False
    failed_again: bool = False


def fingerprint(
    stage: Stage, parameters: Parameters, source: str, grid: Grid | None, upstream: Mapping[str, str]
) -> str:
    """Hash of all that a result depends on."""
    document = {
        "stage": [stage.name, stage.version],
        "parameters": parameters,
        "source": source,
        "grid": asdict(grid) if grid else None,
        "upstream": dict(upstream),
    }
    return hashlib.sha256(canonical(document)).hexdigest()


class Planner:
    """Compares what is wanted with what the ledger has."""

    def __init__(self, collection: Collection, chain: Chain, request: Request, grids: Mapping[str, Grid]) -> None:
        self._chain = chain
        self._request = request
        self._grids = grids
        self._table = collection.catalogue_rows().set_index("id", drop=False)
        self._darks = darks_by_camera(self._table)
        self._done = {stage.name: collection.ledger.fingerprints(stage.name) for stage in chain.stages}
        self._failed = {stage.name: collection.ledger.records(stage.name, FAILED) for stage in chain.stages}

    def jobs(self, *, kind: str) -> list[Job]:
        """Jobs of the pictures of one kind; those of white images only where a selected scene needs them."""
        return [job for row in self._rows(kind) if (job := self._job(row)) is not None]

    def _rows(self, kind: str) -> Iterator[pd.Series]:
        selected = self._request.captures
        usable = self._table[(self._table["reason"] == "") & (self._table["duplicate_of"] == "")]
        scenes = usable[usable["kind"] == "scene"]
        whites = set(scenes["white"] if selected is None else scenes[scenes["id"].isin(selected)]["white"])
        for name, row in usable[usable["kind"] == kind].iterrows():
            if selected is None or name in selected or (kind == "white" and name in whites):
                yield row

    def _job(self, row: pd.Series) -> Job | None:
        grid = self._grids.get(str(row["group"]))
        steps: list[Step] = []
        for name in needed_stages(str(row["kind"]), str(row["white"])):
            if name in self._chain.names:
                steps.append(self._step(self._chain[name], row, grid, steps))
        if not steps:
            return None
        darks = self._darks_of(row) if any(self._chain[step.stage].uses_darks for step in steps) else ()
        return Job(str(row["id"]), str(row["path"]), int(row["size"]), int(row["mtime_ns"]), str(row["sha256"]),
                   str(row["group"]), int(row["height"]), int(row["width"]), str(row["kind"]), grid,
                   tuple(steps), darks)  # fmt: skip

    def _step(self, stage: Stage, row: pd.Series, grid: Grid | None, before: list[Step]) -> Step:
        capture = str(row["id"])
        upstream: dict[str, tuple[str, str]] = {}
        for name in stage.upstream:
            own = next((step for step in before if step.stage == name), None)
            if own is not None:
                upstream[name] = (capture, own.fingerprint)
            elif name == "calibration" and row["white"] not in ("", SELF):
                upstream[name] = (str(row["white"]), self.calibration_of(str(row["white"])))
        parameters = {table: self._request.config[table] for table in stage.tables if table in self._request.config}
        shape = grid if stage.name != "calibration" else None
        hashes = {name: value for name, (_, value) in upstream.items()}
        mark = fingerprint(stage, parameters, self._source(stage, row), shape, hashes)
        action, why = self._decide(stage, capture, mark, before)
        return Step(stage.name, capture, mark, action, why, parameters, upstream)

    def calibration_of(self, white: str) -> str:
        """Fingerprint of a white image's calibration under the present parameters."""
        stage = self._chain["calibration"]
        parameters = {table: self._request.config[table] for table in stage.tables if table in self._request.config}
        return fingerprint(stage, parameters, self._source(stage, pd.Series(self._table.loc[white])), None, {})

    def _darks_of(self, row: pd.Series) -> tuple[Dark, ...]:
        return self._darks.get((str(row["group"]), str(row["camera_serial"])), ())

    def _source(self, stage: Stage, row: pd.Series) -> str:
        """The input of a stage: what the file holds, what that is taken for, and the dark images that it is given."""
        darks = self._darks_of(row) if stage.uses_darks else ()
        return " ".join([str(row["kind"]), str(row["sha256"]), *(dark.sha256 for dark in darks)])

    def _decide(self, stage: Stage, capture: str, mark: str, before: list[Step]) -> tuple[str, str]:
        blocker = next((s for s in before if s.stage in stage.upstream and s.action in (FAILED_BEFORE, BLOCKED)), None)
        if blocker is not None:
            return BLOCKED, f"its {blocker.stage} has failed"
        wanted = not self._request.stages or stage.name in self._request.stages
        done = self._done[stage.name].get(capture)
        if wanted and self._request.force:
            return RUN, "forced"
        if done == mark:
            return SKIP, "done"
        if not wanted:
            return (SKIP, "not asked for") if done is not None else (BLOCKED, "not asked for")
        failure = self._failed[stage.name].get(capture)
        if (
            failure is not None
            and failure.fingerprint == mark
            and not (failure.transient or self._request.failed_again)
        ):
            return FAILED_BEFORE, failure.reason
        if done is None:
            return RUN, "not done yet"
        return RUN, f"done with other input, parameters or version ({stage.name} is at version {stage.version})"


def as_rows(jobs: list[Job]) -> list[dict[str, Any]]:
    """One row per step, for people and for JSON."""
    return [
        {"capture": step.capture, "stage": step.stage, "action": step.action, "why": step.why}
        for job in jobs
        for step in job.steps
    ]
