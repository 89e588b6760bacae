"""Runs of the fake chain in this process and in others, and what must hold after a fault."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
from fake_chain import FAKE

from lfflow.collection import open_collection
from lfflow.run import Options, run_collection
from lfflow.run.executors import Workers

HERE = Path(__file__).parent
SCRIPT = str(HERE / "run_fake.py")
STAGES = ("calibration", "lightfield", "disparity")


def run(out, captures, **options):
    options.setdefault("workers", Workers("threads", 2))
    return run_collection(out, Options(inputs=(captures,), **options), FAKE)


def start(captures, out, workers="threads:2", script=SCRIPT, **options):
    """A run in a process (and session) of its own."""
    path = os.pathsep.join([str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, str(script), str(captures), str(out), workers]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, env=environment, start_new_session=True, text=True, **pipes, **options)


def kill(process):
    """kill -9 of a run and of all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def lines(log):
    return log.read_text().splitlines()


def records(out):
    return [r for stage in STAGES for r in open_collection(out).ledger.records(stage).values()]


def assert_nothing_reads_as_finished_that_is_not(out, expected):
    """Every region that the ledger calls done has the bytes of the uninterrupted run."""
    for record in records(out):
        assert {name: expected[name] for name in record.files} == dict(record.files)


def wait_until(condition, seconds=60.0):
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, "it never came to that"
        time.sleep(0.02)


def processes_below(pid, word):
    """Descendants of a process whose command line has a word."""
    with contextlib.suppress(psutil.Error):
        return [child for child in psutil.Process(pid).children(recursive=True) if word in _command(child)]
    return []


def _command(process):
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def _tool(name):
    return shutil.which(name) or name


@contextlib.contextmanager
def small_disk(path: Path, size: str) -> Iterator[Path]:
    """A file system of its own, as small as said; raises PermissionError where it may not be mounted."""
    path.mkdir(parents=True, exist_ok=True)
    mounted = subprocess.run(
        [_tool("mount"), "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(path)], capture_output=True
    )
    if mounted.returncode:
        raise PermissionError(mounted.stderr.decode())
    try:
        yield path
    finally:
        subprocess.run([_tool("umount"), "-l", str(path)], check=True)


def remount(path: Path, options: str) -> None:
    subprocess.run([_tool("mount"), "-o", f"remount,{options}", str(path)], check=True)
