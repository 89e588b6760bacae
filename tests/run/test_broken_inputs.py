"""Inputs that are broken in every way: the rest is finished, each has its reason, later runs retry the changed ones."""

from __future__ import annotations

import json
import os
import random
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_chain import FAKE
from fake_stores import store_content
from fault_tools import lines

from lfflow.cli.status import status
from lfflow.collection import open_collection
from lfflow.formats.lfp import write_lfp
from lfflow.run import Options, run_collection
from lfflow.run.chain import open_damaged_lfp, open_lfp
from lfflow.run.executors import Workers

FORMATS = Path(__file__).parents[1] / "formats"
CHAIN = replace(FAKE, open_raw=open_lfp)
SIZE = 40


@pytest.fixture
def generators(monkeypatch):
    """The mutations of the formats' own tests."""
    monkeypatch.syspath_prepend(FORMATS)
    import format_examples
    import format_mutations

    return format_examples, format_mutations


def write_good(path: Path, seed: int, metadata: dict, *, white: bool = False) -> Path:
    frame = np.random.default_rng(seed).integers(0, 4096, (SIZE, SIZE)).astype("uint16")
    write_lfp(path, frame, metadata, {"camera": {"serialNumber": "A1"}}, white=white)
    return path


def breakages(good: bytes, metadata: dict, mutations, rng: random.Random) -> dict[str, bytes]:
    """Content of files that are broken for certain, by what is wrong with them."""
    sections = [at for at in range(len(good)) if good.startswith((b"\x89LFC", b"\x89LFM"), at)]

    def with_length(at: int, length: int) -> bytes:
        return good[: at + 12] + struct.pack(">I", length) + good[at + 16 :]

    def flipped(at: int) -> bytes:
        return good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :]

    def container(changed: dict) -> bytes:
        frame = {"metadataRef": "@metadata", "imageRef": "@image", "privateMetadataRef": "@private"}
        toc = {"picture": {"frameArray": [{"frame": frame}]}}
        chunks = {"image": bytes(SIZE * SIZE * 3 // 2), "metadata": changed, "private": {}}
        return mutations.Container(toc, chunks).to_bytes(rng, wild=False)

    image = metadata["image"]
    return {
        "empty": b"",
        "text": b"this is no picture\n" * 40,
        "jpeg": b"\xff\xd8\xff\xe0" + bytes(500),
        "cut_in_the_magic": good[:7],
        "cut_in_a_header": good[: sections[1] + 5],
        "cut_in_the_image": good[: int(len(good) * 0.4)],
        "cut_at_the_end": good[:-200],
        "long_section": with_length(sections[0], 2**31),
        "short_section": with_length(sections[1], 3),
        "flip_in_the_image": flipped(max(sections[1] + 700, len(good) // 3)),
        "flip_in_the_toc": flipped(sections[0] + 100),
        "rubbish_in_the_middle": good[: sections[1]] + rng.randbytes(300) + good[sections[1] :],
        "wider_than_its_image": container({**metadata, "image": {**image, "width": 4096}}),
        "negative_size": container({**metadata, "image": {**image, "height": -40}}),
        "huge_size": container({**metadata, "image": {**image, "height": 10**9, "width": 10**9}}),
        "no_image": container({**metadata, "image": None}),
        "deep": container({**metadata, "image": json.loads("[" * 300 + "]" * 300)}),
        "text_for_numbers": container({**metadata, "image": {**image, "width": "x", "height": []}}),
    }


def make_inputs(folder: Path, generators, *, good: int, mutants: int):
    examples, mutations = generators
    rng = random.Random(7)  # noqa: S311
    folder.mkdir()
    metadata = examples.metadata_of("f01", SIZE, SIZE)
    write_good(folder / "WHITE.lfp", 1, metadata, white=True)
    for number in range(good):
        write_good(folder / f"GOOD_{number:03d}.lfp", 10 + number, metadata)
    whole = (folder / "GOOD_000.lfp").read_bytes()
    broken = breakages(whole, metadata, mutations, rng)
    for name, data in broken.items():
        (folder / f"BROKEN_{name}.lfp").write_bytes(data)
    (folder / "BROKEN_link.lfp").symlink_to(folder / "nothing")
    for number in range(mutants):
        data = mutations.mutate_bytes(whole, rng)
        while data == whole:
            data = mutations.mutate_bytes(whole, rng)
        (folder / f"MUTANT_{number}.lfp").write_bytes(data)
    return [f"BROKEN_{name}" for name in broken]


def run(out, captures):
    return run_collection(out, Options(inputs=(captures,), workers=Workers("threads", 2)), CHAIN)


def check_broken(tmp_path, generators, calls, *, good, mutants):
    broken = make_inputs(tmp_path / "in", generators, good=good, mutants=mutants)
    outcome = run(tmp_path / "col", tmp_path / "in")
    assert outcome.exit_code == 2
    assert set(broken) <= set(outcome.failed), "a broken file passed for a good one"
    assert not [name for name in outcome.failed if name.startswith(("GOOD", "WHITE"))]
    assert all(outcome.failed[name] and "Traceback" not in outcome.failed[name] for name in broken)
    done = set(open_collection(tmp_path / "col").open("disparity").capture.values)
    assert done >= {f"GOOD_{number:03d}" for number in range(good)}
    command = [sys.executable, "-m", "lfflow", "status", str(tmp_path / "col"), "--failed", "--json"]
    listed = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)["failed"]
    assert listed.keys() == outcome.failed.keys()
    calls.write_text("")
    assert run(tmp_path / "col", tmp_path / "in").failed == outcome.failed
    assert lines(calls) == [], "what is broken or done was tried again"
    mended = tmp_path / "in" / f"{broken[3]}.lfp"
    metadata = generators[0].metadata_of("f01", SIZE, SIZE)
    write_good(mended, 999, metadata)
    os.utime(mended)
    again = run(tmp_path / "col", tmp_path / "in")
    assert sorted(lines(calls)) == [f"disparity {broken[3]}", f"lightfield {broken[3]}"]
    assert again.failed.keys() == outcome.failed.keys() - {broken[3]}


def test_broken_inputs_fail_alone_with_their_reasons(tmp_path, generators, calls):
    check_broken(tmp_path, generators, calls, good=3, mutants=3)


@pytest.mark.heavy
def test_one_in_twenty_broken_inputs_fails_alone(tmp_path, generators, calls):
    check_broken(tmp_path, generators, calls, good=500, mutants=8)


def test_good_captures_have_the_same_bits_beside_broken_ones(tmp_path, generators):
    make_inputs(tmp_path / "in", generators, good=2, mutants=0)
    run(tmp_path / "mixed", tmp_path / "in")
    for path in (tmp_path / "in").glob("BROKEN*"):
        path.unlink()
    run(tmp_path / "clean", tmp_path / "in")
    assert store_content(tmp_path / "mixed") == store_content(tmp_path / "clean")


def flip_a_sample(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 1
    path.write_bytes(data)


def test_damage_that_was_accepted_is_recorded_and_shown(tmp_path, generators, capsys):
    metadata = generators[0].metadata_of("f01", SIZE, SIZE)
    (tmp_path / "in").mkdir()
    white = write_good(tmp_path / "in" / "WHITE.lfp", 1, metadata, white=True)
    scenes = [write_good(tmp_path / "in" / f"IMG_{number}.lfp", 10 + number, metadata) for number in range(3)]
    for path in (white, scenes[1]):
        flip_a_sample(path)
    assert set(run(tmp_path / "col", tmp_path / "in").failed) == {"WHITE", "IMG_1"}
    chain = replace(CHAIN, open_damaged=open_damaged_lfp)
    options = Options(inputs=(tmp_path / "in",), workers=Workers("threads", 2), accept_damaged=True)
    assert run_collection(tmp_path / "col", options, chain).exit_code == 0
    assert run(tmp_path / "col", tmp_path / "in").counts == {"kept": 7}
    col = open_collection(tmp_path / "col")
    assert col.query("damaged != ''") == ["IMG_1", "WHITE"]
    assert all("SHA-1" in words for words in col.status()["damaged"].values())
    assert list(col.ledger.find("disparity", "IMG_1").damaged) == [str(scenes[1]), str(white)]
    assert list(col.ledger.find("lightfield", "IMG_0").damaged) == [str(white)], "what a result was made of is hidden"
    status(str(tmp_path / "col"))
    assert "taken although damaged\n  IMG_1  section at byte" in capsys.readouterr().out
    status(str(tmp_path / "col"), why="IMG_1")
    assert f"made of damaged files\n  {scenes[1]} " in capsys.readouterr().out
    (tmp_path / "col" / "catalogue.parquet").unlink()
    assert run_collection(tmp_path / "col", options, chain).counts == {"kept": 7}
    assert open_collection(tmp_path / "col").query("damaged != ''") == ["IMG_1", "WHITE"]
    write_good(scenes[1], 99, metadata)
    assert run(tmp_path / "col", tmp_path / "in").counts == {"done": 2, "kept": 5}
    assert open_collection(tmp_path / "col").query("damaged != ''") == ["WHITE"]
