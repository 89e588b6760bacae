"""Ctrl-C and a polite kill: what is at work is finished, what was kept is said, the next run goes on."""

from __future__ import annotations

import signal

import pytest
from fake_chain import write_capture
from fault_tools import lines, records, run, start, wait_until


@pytest.mark.parametrize(
    ("workers", "number"),
    [
        ("threads:2", signal.SIGINT),
        pytest.param("threads:2", signal.SIGTERM, marks=pytest.mark.heavy),
        pytest.param("processes:2", signal.SIGINT, marks=pytest.mark.heavy),
    ],
)
def test_an_interrupted_run_says_what_it_kept_and_goes_on_later(tmp_path, captures, calls, workers, number):
    for extra in range(12):
        write_capture(captures / f"MORE_{extra}.lfp", seed=100 + extra, behaviour="sleep0.5")
    process = start(captures, tmp_path / "col", workers)
    wait_until(lambda: (tmp_path / "col" / "catalogue.parquet").exists() and len(records(tmp_path / "col")) >= 2)
    process.send_signal(number)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode not in (0, 2)
    made = len(records(tmp_path / "col"))
    assert made < 24
    assert "results made so far are kept; run again to go on" in errors
    done = {f"{record.stage} {record.capture}" for record in records(tmp_path / "col")}
    calls.write_text("")
    for extra in range(4, 12):
        (captures / f"MORE_{extra}.lfp").unlink()
    run(tmp_path / "col", captures)
    assert not done & set(lines(calls))
