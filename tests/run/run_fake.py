"""Runs the fake chain over a folder: the process that fault tests kill.

    python run_fake.py CAPTURES COLLECTION WORKERS

With RUN_AS set to a user id, that user does it, once all modules are loaded; with FILE_LIMIT, no file may be larger.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile

from fake_chain import FAKE

from lfflow.errors import LfflowError
from lfflow.run import Options, run_collection
from lfflow.run.executors import parse_workers


def go(captures, out, workers):
    return run_collection(out, Options(inputs=(captures,), workers=parse_workers(workers), retries=1), FAKE)


def restrict(captures, workers):
    if "RUN_AS" in os.environ:
        with tempfile.TemporaryDirectory() as folder:
            go(captures, folder, workers)
        os.setegid(int(os.environ["RUN_AS"]))
        os.seteuid(int(os.environ["RUN_AS"]))
    if "FILE_LIMIT" in os.environ:
        limit = int(os.environ["FILE_LIMIT"])
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))


if __name__ == "__main__":
    # A shell that starts the tests in the background has it ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    restrict(sys.argv[1], sys.argv[3])
    try:
        outcome = go(*sys.argv[1:4])
    except LfflowError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(3)
    for capture, reason in outcome.failed.items():
        sys.stderr.write(f"{capture}: {reason}\n")
    sys.stdout.write(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024}\n")
    sys.exit(outcome.exit_code)
