"""How many tasks fit into the memory at once."""

from __future__ import annotations

from lfflow.run.chain import Chain
from lfflow.run.plan import RUN, Job

_BASE = 200 << 20
_SHARE = 0.8


def task_memory(job: Job, chain: Chain) -> int:
    """Peak bytes of a task beyond those of its process: the most that any of its stages needs."""
    pixels = job.height * job.width
    return round(
        max((chain[step.stage].bytes_per_pixel * pixels for step in job.steps if step.action == RUN), default=0)
    )


def in_flight(memory: int, workers: int, limit: int | None) -> int:
    """Tasks at a time so that their memory together stays within the limit; one always runs."""
    if limit is None:
        from distributed.system import MEMORY_LIMIT

        limit = int(MEMORY_LIMIT * _SHARE)
    room = max(0, limit - _BASE)
    return max(1, min(workers, room // memory if memory else workers))
