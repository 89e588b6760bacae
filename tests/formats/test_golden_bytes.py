"""Pictures written by hand, byte by byte as METHOD B.1 and B.2 lay them out, read through the engine."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from format_examples import PRIVATE, metadata_of

MAGIC = bytes.fromhex("89 4C 46 50 0D 0A 1A 0A  00 00 00 01  00 00 00 00")
TOC = bytes.fromhex("89 4C 46 4D 0D 0A 1A 0A  00 00 00 00")
CHUNK = bytes.fromhex("89 4C 46 43 0D 0A 1A 0A  00 00 00 00")

# Two rows of four samples; each row of bytes is one row of the sensor.
F01_BYTES = bytes.fromhex("FF F0 00 0A 80 A8" + "12 34 56 48 C0 01")
F01_SAMPLES = [[4095, 0, 168, 168], [0x123, 0x456, 1164, 1]]
ILLUM_BYTES = bytes.fromhex("10 10 FF 00 30" + "01 02 03 FF E4")
ILLUM_SAMPLES = [[64, 64, 1023, 0], [4, 9, 14, 1023]]


def reference(data: bytes) -> str:
    return "sha1-" + hashlib.sha1(data, usedforsecurity=False).hexdigest()


def section(magic: bytes, data: bytes) -> bytes:
    padding = bytes(-len(data) % 16)
    return magic + len(data).to_bytes(4, "big") + reference(data).encode() + bytes(35) + data + padding


def written_by_hand(path: Path, camera: str, image: bytes) -> Path:
    metadata = json.dumps(metadata_of(camera, 2, 4)).encode()
    private = json.dumps(PRIVATE).encode()
    names = ("metadataRef", "privateMetadataRef", "imageRef")
    frame = dict(zip(names, map(reference, (metadata, private, image)), strict=True))
    toc: dict[str, Any] = {"frames": [{"frame": frame}]}
    if camera == "f01":
        toc = {"picture": {"frameArray": [{"frame": frame}]}}
    sections = [section(TOC, json.dumps(toc).encode()), *(section(CHUNK, data) for data in (metadata, private, image))]
    path.write_bytes(MAGIC + b"".join(sections))
    return path


def test_twelve_bits_big_endian_of_an_f01(tmp_path) -> None:
    ds = xr.open_dataset(written_by_hand(tmp_path / "a.lfp", "f01", F01_BYTES))
    assert ds["raw"].values.tolist() == F01_SAMPLES
    assert ds["raw"][1, 2].item() / 4095 == pytest.approx(0.284249084249084, abs=1e-15)
    assert str(ds["cfa_pattern"].values) == "BGGR"
    assert ds["black_level"].values.tolist() == [168] * 4


def test_ten_bits_little_endian_of_an_illum(tmp_path) -> None:
    ds = xr.open_dataset(written_by_hand(tmp_path / "a.lfr", "illum", ILLUM_BYTES))
    assert ds["raw"].values.tolist() == ILLUM_SAMPLES
    assert str(ds["cfa_pattern"].values) == "GRBG"


@pytest.mark.parametrize(("camera", "image", "samples"), [("f01", F01_BYTES, F01_SAMPLES), ("illum", ILLUM_BYTES, ILLUM_SAMPLES)])  # fmt: skip  # noqa: E501
def test_every_window(tmp_path, camera, image, samples) -> None:
    raw = xr.open_dataset(written_by_hand(tmp_path / "a.lfp", camera, image), engine="lfp")["raw"]
    for row in range(2):
        assert raw[row].values.tolist() == samples[row]
        for column in range(4):
            assert raw[row, column].item() == samples[row][column]


def test_the_writer_writes_these_bytes(tmp_path) -> None:
    for camera, image, name in (("f01", F01_BYTES, "a.lfp"), ("illum", ILLUM_BYTES, "a.lfr")):
        ds = xr.open_dataset(written_by_hand(tmp_path / "hand.lfp", camera, image), engine="lfp")
        from lfflow.formats.lfp import write_lfp

        write_lfp(tmp_path / name, ds["raw"].values, metadata_of(camera, 2, 4), PRIVATE)
        data = (tmp_path / name).read_bytes()
        assert data[:16] == MAGIC
        assert section(CHUNK, image) in data
        assert data[16:28] == TOC
        assert len(data) % 16 == 0
