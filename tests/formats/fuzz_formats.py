"""Feed broken files to every reader: ``python tests/formats/fuzz_formats.py --mutations 1000000``.

Every mutant must end in success or in `FormatError`, within seconds and a bounded memory. `fuzz_coverage`
has the same mutants steered by coverage.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import xarray as xr
from flat_mutations import cfg_mutant, mat_mutant, mutate_document, pfm_mutant, png_mutant, tar_mutant
from format_examples import PRIVATE, metadata_of
from format_mutations import Container, mutate_bytes, mutate_json

from lfflow.errors import FormatError
from lfflow.formats.archives import archive_entries, archive_frame
from lfflow.formats.container import open_container
from lfflow.formats.describe import describe
from lfflow.formats.eslf import open_eslf
from lfflow.formats.frame import Frame, FrameArray
from lfflow.formats.layout import PACKINGS
from lfflow.formats.lfp import raw_frame, read_hot_pixels
from lfflow.formats.opening import container_kind
from lfflow.formats.packing import pack
from lfflow.formats.pfm import read_pfm
from lfflow.formats.png import read_png, write_png
from lfflow.formats.raw_pair import document_metadata, open_pair, pair_bytes
from lfflow.formats.renderings import rendering
from lfflow.formats.toolbox import open_toolbox
from lfflow.formats.views import open_views

SECONDS = 10
SHARE = 10_000
HEIGHT, WIDTH = 6, 8
Case = tuple[str, bytes]


class Slow(BaseException):
    """A reader took too long; no FormatError handler may swallow it."""


def raw(bits: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(0).integers(0, 1 << bits, (HEIGHT, WIDTH)).astype(np.uint16)


def jpeg() -> bytes:
    import cv2

    return cv2.imencode(".jpg", np.zeros((5, 7, 3), np.uint8))[1].tobytes()


def containers() -> dict[str, Container]:
    """One small container of every kind; "@name" stands for the id of a chunk."""
    f01, illum = metadata_of("f01", HEIGHT, WIDTH), metadata_of("illum", HEIGHT, WIDTH)
    packed, ten = pack(raw(12), PACKINGS[12, "big"]), pack(raw(10), PACKINGS[10, "little"])
    frame = {"metadataRef": "@metadata", "privateMetadataRef": "@private", "imageRef": "@image"}
    tags = {"vendorContent": {"com.lytro.tags": {"darkFrame": False, "modulationFrame": True}}}
    picture = {"frameArray": [{"frame": frame, "parameters": tags}], "accelerationArray": []}
    lfr = {"frame": {**frame, "modulationDataRef": "@white", "hotPixelRef": "@hot"}}
    stack = {
        "type": "com.lytro.acceleration.refocusStack",
        "vendorContent": {
            "depthLut": {"width": 2, "height": 2, "imageRef": "@lut"},
            "imageArray": [{"width": 7, "height": 5, "lambda": n, "imageRef": "@jpeg"} for n in range(2)],
        },
    }
    depth = {"width": 2, "height": 2, "depthMap": {"imageRef": "@lut"}, "confidenceMap": {"imageRef": "@lut"}}
    web = {"width": 7, "height": 5, "perImage": [{"focus": 1, "imageRef": "@jpeg"}], "depthMap": {"width": 2, "height": 2, "imageRef": "@lut"}}  # fmt: skip  # noqa: E501
    image, text = pair_bytes(raw(12), f01, PRIVATE)
    files = [{"name": f"C:\\T1CALIB\\MOD_0000.{end}", "dataRef": f"@{end}"} for end in ("RAW", "TXT")]
    embedded = {"metadata": illum, "privateMetadata": PRIVATE, "imageRef": "@image"}
    lut = np.arange(4, dtype="<f4").tobytes()
    hot = (2).to_bytes(4, "little") + np.arange(4, dtype="<i2").tobytes()
    raw_chunks = {"metadata": f01, "private": PRIVATE, "image": packed}
    lfr_chunks = {"metadata": illum, "private": PRIVATE, "image": ten, "white": ten[::-1], "hot": hot}
    return {
        "lfp": Container({"picture": picture}, raw_chunks),
        "lfr": Container({"frames": [lfr], "views": []}, lfr_chunks),
        "embedded": Container({"frames": [{"frame": embedded}]}, {"image": ten}),
        "stk": Container({"picture": {"accelerationArray": [stack]}}, {"lut": lut, "jpeg": jpeg()}),
        "dm": Container({"picture": {"accelerationArray": [{"vendorContent": depth}]}}, {"lut": lut}),
        "web": Container({"frames": [], "views": [{"accelerations": [web]}]}, {"lut": lut, "jpeg": jpeg()}),
        "storage": Container({"files": files}, {"RAW": image, "TXT": json.loads(text)}),
    }


def pair_files(camera: str) -> dict[str, bytes]:
    """A small RAW + TXT pair."""
    image, text = pair_bytes(raw(10), metadata_of(camera, HEIGHT, WIDTH, 10), PRIVATE)
    return {"MOD_0000.RAW": image, "MOD_0000.TXT": text}


class Fuzzer:
    """Makes mutants and feeds them to the readers; the same seed makes the same mutants."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.containers = containers()
        self.pairs = {camera: pair_files(camera) for camera in ("f01", "illum")}
        self.text = json_of(metadata_of("f01", HEIGHT, WIDTH))
        members = {**self.pairs["illum"], "n" * 90: b"long"}
        self.flat: dict[str, Callable[[Random], bytes]] = {
            "tar": lambda random: tar_mutant(members, random),
            "png": png_mutant,
            "png16": lambda random: png_mutant(random, 16),
            "view": png_mutant,
            "cfg": cfg_mutant,
            "pfm": pfm_mutant,
            "mat": lambda random: mat_mutant(random, compressed=False),
            "mat7": lambda random: mat_mutant(random, compressed=True),
            "pair": lambda random: mutate_document(self.pairs["illum"]["MOD_0000.TXT"], random),
            "pair_f01": lambda random: mutate_document(self.pairs["f01"]["MOD_0000.TXT"], random),
            "pair_raw": lambda random: mutate_bytes(self.pairs["f01"]["MOD_0000.RAW"], random),
            "json": lambda random: mutate_document(self.text, random),
        }
        self.kinds = [*self.containers, *self.flat]
        self.views = folder / "views"
        self.views.mkdir()
        write_png(self.views / "input_Cam000.png", np.zeros((6, 8, 3), np.uint8))
        self.readers: dict[str, Callable[[Path], object]] = {
            "tar": read_archive, "storage": read_archive, "png": read_picture, "png16": read_picture, "pfm": read_pfm,
            "mat": read_toolbox, "mat7": read_toolbox, "json": document_metadata, "view": self.read_views,
            "cfg": self.read_views, "pair": self.read_pair, "pair_f01": self.read_pair, "pair_raw": self.read_pair,
        }  # fmt: skip

    def mutant(self, number: int) -> Case:
        """Kind and bytes of one mutant."""
        random = Random(number)  # noqa: S311
        kind = random.choice(self.kinds)
        if kind in self.flat:
            return kind, self.flat[kind](random)
        seed = self.containers[kind]
        toc, chunks = seed.toc, dict(seed.chunks)
        style = random.randrange(5)
        if style == 0:
            toc = mutate_json(toc, random)
        elif style < 3:
            name = random.choice(list(chunks))
            chunk = chunks[name]
            chunks[name] = mutate_bytes(chunk, random) if isinstance(chunk, bytes) else mutate_json(chunk, random)
        data = Container(toc, chunks).to_bytes(random, wild=style == 3)
        return kind, mutate_bytes(data, random) if style == 4 else data

    def feed(self, kind: str, data: bytes, *, whole: bool) -> str:
        """Outcome of one mutant: "read", or the name of the FormatError; anything else is raised."""
        path = self.put(kind, data)
        try:
            self.readers.get(kind, read_container)(path)
            if whole:
                str(describe(path))
                if kind in self.containers or kind.startswith("pair"):
                    xr.open_dataset(path, engine="lfp", accept_damaged=True).load()
        except FormatError as error:
            if len(str(error)) > 4000 or not str(error).isprintable():
                raise AssertionError(f"message {str(error)[:200]!r}") from error
            return type(error).__name__
        return "read"

    def put(self, kind: str, data: bytes) -> Path:
        """Write a mutant, and what it needs beside it, under a name of its kind."""
        names = {"png": "a_eslf.png", "png16": "a_eslf.png", "json": "frame.json", "storage": "data.C.0"}
        path = self.folder / names.get(kind, "a.bin")
        if kind in ("cfg", "view"):
            for other in ("parameters.cfg", "input_Cam004.png"):
                (self.views / other).unlink(missing_ok=True)
            path = self.views / ("parameters.cfg" if kind == "cfg" else "input_Cam004.png")
        elif kind.startswith("pair"):
            for name, whole in self.pairs["illum" if kind == "pair" else "f01"].items():
                (self.folder / name).write_bytes(whole)
            path = self.folder / ("MOD_0000.RAW" if kind == "pair_raw" else "MOD_0000.TXT")
        path.write_bytes(data)
        return path

    def read_views(self, _: Path) -> None:
        """Read the folder that a mutant was put into."""
        open_views(self.views).isel(u=slice(0, 5)).load()

    def read_pair(self, path: Path) -> None:
        """Read the pair of which a mutant is one half."""
        read_frame(open_pair(path))


