"""What real files contain and ours do not: odd texts, missing keys, many frames, and what recovery tools leave."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr
from format_examples import PRIVATE, metadata_of

from lfflow.formats.container import chunk_id, open_container, write_container
from lfflow.formats.errors import StructureError
from lfflow.formats.lfp import read_hot_pixels, write_lfp
from lfflow.formats.packing import pack
from lfflow.schema import RAW

HEIGHT, WIDTH = 4, 8
SAMPLES = np.random.default_rng(0).integers(0, 1024, (HEIGHT, WIDTH)).astype(np.uint16)


def packed(camera: str = "f01") -> bytes:
    from lfflow.formats.layout import PACKINGS

    return pack(SAMPLES, PACKINGS[12, "big"] if camera == "f01" else PACKINGS[10, "little"])


def assembled(path, metadata: bytes, private: bytes | None = None, *, toc: dict[str, Any] | None = None, more=None):
    """A container of these texts and the samples."""
    image = packed()
    frame = {"metadataRef": chunk_id(metadata), "imageRef": chunk_id(image), **(more or {})}
    if private is not None:
        frame["privateMetadataRef"] = chunk_id(private)
    contents = toc or {"picture": {"frameArray": [{"frame": frame}]}}
    write_container(path, contents, [part for part in (metadata, private, image) if part is not None])
    return path


def read(path) -> xr.Dataset:
    ds = xr.open_dataset(path, engine="lfp")
    RAW.check(ds)
    assert np.array_equal(ds["raw"].values, SAMPLES)
    return ds


TEXT = json.dumps(metadata_of("f01", HEIGHT, WIDTH)).encode()


@pytest.mark.parametrize("around", [(b"\xef\xbb\xbf", b""), (b"", b"\0"), (b"", b"\0" * 40), (b"", b"\n\0\r\n\0 "), (b" \n", b"\t"), (b"\xef\xbb\xbf\r\n", b"\r\n\0")])  # fmt: skip  # noqa: E501
def test_texts_with_marks_and_padding(tmp_path, around) -> None:
    ds = read(assembled(tmp_path / "a.lfp", around[0] + TEXT + around[1], json.dumps(PRIVATE).encode() + around[1]))
    assert str(ds["camera_serial"].values) == "A202110453"
    assert json.loads(ds.attrs["metadata"]) == json.loads(TEXT)


def test_no_private_metadata(tmp_path) -> None:
    assert str(read(assembled(tmp_path / "a.lfp", TEXT))["camera_serial"].values) == ""
    for empty in ("", None):
        more = {"privateMetadataRef": empty}
        assert str(read(assembled(tmp_path / "a.lfp", TEXT, more=more))["camera_serial"].values) == ""


def test_private_metadata_that_were_cut_out(tmp_path) -> None:
    path = assembled(tmp_path / "a.lfp", TEXT, more={"privateMetadataRef": "sha1-" + "a" * 40})
    with pytest.raises(StructureError, match=r"privateMetadataRef: found no section"):
        xr.open_dataset(path, engine="lfp")
    ds = xr.open_dataset(path, engine="lfp", accept_damaged=True)
    assert "privateMetadataRef" in ds.attrs["damaged"]
    assert np.array_equal(ds["raw"].values, SAMPLES)


@pytest.mark.parametrize("keys", [("devices",), ("camera",), ("type",), ("devices", "mla"), ("devices", "lens"), ("devices", "clock"), ("devices", "shutter"), ("image", "color"), ("image", "orientation"), ("devices", "sensor", "iso"), ("devices", "lens", "exitPupilOffset")])  # fmt: skip  # noqa: E501
def test_missing_keys(tmp_path, keys) -> None:
    metadata = metadata_of("f01", HEIGHT, WIDTH)
    at = metadata
    for key in keys[:-1]:
        at = at[key]
    del at[keys[-1]]
    read(assembled(tmp_path / "a.lfp", json.dumps(metadata).encode()))


def test_values_of_other_types(tmp_path) -> None:
    metadata = metadata_of("f01", HEIGHT, WIDTH)
    metadata["devices"]["lens"] |= {"zoomStep": "981", "focusStep": None, "fNumber": [1.9], "temperature": True}
    metadata["image"]["orientation"] = "up"
    metadata["camera"]["model"] = 1
    ds = read(assembled(tmp_path / "a.lfp", json.dumps(metadata).encode()))
    assert all(np.isnan(ds[name]) for name in ("zoom_step", "focus_step", "f_number", "temperature"))
    assert int(ds["orientation"]) == 1
    assert str(ds["camera_model"].values) == ""


def test_of_several_frames_the_first_is_the_picture(tmp_path) -> None:
    other = {"frame": {"metadataRef": "sha1-" + "1" * 40, "imageRef": "sha1-" + "2" * 40}}
    first = {"frame": {"metadataRef": chunk_id(TEXT), "imageRef": chunk_id(packed())}}
    for toc in ({"picture": {"frameArray": [first, other]}}, {"frames": [first, other, other]}):
        read(assembled(tmp_path / "a.lfp", TEXT, toc=toc))


@pytest.mark.parametrize("name", ["IMG.lfp", "IMG.LFP", "IMG.lfr", "IMG.LFR", "IMG.lfx", "IMG", "IMG.0001"])
@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_names_of_every_kind(tmp_path, name, camera) -> None:
    write_lfp(tmp_path / name, SAMPLES, metadata_of(camera, HEIGHT, WIDTH), PRIVATE)
    assert np.array_equal(xr.open_dataset(tmp_path / name)["raw"].values, SAMPLES)


def pieces(path) -> list[bytes]:
    data = path.read_bytes()
    return [data[s.offset : s.region.offset + s.region.length] for s in open_container(path).sections]


def test_contents_behind_the_chunks_and_chunks_of_nobody(tmp_path) -> None:
    path = assembled(tmp_path / "a.lfp", TEXT, json.dumps(PRIVATE).encode())
    head, parts = path.read_bytes()[:16], pieces(path)
    empty = b"\x89LFC\r\n\x1a\n" + bytes(8)
    orphan = pieces(assembled(tmp_path / "b.lfp", TEXT + b" "))[1]
    for order in ([*parts[1:], parts[0]], [empty, *parts, empty], [orphan, *reversed(parts)], [*parts, parts[-1]]):
        for padding in (0, 1, 15, 16, 500):
            path.write_bytes(head + b"".join(part + bytes(padding) for part in order))
            read(path)


def test_ids_in_capitals_and_text_behind_them(tmp_path) -> None:
    path = assembled(tmp_path / "a.lfp", TEXT)
    image = chunk_id(packed()).encode()
    data = path.read_bytes()
    path.write_bytes(data.replace(image + bytes(35), b"sha1-" + image[5:].upper() + b"\0" * 5 + b"x" * 30))
    read(path)


def test_what_a_recovery_tool_leaves(tmp_path) -> None:
    """Garbage behind the last section, or a last section that is cut: told, and read when damage is accepted."""
    path = assembled(tmp_path / "a.lfp", TEXT)
    whole = path.read_bytes()
    thumbnail = pieces(assembled(tmp_path / "b.lfp", TEXT + b" "))[1]
    for tail in (b"\xff\xd8 of the next file" * 50, b"\0" * 100 + b"rest", thumbnail[:-30], thumbnail[:50]):
        path.write_bytes(whole + tail)
        with pytest.raises(Exception, match="section at byte"):
            xr.open_dataset(path, engine="lfp")
        ds = xr.open_dataset(path, engine="lfp", accept_damaged=True)
        assert np.array_equal(ds["raw"].values, SAMPLES)
        assert "section at byte" in ds.attrs["damaged"]


def test_the_contents_of_a_real_illum_picture(tmp_path) -> None:
    """References that lfflow has no use for, as an Illum's table of contents lists them."""
    names = ("aberrationCorrectionRef", "exposureHistogramRef", "geometryCorrectionRef", "reconstructionFilterRef")
    parts = {name: name.encode() * 9 for name in names}
    metadata, image = json.dumps(metadata_of("illum", HEIGHT, WIDTH)).encode(), packed("illum")
    frame = {"metadataRef": chunk_id(metadata), "imageRef": chunk_id(image), "hotPixelRef": ""}
    frame |= {name: chunk_id(data) for name, data in parts.items()}
    toc = {
        "derivations": ["sha1-7323df2b9028ce1732c22e0758db71d4af1fc4f1"], "views": [], "annotations": [],
        "schema": "http://schema.lytro.com/lfp/picture/2.1.4/picture_schema.json", "generators": ["lightning"],
        "thumbnails": [{"width": 704, "height": 480, "imageRef": chunk_id(b"jpeg"), "representation": "jpeg"}],
        "frames": [{"assignedProperties": {}, "accelerations": [], "frame": frame}],
    }  # fmt: skip
    write_container(tmp_path / "a.LFR", toc, [*parts.values(), b"jpeg", metadata, image])
    ds = read(tmp_path / "a.LFR")
    assert str(ds["camera_model"].values) == "B01"
    assert read_hot_pixels(tmp_path / "a.LFR").sizes["hot_pixel"] == 0
    assert json.loads(ds.attrs["table_of_contents"]) == toc


def test_samples_that_are_shifted(tmp_path) -> None:
    metadata = metadata_of("f01", HEIGHT, WIDTH, 16)
    details = metadata["image"]["rawDetails"]
    sites = ("r", "gr", "gb", "b")
    details["pixelFormat"] = {"rightShift": 4, "black": dict.fromkeys(sites, 168), "white": dict.fromkeys(sites, 4095)}
    image = (SAMPLES.astype("<u2") << 4).tobytes()
    frame = {"metadata": metadata, "imageRef": chunk_id(image)}
    write_container(tmp_path / "a.lfp", {"frames": [{"frame": frame}]}, [image])
    assert read(tmp_path / "a.lfp")["white_level"].values.tolist() == [4095] * 4
    write_lfp(tmp_path / "b.lfp", SAMPLES, metadata)
    assert image in (tmp_path / "b.lfp").read_bytes()
