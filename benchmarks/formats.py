"""Formats: unpacking against memcpy of the same traffic, opening, scanning; ``python benchmarks/formats.py``.

CPU seconds of one core, the best of several, in one process; written files lie in the page cache.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from lfflow.formats.layout import PACKINGS
from lfflow.formats.lfp import open_lfp, write_lfp
from lfflow.formats.opening import open_frame
from lfflow.formats.packing import pack, pack10, pack12, unpack10, unpack12

FILES = 200


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


def metadata() -> dict[str, object]:
    sites = ("r", "gr", "gb", "b")
    details = {
        "pixelFormat": {"rightShift": 0, "black": dict.fromkeys(sites, 168), "white": dict.fromkeys(sites, 4095)},
        "pixelPacking": {"endianness": "big", "bitsPerPixel": 12},
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": "b"},
    }
    return {"image": {"width": 3280, "height": 3280, "rawDetails": details}, "camera": {"model": "F01"}}


def opening(folder: Path) -> None:
    path = folder / "IMG_0000.lfp"
    samples = np.random.default_rng(0).integers(168, 4096, (3280, 3280)).astype(np.uint16)
    write_lfp(path, samples, metadata())
    rows = [
        ("frame header (Frame)", best(lambda: open_frame(path), 50)),
        ("open_lfp (Dataset)", best(lambda: open_lfp(path), 50)),
        ('xr.open_dataset(engine="lfp")', best(lambda: xr.open_dataset(path, engine="lfp"), 50)),
    ]
    raw = open_lfp(path)["raw"]
    raw[:1].load()
    rows.append(("window of 10 rows, hash seen", best(lambda: open_lfp(path)["raw"][500:510].values) - rows[1][1]))
    rows.append(("whole frame: read, SHA-1, unpack", best(lambda: open_lfp(path)["raw"].values, 7) - rows[1][1]))
    print(f"\n{'F01 picture, 16 MB':34} {'CPU ms':>8}")
    for name, seconds in rows:
        print(f"{name:34} {seconds * 1e3:8.2f}")


def scanning(folder: Path) -> None:
    whole = (folder / "IMG_0000.lfp").read_bytes()
    small = [folder / f"SCAN_{number:04d}.lfp" for number in range(FILES)]
    small[0].write_bytes(whole)
    for path in small[1:]:
        path.hardlink_to(small[0])
    read = time.perf_counter()
    for path in small:
        with path.open("rb") as file:
            while file.read(1 << 20):
                pass
    read = time.perf_counter() - read
    hashed = time.perf_counter()
    for path in small:
        with path.open("rb") as file:
            hashlib.file_digest(file, "sha256")
    hashed = time.perf_counter() - hashed
    scan = time.perf_counter()
    for path in small:
        open_frame(path)
        with path.open("rb") as file:
            hashlib.file_digest(file, "sha256")
    scan = time.perf_counter() - scan
    size = FILES * len(whole) / 1e6
    print(f"\n{FILES} files, {size:.0f} MB, page cache {'s':>12} {'MB/s':>8}")
    for name, seconds in (("read", read), ("read + sha256", hashed), ("scan: open + sha256", scan)):
        print(f"{name:34} {seconds:8.2f} {size / seconds:8.0f}")


def main() -> None:
    unpacking()
    with tempfile.TemporaryDirectory() as folder:
        opening(Path(folder))
        scanning(Path(folder))


if __name__ == "__main__":
    main()