def json_of(value: Any) -> bytes:
    return json.dumps(value).encode()


def read_container(path: Path) -> None:
    container = open_container(path)
    if container_kind(container) == "rendering":
        rendering(container).load()
        return
    read_frame(raw_frame(container))
    read_hot_pixels(path)


def read_frame(frame: Frame) -> None:
    array = FrameArray(frame.region, frame.metadata.layout)
    array.rows(0, 1)
    array.rows(0, array.shape[0])


def read_archive(path: Path) -> None:
    for entry in archive_entries(path):
        if entry.frame is not None:
            read_frame(entry.frame)
            archive_frame(entry.path)


def read_toolbox(path: Path) -> None:
    open_toolbox(path).load()


def read_picture(path: Path) -> None:
    read_png(path)
    open_eslf(path).load()


def bound_memory(extra: int = 1 << 30) -> None:
    """Let any allocation of more than `extra` bytes beyond what the process has now fail."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + extra, resource.RLIM_INFINITY))


def run(numbers: Iterator[int], folder: Path) -> Counter[str]:
    """Feed mutants; every 20th takes all doors. Raises at the first that is not handled, naming its number."""
    fuzzer = Fuzzer(folder)
    fuzzer.feed("lfp", fuzzer.containers["lfp"].to_bytes(Random(0), wild=False), whole=True)  # noqa: S311
    outcomes: Counter[str] = Counter()

    def too_slow(*_: object) -> None:
        raise Slow

    previous = signal.signal(signal.SIGALRM, too_slow)
    try:
        for number in numbers:
            kind, data = fuzzer.mutant(number)
            signal.alarm(SECONDS)
            try:
                outcomes[f"{kind}: {fuzzer.feed(kind, data, whole=number % 20 == 0)}"] += 1
            except BaseException as error:
                raise AssertionError(f"mutant {number} ({kind}) ends in {type(error).__name__}: {error}") from error
            finally:
                signal.alarm(0)
    finally:
        signal.signal(signal.SIGALRM, previous)
    return outcomes


def fast_folder() -> str | None:
    """Memory-backed folder for the mutants, where the system has one."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # noqa: S108


