"""The batch on a collection: bring the catalogue up to date, plan, run."""

from __future__ import annotations

import os

import pandas as pd

from lfflow.collection import Collection
from lfflow.collection.leases import run_lease
from lfflow.collection.storage import explain
from lfflow.run.chain import CHAIN, Chain
from lfflow.run.coordinator import Run, scan
from lfflow.run.options import Options, Outcome, Progress
from lfflow.run.plan import Job


def scan_collection(out: str | os.PathLike[str], options: Options, chain: Chain = CHAIN) -> pd.DataFrame:
    """Bring the catalogue up to date with the input files; returns it."""
    collection = Collection(out)
    chain = chain.accepting_damage() if options.accept_damaged else chain
    with run_lease(collection.storage):
        return scan(collection, options, chain)


def run_collection(
    out: str | os.PathLike[str], options: Options, chain: Chain = CHAIN, progress: Progress | None = None
) -> Outcome:
    """Do what is missing in a collection; raises CollectionError when another run holds it or it cannot be written."""
    collection = Collection(out)
    chain = chain.accepting_damage() if options.accept_damaged else chain
    try:
        with run_lease(collection.storage) as tenure:
            return Run(collection, options, chain, progress, tenure).outcome()
    except OSError as error:
        raise explain(error) from error


def make_plan(out: str | os.PathLike[str], options: Options, chain: Chain = CHAIN) -> list[Job]:
    """Jobs that a run would go through, with what each step would do and why."""
    collection = Collection(out)
    return Run(collection, options, chain).jobs()
