"""The command that says what a run would do."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Any

from cyclopts import Parameter

from lfflow.cli.options import Config, Json, Memory, Stages, Stored, Where, WorkersOption
from lfflow.cli.table import duration, lines, size


def plan(
    collection: Stored,
    *,
    config: Config = None,
    workers: WorkersOption = None,
    stages: Stages = None,
    where: Where = "",
    force: Annotated[bool, Parameter(negative="")] = False,
    memory: Memory = None,
    json_: Json = False,
) -> int:
    """Say what a run would do, and what it would need; `lfflow scan` makes the catalogue that it looks at.

    Parameters
    ----------
    force
        Plan to redo what is done.
    """
    from lfflow.run import make_plan
    from lfflow.run.estimate import estimate
    from lfflow.run.plan import as_rows
    from lfflow.run.request import options_from

    options = options_from((), config=config, workers=workers, stages=stages, where=where, force=force, memory=memory)
    jobs = make_plan(collection, options)
    needs = estimate(collection, jobs, options)
    steps = as_rows(jobs)
    if json_:
        text = json.dumps({"steps": steps, "needs": needs}, indent=1)
    else:
        rows = [[step[name] for name in ("capture", "stage", "action", "why")] for step in steps]
        text = "\n".join([*lines(rows, header=["capture", "stage", "action", "why"]), "", *_needs(needs)])
    sys.stdout.write(text + "\n")
    return 0


def _needs(needs: dict[str, Any]) -> list[str]:
    if not needs["steps"]:
        return ["nothing to do"]
    sources = needs["seconds_from"]
    measured = [stage for stage, source in sources.items() if source == "ledger"]
    guessed = [stage for stage in sources if stage not in measured]
    said = [f"{', '.join(measured)} as the ledger has it (median)"] if measured else []
    said += [f"{', '.join(guessed)} by built-in constants"] if guessed else []
    return [
        f"{needs['steps']} steps, about {duration(needs['seconds'])}, {needs['tasks_in_flight']} at a time",
        f"time of {'; '.join(said)}",
        f"{size(needs['bytes_written'])} to be written, {size(needs['memory_per_task'])} of memory for each task",
    ]