def work(numbers: range) -> tuple[Counter[str], int, float, float]:
    """Outcomes of some mutants; the process they were fed in, its CPU seconds and its peak memory in MiB so far."""
    with Path(os.devnull).open("w") as silent:  # libjpeg speaks of every oddity on standard error
        os.dup2(silent.fileno(), sys.stderr.fileno())
    with tempfile.TemporaryDirectory(dir=fast_folder()) as folder:
        bound_memory(2 << 30)
        outcomes = run(iter(numbers), Path(folder))
    return outcomes, os.getpid(), time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutations", type=int, default=1_000_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    last = arguments.first + arguments.mutations
    shares = [range(first, min(first + SHARE, last)) for first in range(arguments.first, last, SHARE)]
    outcomes: Counter[str] = Counter()
    seconds: dict[int, float] = {}
    highest = 0.0
    with ProcessPoolExecutor(arguments.workers, multiprocessing.get_context("spawn")) as pool:
        for counted, process, used, peak in pool.map(work, shares):
            outcomes += counted
            seconds[process] = used
            highest = max(peak, highest)
            print(f"{outcomes.total()} mutants", file=sys.stderr)  # noqa: T201
    for outcome, count in sorted(outcomes.items()):
        print(f"{outcome:32} {count}")  # noqa: T201
    used = sum(seconds.values())
    print(f"{outcomes.total()} mutants, none unhandled; {used:.0f} CPU s, peak memory {highest:.0f} MiB")  # noqa: T201


if __name__ == "__main__":
    main()
