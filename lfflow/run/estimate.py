"""What a plan needs: bytes on the disk, memory of a task, tasks in flight, seconds."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from lfflow.collection import Collection
from lfflow.run.chain import CHAIN, Chain
from lfflow.run.limits import PROCESS, in_flight, task_memory
from lfflow.run.options import Options
from lfflow.run.plan import RUN, Job


def estimate(
    out: str | os.PathLike[str], jobs: Iterable[Job], options: Options, chain: Chain = CHAIN
) -> dict[str, Any]:
    """Needs of the steps that would run; seconds from the ledger where the stage has run before."""
    collection = Collection(out)
    waiting = [(job, step) for job in jobs for step in job.steps if step.action == RUN]
    records = {stage.name: list(collection.ledger.records(stage.name).values()) for stage in chain.stages}
    seconds = written = 0.0
    for job, step in waiting:
        known = [record.seconds for record in records[step.stage] if record.group == job.group]
        guess = chain[step.stage].seconds_per_megapixel * job.height * job.width / 1e6
        seconds += sum(known) / len(known) if known else guess
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
        "seconds": round(seconds / lanes, 1),
    }
