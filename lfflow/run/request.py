"""From what a person types to the options of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lfflow.run.chain import CHAIN, Chain
from lfflow.run.config import ConfigError, load_config
from lfflow.run.executors import parse_workers
from lfflow.run.options import Options
from lfflow.run.versions import WorkersError


def options_from(
    inputs: Sequence[str] = (),
    *,
    config: Path | None = None,
    workers: str | None = None,
    stages: Sequence[str] | None = None,
    memory: str | None = None,
    white: Sequence[str] | None = None,
    dark: Sequence[str] | None = None,
    chain: Chain = CHAIN,
    **others: Any,
) -> Options:
    """Options, checked; raises ConfigError or WorkersError that names what would be valid."""
    names = tuple(name for item in stages or () for name in item.replace(",", " ").split())
    unknown = [name for name in names if name not in chain.names]
    if unknown:
        raise ConfigError(f"no stage {', '.join(unknown)}; there are {', '.join(chain.names)}")
    if workers is not None:
        others["workers"] = parse_workers(workers)
    if memory is not None:
        others["memory"] = parse_memory(memory)
    tables = load_config(config, chain)
    return Options(inputs=tuple(inputs), config=tables, stages=names, white=white or (), dark=dark or (), **others)


def parse_memory(text: str) -> int:
    """Bytes from a text such as 4GiB; raises WorkersError."""
    from dask.utils import parse_bytes

    try:
        return int(parse_bytes(text))
    except ValueError as error:
        raise WorkersError(f"no amount of memory: {text!r}; write it like 4GiB") from error
