"""The command that turns captures into a collection."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def run(
    *inputs: str,
    out: str,
    config: Path | None = None,
    workers: str | None = None,
    stages: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    where: str = "",
    white: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    dark: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    force: bool = False,
    retries: int = 2,
    memory: str | None = None,
    pictures: bool = True,
    accept_damaged: bool = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Turn captures into a collection of light fields and disparity maps.

    Only what is missing or depends on something that changed is done. Exit code 2 when some captures failed.

    Parameters
    ----------
    inputs
        Files, folders and globs; without any, the files that the collection knows already.
    out
        Folder or fsspec URL of the collection.
    config
        TOML file with a table of keyword arguments per stage.
    workers
        threads:N, processes:N, or the address of a dask scheduler (tcp://… or tls://…).
    stages
        Stages to work on: calibration, lightfield, disparity.
    where
        Expression over the catalogue that selects captures, such as "iso < 200".
    white
        Files that are white images, whatever their metadata say.
    dark
        Files that are dark images, whatever their metadata say.
    force
        Redo what is done.
    retries
        How often a capture whose process crashed is tried again.
    memory
        Memory that the tasks together may use, such as 4GiB; the default is what the machine has free.
    pictures
        Leave a quicklook of every capture in the collection.
    accept_damaged
        Take files whose checksums are wrong, and record that they are.
    json_
        Print one JSON document.
    """
    from lfflow.cli.progress import progress_bar
    from lfflow.run import run_collection
    from lfflow.run.request import options_from

    options = options_from(
        inputs, config=config, workers=workers, stages=stages, where=where, white=white, dark=dark, force=force,
        retries=retries, memory=memory, pictures=pictures, accept_damaged=accept_damaged,
    )  # fmt: skip
    with progress_bar() as progress:
        outcome = run_collection(out, options, progress=progress)
    if json_:
        document = {"collection": str(out), "counts": outcome.counts, "failed": outcome.failed}
        sys.stdout.write(json.dumps(document, indent=1) + "\n")
    else:
        sys.stdout.write(_text(str(out), outcome.counts, outcome.failed))
    return outcome.exit_code


def _text(out: str, counts: dict[str, int], failed: dict[str, str]) -> str:
    done, kept = counts.get("done", 0), counts.get("kept", 0)
    lines = [f"{capture}: {reason}" for capture, reason in failed.items()]
    if done:
        lines.append(f"{done} results made, {kept} kept: {out}")
    else:
        lines.append(f"nothing to do: {kept} results are up to date in {out}")
    if failed:
        lines.append(f"{len(failed)} captures failed")
    return "\n".join(lines) + "\n"
