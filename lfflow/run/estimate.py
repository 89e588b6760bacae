"""What a plan needs: bytes on the disk, memory of a task, tasks in flight, seconds."""

from __future__ import annotations

import os
import statistics
from collections.abc import Iterable
from typing import Any

from lfflow.collection import Collection
from lfflow.run.chain import CHAIN, Chain
from lfflow.run.limits import PROCESS, in_flight, task_memory
from lfflow.run.options import Options
from lfflow.run.plan import RUN, Job

LEDGER, CONSTANTS = "ledger", "constants"


def estimate(
    out: str | os.PathLike[str], jobs: Iterable[Job], options: Options, chain: Chain = CHAIN
) -> dict[str, Any]:
    """Needs of the steps that would run, with the source of the time of every stage ("ledger" or "constants").

    The seconds of a step are the median of those that the ledger has of its stage for the same camera; before there are
    any, a constant of the stage times the size of the sensor.
    """
    collection = Collection(out)
    waiting = [(job, step) for job in jobs for step in job.steps if step.action == RUN]
    known = _medians(collection, {step.stage for _, step in waiting})
    seconds, written = dict.fromkeys(chain.names, 0.0), 0.0
    sources: dict[str, set[str]] = {}
    for job, step in waiting:
        measured = known.get((step.stage, job.group))
        guess = chain[step.stage].seconds_per_megapixel * job.height * job.width / 1e6
        seconds[step.stage] += guess if measured is None else measured
        sources.setdefault(step.stage, set()).add(CONSTANTS if measured is None else LEDGER)
        written += job.height * job.width * chain[step.stage].stored_per_pixel
    memory = max((task_memory(job, chain) for job, _ in waiting), default=0)
    workers = options.workers
    lanes = in_flight(memory, workers.kind, workers.count, options.memory)
    processes = 1 if workers.kind == "threads" else 1 + lanes
    return {
        "steps": len(waiting),
        "bytes_written": round(written),
        "memory_per_task": memory,
        "tasks_in_flight": lanes,
        "memory": processes * PROCESS + lanes * memory,
        "seconds": round(sum(seconds.values()) / lanes, 1),
        "seconds_from": {stage: " and ".join(sorted(found)) for stage, found in sources.items()},
    }


def _medians(collection: Collection, stages: Iterable[str]) -> dict[tuple[str, str], float]:
    """Median seconds of a capture, by stage and group."""
    taken: dict[tuple[str, str], list[float]] = {}
    for stage in stages:
        for record in collection.ledger.records(stage).values():
            taken.setdefault((stage, record.group), []).append(record.seconds)
    return {key: statistics.median(seconds) for key, seconds in taken.items()}
