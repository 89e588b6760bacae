"""The command that says what a run would do."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def plan(
    collection: str,
    *,
    config: Path | None = None,
    workers: str | None = None,
    stages: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    where: str = "",
    force: bool = False,
    memory: str | None = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Say what a run would do, and what it would need; `lfflow scan` makes the catalogue that it looks at.

    Parameters
    ----------
    collection
        Folder or URL of the collection.
    config
        TOML file with a table of keyword arguments per stage.
    workers
        threads:N or processes:N.
    stages
        Stages to work on: calibration, lightfield, disparity.
    where
        Expression over the catalogue that selects captures.
    force
        Redo what is done.
    memory
        Memory that the tasks together may use, such as 4GiB.
    json_
        Print one JSON document.
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
        sys.stdout.write(json.dumps({"steps": steps, "needs": needs}, indent=1) + "\n")
    else:
        lines = [f"{step['capture']}\t{step['stage']}\t{step['action']}\t{step['why']}" for step in steps]
        lines += [f"{name}: {value}" for name, value in needs.items()]
        sys.stdout.write("\n".join(lines) + "\n")
    return 0
