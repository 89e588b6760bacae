"""What listens while a run works: nothing off the loopback."""

from __future__ import annotations

import time

import psutil
import pytest
from fake_chain import write_capture
from fault_tools import start


def addresses(pid):
    """Local addresses of all sockets of a process and its descendants."""
    try:
        root = psutil.Process(pid)
        family = [root, *root.children(recursive=True)]
    except psutil.Error:
        return []
    found = []
    for member in family:
        try:
            found += [(c.laddr.ip, c.status == psutil.CONN_LISTEN) for c in member.net_connections("inet") if c.laddr]
        except psutil.Error:
            continue
    return found


@pytest.mark.parametrize(("workers", "listeners"), [("threads:2", 0), ("processes:2", 4)])
def test_a_run_opens_no_socket_off_the_loopback(tmp_path, captures, workers, listeners):
    write_capture(captures / "SLOW.lfp", seed=5, behaviour="sleep1")
    process = start(captures, tmp_path / "col", workers)
    seen = []
    while process.poll() is None:
        seen.append(addresses(process.pid))
        time.sleep(0.05)
    errors = process.communicate()[1]
    assert process.returncode == 0, errors
    assert {ip for found in seen for ip, _ in found} <= {"127.0.0.1", "::1"}
    # Scheduler, dashboard and two workers listen.
    assert max(sum(listening for _, listening in found) for found in seen) >= listeners
