"""Seconds to catalogue many captures: a first scan, a scan of what is unchanged, and what readers ask.

    python benchmarks/catalogue.py [CAPTURES]

The files are whole containers with tiny frames, in folders of 100, one white image each.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lfflow.collection import Collection, catalogue
from lfflow.collection.update import update
from lfflow.collection.whites import choose
from lfflow.formats.lfp import write_lfp
from lfflow.run.chain import open_lfp
from lfflow.simulate.body import BODIES, Setting
from lfflow.simulate.metadata import frame_metadata, private_metadata


def write_many(folder: Path, captures: int) -> None:
    body, size = BODIES["f01"], 16
    frame = np.zeros((size, size), np.uint16)
    for number in range(captures):
        setting = Setting(900 + number % 100, 500 + number % 200)
        metadata = frame_metadata(body, setting, size, size, np.datetime64("2013-05-01T12:00:00") + number)
        frame.flat[:3] = number % 4096, number // 4096, 1
        name = f"{'WHITE' if number % 100 == 0 else 'IMG'}_{number:05d}.lfp"
        path = folder / f"{number // 100:03d}" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_lfp(path, frame, metadata, private_metadata(body), white=number % 100 == 0)


def timed(what: str, work: Callable[[], object]) -> None:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    print(f"{what:34} {time.process_time() - cpu:8.2f} CPU s {time.perf_counter() - wall:8.2f} s")


def main() -> None:
    captures = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with tempfile.TemporaryDirectory() as name:
        files, col = Path(name) / "in", Collection(Path(name) / "col")
        timed(f"write {captures} files", lambda: write_many(files, captures))

        def scan() -> None:
            catalogue.save(col.storage, update(col, open_lfp, [files]))

        timed("first scan", scan)
        timed("scan of what is unchanged", scan)
        timed("choice of white images", lambda: catalogue.save(col.storage, choose(col.catalogue_rows())))
        timed("states of all captures", col.catalogue)
        timed("query", lambda: col.query("iso < 200 and focus_step > 500"))
        timed("status", col.status)


if __name__ == "__main__":
    main()
