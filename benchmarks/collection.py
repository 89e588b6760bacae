"""What a batch costs beside the stages themselves: memory against its estimate, growth with the number of captures.

    python benchmarks/collection.py [memory|growth|ledger] [--full]

`memory`: peak of the tasks of one white image and one scene, by sensor size, against what `lfflow plan` says of them;
`--full` adds a whole F01 capture, and one whose disparities are searched over the widest range. `growth`: 40 and 400
captures of trivial stages on two worker processes: peak memory of a worker and of the client, tasks in flight, bytes
sent per task, CPU seconds per capture. `ledger`: records read one by one and many at once, on the disk and, where
moto[server] is installed, from an S3 server whose every answer takes 20 ms more.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import ctypes
import gc
import importlib.util
import json
import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

MIB = 1 << 20
LATENCY = 0.02
SMALL = ((400, 400), (900, 900))
FAKE = Path(__file__).parents[1] / "tests" / "run"
WIDE = {"disparity": {"hypotheses": [step / 8 for step in range(-32, 33)]}}


def _status(name: str) -> int:
    """A line of this process's status, bytes."""
    with Path("/proc/self/status").open() as lines:
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(name))


def _forget_peak() -> int:
    """Give free memory back, forget the peak; returns what is in use."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


class Measured:
    """An executor that runs one task after the other and keeps the peak of each beside its estimate."""

    found: ClassVar[list[dict[str, Any]]] = []

    def __init__(self, _: int) -> None:
        pass

    def run(self, works: Iterator[Any], report: Any) -> None:
        from lfflow.run.limits import task_memory
        from lfflow.run.task import perform

        for work in works:
            before, started = _forget_peak(), time.process_time()
            report(perform(work))
            self.found.append({
                "kind": work.job.kind, "pixels": work.job.height * work.job.width, "in_use_before": before,
                "peak": _status("VmHWM") - before, "estimate": task_memory(work.job, work.chain),
                "cpu_seconds": round(time.process_time() - started, 2),
            })  # fmt: skip


def peaks(folder: Path, config: dict[str, Any]) -> list[dict[str, Any]]:
    """Peak of every task of a folder of captures, after one that has loaded and compiled everything."""
    from lfflow.run import Options, crew, run_collection
    from lfflow.run.executors import Workers
    from lfflow.simulate import simulate_collection

    crew.ThreadExecutor = Measured  # type: ignore[misc,assignment]
    options = {"config": config, "workers": Workers("threads", 1)}
    with tempfile.TemporaryDirectory() as scratch:
        simulate_collection(f"{scratch}/warm", 1, 3, height=900, width=900)
        for captures, out in ((f"{scratch}/warm", "w1"), (str(folder), "col")):
            Measured.found.clear()
            outcome = run_collection(f"{scratch}/{out}", Options(inputs=(captures,), **options))
            assert outcome.exit_code == 0, outcome.failed
    return Measured.found


def memory(height: int | None, width: int | None, config: dict[str, Any] | None = None) -> list[dict[str, Any]]:
    """`peaks` of one simulated white image and scene, in a process of their own."""
    from lfflow.simulate import simulate_collection

    with tempfile.TemporaryDirectory() as folder:
        simulate_collection(folder, 1, 3, height=height, width=width)
        return _in_a_process("peaks", folder, json.dumps(config or {}))


def count(folder: str, captures: int) -> dict[str, Any]:
    """One run of trivial stages over many captures on two worker processes."""
    sys.path.insert(0, str(FAKE))
    os.environ["PYTHONPATH"] = str(FAKE)
    import cloudpickle
    from fake_chain import FAKE as CHAIN
    from fake_chain import write_capture

    from lfflow.run import Options, cluster, run_collection
    from lfflow.run.executors import Workers

    for number in range(captures):
        write_capture(Path(folder) / "in" / f"IMG_{number}.lfp", seed=number)
    flying, sent = [], []
    original = cluster.ClusterExecutor._submit  # noqa: SLF001

    def watched(self: Any, batch: Any) -> None:
        original(self, batch)
        flying.append(len(batch.flying))
        sent.extend(len(cloudpickle.dumps(work)) for work, _ in batch.flying.values())

    cluster.ClusterExecutor._submit = watched  # type: ignore[method-assign]  # noqa: SLF001
    started = time.process_time()
    run_collection(f"{folder}/col", Options(inputs=(f"{folder}/in",), workers=Workers("processes", 2)), CHAIN)
    client = time.process_time() - started
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "captures": captures, "worker_peak": children.ru_maxrss * 1024,
        "client_peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        "tasks_in_flight": max(flying), "bytes_per_task": max(sent),
        "client_cpu_per_capture": round(client / captures, 4),
        "worker_cpu_per_capture": round((children.ru_utime + children.ru_stime) / captures, 4),
    }  # fmt: skip


def growth(*counts: int) -> list[dict[str, Any]]:
    """`count` for several numbers of captures, each in a process of its own."""
    found = []
    for captures in counts:
        with tempfile.TemporaryDirectory() as folder:
            found.append(_in_a_process("count", folder, str(captures)))
    return found


def ledger(url: str, records: int) -> list[tuple[str, float, float]]:
    """Seconds and CPU seconds to read the records of one stage, one by one and many at once."""
    from lfflow.collection.records import DONE, Ledger, Record
    from lfflow.collection.storage import open_storage

    known = Ledger(open_storage(url))
    files = {f"disparity.zarr/F01/{name}/c/0/0/0/0/0": "0" * 64 for name in ("disparity", "disparity_std", "flags")}
    names = [f"IMG_{number:05d}" for number in range(records)]
    for name in names:
        known.write(Record("disparity", name, DONE, "1" * 64, {"path": name, "sha256": "2" * 64}, "F01", 0, files))
    found = []
    for way, read in (
        ("one by one", lambda: {name: known.find("disparity", name) for name in known.captures("disparity")}),
        ("many at once", lambda: known.records("disparity")),
    ):
        started, cpu = time.perf_counter(), time.process_time()
        assert list(read()) == names
        found.append((way, time.perf_counter() - started, time.process_time() - cpu))
    return found


@contextlib.contextmanager
def slow_s3(bucket: str) -> Iterator[str]:
    """URL on an S3 server of this machine, in a process of its own, that answers as late as a distant one."""
    import s3fs

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    os.environ |= {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_ACCESS_KEY_ID": "somebody",
                   "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1"}  # fmt: skip
    original = s3fs.S3FileSystem._call_s3  # noqa: SLF001

    async def late(self: Any, *given: Any, **named: Any) -> Any:
        await asyncio.sleep(LATENCY)
        return await original(self, *given, **named)

    s3fs.S3FileSystem._call_s3 = late  # type: ignore[method-assign]  # noqa: SLF001
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:  # noqa: S603
        try:
            while True:
                with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                    break
                time.sleep(0.1)
            s3fs.S3FileSystem().mkdir(bucket)
            yield f"s3://{bucket}/col"
        finally:
            server.terminate()


def _print_ledger() -> None:
    print("records        where   way                 s    CPU s   ms a record")

    def rows(where: str, url: str, records: int) -> None:
        for way, seconds, cpu in ledger(url, records):
            print(f"{records:7}{where:>13}   {way:14}{seconds:7.2f}{cpu:9.2f}{1e3 * seconds / records:14.2f}")

    with tempfile.TemporaryDirectory() as folder:
        rows("disk", folder, 3000)
    if importlib.util.find_spec("moto") and importlib.util.find_spec("s3fs"):
        with slow_s3("lab") as url:
            rows("S3 + 20 ms", url, 300)


def _in_a_process(*arguments: str) -> Any:
    command = [sys.executable, __file__, *arguments]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)  # noqa: S603 - this very program
    return json.loads(done.stdout.splitlines()[-1])


def _print_memory(full: bool) -> None:
    print("sensor, task             in use before   peak of the task   estimate   peak/estimate   CPU s")
    cases: list[tuple[str, Any, Any, Any]] = [(f"{h}x{w}", h, w, None) for h, w in SMALL]
    if full:
        cases += [("F01", None, None, None), ("F01, widest range", None, None, WIDE)]
    for name, height, width, config in cases:
        for row in memory(height, width, config):
            share = row["peak"] / row["estimate"]
            before, peak, estimate = (row[key] / MIB for key in ("in_use_before", "peak", "estimate"))
            print(f"{name + ', ' + row['kind']:28}{before:6.0f} MiB{peak:15.1f} MiB{estimate:9.1f} MiB{share:12.2f}"
                  f"{row['cpu_seconds']:12.1f}")  # fmt: skip


def _print_growth() -> None:
    print("captures   worker peak   client peak   in flight   bytes a task   CPU s a capture: worker, client")
    for row in growth(40, 400):
        print(f"{row['captures']:8}{row['worker_peak'] / MIB:10.0f} MiB{row['client_peak'] / MIB:10.0f} MiB"
              f"{row['tasks_in_flight']:10}{row['bytes_per_task']:15}{row['worker_cpu_per_capture']:25.3f}"
              f"{row['client_cpu_per_capture']:8.3f}")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", choices=["memory", "growth", "ledger", "peaks", "count"])
    parser.add_argument("given", nargs="*", help=argparse.SUPPRESS)
    parser.add_argument("--full", action="store_true")
    given = parser.parse_args()
    if given.part == "peaks":
        print(json.dumps(peaks(Path(given.given[0]), json.loads(given.given[1]))))
    elif given.part == "count":
        print(json.dumps(count(given.given[0], int(given.given[1]))))
    else:
        parts = {"memory": lambda: _print_memory(given.full), "growth": _print_growth, "ledger": _print_ledger}
        for name in [given.part] if given.part else parts:
            parts[name]()


if __name__ == "__main__":
    main()
