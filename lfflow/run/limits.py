"""How many tasks fit into the memory at once."""

from __future__ import annotations

from collections.abc import Iterable

from lfflow.run.chain import Chain
from lfflow.run.memory import SLACK, Extent, extent_of, result_bytes, writing_bytes
from lfflow.run.plan import RUN, Job, Step

PROCESS = 420 << 20
"""Memory of a process that has worked before and holds nothing: its libraries and compiled kernels."""
_SHARE = 0.8


def task_memory(job: Job, chain: Chain) -> int:
    """Peak bytes of a task beyond those of its process: the most that any of its stages needs."""
    extent = extent_of(job.height, job.width, job.grid, scene=job.kind == "scene")
    running = [step for step in job.steps if step.action == RUN]
    frame = 2 * extent.pixels if any(chain[step.stage].reads_raw for step in running) else 0
    return max((frame + _step_memory(step, chain, extent) for step in running), default=0)


def _step_memory(step: Step, chain: Chain, extent: Extent) -> int:
    stage = chain[step.stage]
    if stage.work is None:
        return 0
    given = sum(result_bytes(chain[name].schema, extent) for name in stage.upstream)
    result = result_bytes(stage.schema, extent)
    return given + max(stage.work(extent, step.parameters), result + writing_bytes(stage.schema, extent)) + SLACK


def largest(jobs: Iterable[Job], chain: Chain) -> int:
    """Memory of the task that needs most."""
    return max((task_memory(job, chain) for job in jobs), default=0)


def room(limit: int | None) -> int:
    """Bytes that all tasks together may use: as told, else most of what is free on this machine."""
    if limit is not None:
        return limit
    import psutil
    from distributed.system import MEMORY_LIMIT

    return int(_SHARE * min(MEMORY_LIMIT, psutil.virtual_memory().available))


def in_flight(memory: int, kind: str, workers: int, limit: int | None) -> int:
    """Tasks at a time so that they and their processes stay within the limit; one always runs.

    Parameters
    ----------
    memory
        Bytes of the task that needs most.
    kind, workers
        Kind and number of workers: threads share one process, the others have one each.
    limit
        Bytes for all; None: what this machine has free.
    """
    each = memory + (0 if kind == "threads" else PROCESS)
    return max(1, min(workers, max(0, room(limit) - PROCESS) // each if each else workers))
