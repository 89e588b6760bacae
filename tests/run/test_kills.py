"""kill -9 of the whole run at random moments, with a reader beside it."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
import time

import pytest
from fake_chain import write_capture
from fake_stores import store_content
from fault_tools import (
    HERE,
    assert_nothing_reads_as_finished_that_is_not,
    kill,
    lines,
    records,
    run,
    start,
)

from lfflow.collection import open_collection
from lfflow.collection.validate import validate


@pytest.fixture
def watch(tmp_path):
    """Start a reader of a collection; its findings come when it is asked to end."""
    readers = []

    def begin(out):
        command = [sys.executable, str(HERE / "watch_fake.py"), str(tmp_path / "whole"), str(out)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        readers.append(subprocess.Popen(command, text=True, **pipes))
        assert readers[-1].stdout.readline() == "ready\n"
        return readers[-1]

    yield begin
    for reader in readers:
        reader.kill()
        reader.communicate()


def kill_again_and_again(captures, out, expected, *, kills, longest, seed):
    """Start a run and kill it, `kills` times; returns how many of them were killed while they worked."""
    rng, at_work = random.Random(seed), 0  # noqa: S311
    for _ in range(kills):
        process = start(captures, out)
        while process.poll() is None and not (out / "catalogue.parquet").exists():
            time.sleep(0.01)
        try:
            process.communicate(timeout=rng.uniform(0.0, longest))
        except subprocess.TimeoutExpired:
            kill(process)
            at_work += 1
        assert_nothing_reads_as_finished_that_is_not(out, expected)
    return at_work


def finish(captures, out, expected, calls):
    """The run that is not killed: nothing that was finished is made again, and the stores are those of one run."""
    done = {f"{record.stage} {record.capture}" for record in records(out)}
    calls.write_text("")
    assert run(out, captures).exit_code == 0
    assert not done & set(lines(calls)), "a finished result was made again"
    assert store_content(out) == expected
    assert validate(open_collection(out)) == []


def test_a_run_that_is_killed_resumes_to_the_same_bits(tmp_path, captures, calls, watch):
    run(tmp_path / "whole", captures)
    expected, out = store_content(tmp_path / "whole"), tmp_path / "col"
    reader = watch(out)
    kill_again_and_again(captures, out, expected, kills=3, longest=2.0, seed=1)
    finish(captures, out, expected, calls)
    findings, errors = reader.communicate("end\n")
    assert (errors, findings.splitlines()[:-1]) == ("", []), "a reader saw what was not finished"


@pytest.mark.heavy
def test_a_run_that_is_killed_two_hundred_times_resumes_to_the_same_bits(tmp_path, captures, calls, watch):
    for number in range(60):
        write_capture(captures / f"MORE_{number}.lfp", seed=100 + number, behaviour="sleep0.03")
    run(tmp_path / "whole", captures)
    expected = store_content(tmp_path / "whole")
    at_work = rounds = 0
    while at_work < 200:
        out = tmp_path / f"col{rounds}"
        reader = watch(out)
        at_work += kill_again_and_again(captures, out, expected, kills=10, longest=5.0, seed=rounds)
        finish(captures, out, expected, calls)
        findings, errors = reader.communicate("end\n")
        assert (errors, findings.splitlines()[:-1]) == ("", []), "a reader saw what was not finished"
        shutil.rmtree(out)
        rounds += 1
    sys.stdout.write(f"{at_work} kills in {rounds} collections\n")
