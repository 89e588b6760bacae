"""The batch as a program of a dozen lines: from a folder of captures to disparity maps, resumable at any time.

    python -m pipelines.batch CAPTURES COLLECTION

The same as ``lfflow run CAPTURES --out COLLECTION``; start here for a batch of your own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import lfflow
from lfflow.run import Options, Outcome, run_collection
from lfflow.run.executors import parse_workers


def batch(captures: Path, out: Path, workers: str = "threads:2") -> Outcome:
    """Make what is missing, and say how near the nearest thing of every capture is."""
    outcome = run_collection(out, Options(inputs=(captures,), workers=parse_workers(workers)))
    collection = lfflow.open_collection(out)
    if collection.store("disparity").groups():
        for camera in collection.store("disparity").groups():
            central = collection.open("disparity", camera=camera)["disparity"].sel(u=0, v=0)
            nearest = central.quantile(0.99, dim=("t", "s"), skipna=True)
            for capture, value in zip(nearest["capture"].values, nearest.values, strict=True):
                print(f"{capture}\t{value:+.3f} lens pitches per view step")
    for capture, reason in outcome.failed.items():
        print(f"{capture}\tfailed: {reason}", file=sys.stderr)
    return outcome


if __name__ == "__main__":
    sys.exit(batch(Path(sys.argv[1]), Path(sys.argv[2])).exit_code)
