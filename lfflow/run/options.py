"""What a run is asked to do, and what it answers."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from lfflow.run.chain import Parameters
from lfflow.run.executors import Workers

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
