"""The command that turns captures into a collection."""

from __future__ import annotations

import contextlib
import json
import logging
import sys
from collections.abc import Iterator

from lfflow.cli.options import (
    AcceptDamaged,
    Config,
    Dark,
    Inputs,
    Json,
    Memory,
    Out,
    Stages,
    Where,
    White,
    WorkersOption,
)
from lfflow.cli.table import lines


def run(
    *inputs: Inputs,
    out: Out,
    config: Config = None,
    workers: WorkersOption = None,
    stages: Stages = None,
    where: Where = "",
    white: White = None,
    dark: Dark = None,
    force: bool = False,
    retries: int = 2,
    memory: Memory = None,
    pictures: bool = True,
    accept_damaged: AcceptDamaged = False,
    json_: Json = False,
) -> int:
    """Turn captures into a collection of light fields and disparity maps.

    Only what is missing or depends on something that changed is done. Exit code 2 when some captures failed.

    Parameters
    ----------
    force
        Redo what is done.
    retries
        How often a capture whose process crashed is tried again.
    pictures
        Leave a quicklook of every capture in the collection.
    """
    from lfflow.cli.progress import progress_bar
    from lfflow.run import run_collection
    from lfflow.run.request import options_from

    options = options_from(
        inputs, config=config, workers=workers, stages=stages, where=where, white=white, dark=dark, force=force,
        retries=retries, memory=memory, pictures=pictures, accept_damaged=accept_damaged,
    )  # fmt: skip
    with _messages(), progress_bar() as progress:
        outcome = run_collection(out, options, progress=progress)
    if json_:
        document = {"collection": str(out), "counts": outcome.counts, "failed": outcome.failed}
        sys.stdout.write(json.dumps(document, indent=1) + "\n")
    else:
        sys.stdout.write(_text(str(out), outcome.counts, outcome.failed))
    return outcome.exit_code


@contextlib.contextmanager
def _messages() -> Iterator[None]:
    """Say on standard error what a run says: where its dashboard is, what died, what an interruption kept."""
    handler, logger = logging.StreamHandler(sys.stderr), logging.getLogger("lfflow")
    logger.addHandler(handler)
    logging.getLogger("lfflow.run").setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def _text(out: str, counts: dict[str, int], failed: dict[str, str]) -> str:
    done, kept = counts.get("done", 0), counts.get("kept", 0)
    text = lines(failed.items())
    if done:
        text.append(f"{done} results made, {kept} kept: {out}")
    elif kept or not failed:
        text.append(f"nothing to do: {kept} results are up to date in {out}")
    if failed:
        text.append(f"{len(failed)} captures failed")
    return "\n".join(text) + "\n"
