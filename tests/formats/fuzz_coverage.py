"""The fuzzer steered by coverage: ``python tests/formats/fuzz_coverage.py -runs=1000000``; needs atheris."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from random import Random

import atheris

import lfflow.formats.packing  # noqa: F401 - before the rest: numba compiles no instrumented code

with atheris.instrument_imports(include=["lfflow.formats"]):
    from fuzz_formats import Fuzzer, fast_folder


def steer(folder: Path) -> None:
    """Let atheris choose among bytes of its own and structure-aware mutants; the last byte says which reader."""
    fuzzer = Fuzzer(folder)

    def one(data: bytes) -> None:
        if data:
            fuzzer.feed(fuzzer.kinds[data[-1] % len(fuzzer.kinds)], data[:-1], whole=False)

    def mutate(data: bytes, max_size: int, seed: int) -> bytes:
        if Random(seed).random() < 0.5:  # noqa: S311
            return bytes(atheris.Mutate(data, max_size))
        kind, mutant = fuzzer.mutant(seed)
        return mutant[: max_size - 1] + bytes([fuzzer.kinds.index(kind)])

    atheris.Setup(sys.argv, one, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(dir=fast_folder()) as name:
        steer(Path(name))
