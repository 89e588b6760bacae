"""Runs the fake chain over a folder: the process that fault tests kill."""

from __future__ import annotations

import resource
import sys

from fake_chain import FAKE

from lfflow.errors import LfflowError
from lfflow.run import Options, run_collection
from lfflow.run.executors import parse_workers

if __name__ == "__main__":
    captures, out, workers = sys.argv[1:4]
    try:
        outcome = run_collection(out, Options(inputs=(captures,), workers=parse_workers(workers)), FAKE)
    except LfflowError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(3)
    sys.stdout.write(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024}\n")
    sys.exit(outcome.exit_code)
