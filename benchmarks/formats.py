"""Formats: unpacking against memcpy of the same traffic, opening, scanning; ``python benchmarks/formats.py``.

CPU seconds of one core, the best of several, in one process; scanning in wall seconds on all cores.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import xarray as xr

from lfflow.cameras import KNOWN_CAMERAS
from lfflow.formats.describe import describe
from lfflow.formats.layout import PACKINGS
from lfflow.formats.lfp import open_lfp, write_lfp
from lfflow.formats.opening import open_frame
from lfflow.formats.packing import pack, pack10, pack12, unpack10, unpack12

FILES = 200
COLD_FILES = 24


def best(work: Callable[[], object], repeats: int = 15) -> float:
    seconds = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        seconds.append(time.process_time() - begin)
    return min(seconds)


def unpacking() -> None:
    print(f"{'packing':22} {'memcpy ms':>10} {'unpack ms':>10} {'ratio':>6} {'pack ms':>8} {'ratio':>6}")
    for bits, order, size, unpacker, packer in (
        (12, "big", 3280 * 3280, unpack12, pack12),
        (10, "little", 7728 * 5368, unpack10, pack10),
    ):
        packing = PACKINGS[bits, order]
        samples = np.random.default_rng(0).integers(0, 1 << bits, size).astype(np.uint16)
        packed = np.frombuffer(pack(samples, packing), np.uint8).copy()
        out = np.empty_like(samples)
        unpacker(packed, out)
        assert np.array_equal(out, samples)
        source = np.ones((packed.nbytes + out.nbytes) // 2, np.uint8)
        target = np.empty_like(source)
        copy = best(lambda target=target, source=source: np.copyto(target, source))
        read = best(lambda unpacker=unpacker, packed=packed, out=out: unpacker(packed, out))
        write = best(lambda packer=packer, samples=samples, packed=packed: packer(samples, packed))
        name = f"{bits} bit, {size / 1e6:.1f} Mpixel"
        print(
            f"{name:22} {copy * 1e3:10.2f} {read * 1e3:10.2f} {read / copy:6.2f} {write * 1e3:8.2f} {write / copy:6.2f}"
        )


def metadata(model: str) -> dict[str, object]:
    camera, sites = KNOWN_CAMERAS[model], ("r", "gr", "gb", "b")
    bits, order, corner, black = {"F01": (12, "big", "b", 168), "B01": (10, "little", "gr", 64)}[model]
    levels = {"black": dict.fromkeys(sites, black), "white": dict.fromkeys(sites, (1 << bits) - 1)}
    details = {
        "pixelFormat": {"rightShift": 0, **levels},
        "pixelPacking": {"endianness": order, "bitsPerPixel": bits},
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": corner},
    }
    return {
        "image": {"width": camera.width, "height": camera.height, "rawDetails": details},
        "camera": {"model": model},
    }


def opening(folder: Path) -> None:
    path = folder / "IMG_0000.lfp"
    samples = np.random.default_rng(0).integers(168, 4096, (3280, 3280)).astype(np.uint16)
    write_lfp(path, samples, metadata("F01"))
    rows = [
        ("frame header (Frame)", best(lambda: open_frame(path), 50)),
        ("open_lfp (Dataset)", best(lambda: open_lfp(path), 50)),
        ('xr.open_dataset(engine="lfp")', best(lambda: xr.open_dataset(path, engine="lfp"), 200)),
    ]
    raw = open_lfp(path)["raw"]
    raw[:1].load()
    rows.append(("window of 10 rows, hash seen", best(lambda: open_lfp(path)["raw"][500:510].values) - rows[1][1]))
    rows.append(("whole frame: read, SHA-1, unpack", best(lambda: open_lfp(path)["raw"].values, 7) - rows[1][1]))
    print(f"\n{'F01 picture, 16 MB':34} {'CPU ms':>8}")
    for name, seconds in rows:
        print(f"{name:34} {seconds * 1e3:8.2f}")


def full_size(folder: Path) -> None:
    camera = KNOWN_CAMERAS["B01"]
    samples = np.random.default_rng(0).integers(64, 1024, (camera.height, camera.width)).astype(np.uint16)
    path = folder / "ILLUM.LFR"
    begin = time.process_time()
    write_lfp(path, samples, metadata("B01"), modulation=samples[::-1].copy())
    rows = [("write with its white image, 104 MB", time.process_time() - begin)]
    assert np.array_equal(xr.open_dataset(path, engine="lfp")["raw"].values, samples)
    rows.append(('xr.open_dataset(engine="lfp")', best(lambda: xr.open_dataset(path, engine="lfp"), 20)))
    rows.append(("whole frame: read, SHA-1, unpack", best(lambda: open_lfp(path)["raw"].values, 3)))
    rows.append(("lfflow info: all sections hashed", best(lambda: describe(path), 3)))
    print(f"\n{'Illum picture, 7728 × 5368':34} {'CPU ms':>8}")
    for name, seconds in rows:
        print(f"{name:34} {seconds * 1e3:8.2f}")


def scanning(folder: Path) -> None:
    """Open and hash every file, on as many threads as cores: against reading alone and hashing alone."""
    source, cores = folder / "IMG_0000.lfp", os.cpu_count() or 1
    warm = [folder / f"SCAN_{number:04d}.lfp" for number in range(FILES)]
    for path in warm:
        path.hardlink_to(source)
    cold = [folder / f"COLD_{number:04d}.lfp" for number in range(COLD_FILES)]
    for path in cold:
        shutil.copyfile(source, path)
    for what, paths in (("in the page cache", warm), ("from the disk", cold)):
        size = len(paths) * source.stat().st_size / 1e6
        timed = [spent(work, paths, cores, forget=paths is cold) for work in (slurp, digest, look)]
        bounds = [max(column) for column in zip(*timed[:2], strict=True)]
        head = f"{'wall s':>8} {'MB/s':>6} {'to bound':>9} {'CPU s':>7} {'to bound':>9}"
        print(f"\n{f'{len(paths)} files, {size:.0f} MB, {what}':44} {head}")
        for name, (wall, cpu) in zip(("read", "sha256", "open + sha256: what a scan does"), timed, strict=True):
            row = f"{wall:8.2f} {size / wall:6.0f} {wall / bounds[0]:9.2f} {cpu:7.2f} {cpu / bounds[1]:9.2f}"
            print(f"{f'{name} ({cores} threads)':44} {row}")


def slurp(path: Path) -> None:
    with path.open("rb") as file:
        while file.read(1 << 20):
            pass


def digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def look(path: Path) -> str:
    open_frame(path)
    return digest(path)


def spent(work: Callable[[Path], object], paths: list[Path], threads: int, *, forget: bool) -> tuple[float, float]:
    """Least wall and CPU seconds of work over all paths; with `forget`, each time from the disk and not from memory."""
    walls, cpus = [], []
    for _ in range(3):
        if forget:
            for path in paths:
                with path.open("rb") as file:
                    os.fsync(file.fileno())
                    os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        begin, used = time.perf_counter(), time.process_time()
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, paths))
        walls.append(time.perf_counter() - begin)
        cpus.append(time.process_time() - used)
    return min(walls), min(cpus)


def main() -> None:
    unpacking()
    with tempfile.TemporaryDirectory() as folder:
        opening(Path(folder))
        full_size(Path(folder))
        scanning(Path(folder))


if __name__ == "__main__":
    main()
