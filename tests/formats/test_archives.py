"""Calibration archives and RAW + TXT pairs: every image is found, none is extracted, tricks are refused."""

from __future__ import annotations

import io
import tarfile

import numpy as np
import pytest
import xarray as xr
from format_examples import PRIVATE, metadata_of

from lfflow.formats.archives import archive_entries, archive_members, is_archive, open_entry, write_storage
from lfflow.formats.container import chunk_id, write_container
from lfflow.formats.errors import (
    ChecksumError,
    FileFormatError,
    LimitError,
    StructureError,
    TruncatedError,
    UnsupportedError,
)
from lfflow.formats.raw_pair import pair_bytes, write_pair
from lfflow.formats.region import Region
from lfflow.formats.tar import tar_members
from lfflow.schema import RAW


def images(camera: str, count: int = 3) -> dict[str, tuple[np.ndarray, bytes, bytes]]:
    found = {}
    for number in range(count):
        raw = np.random.default_rng(number).integers(0, 1000, (6, 10)).astype(np.uint16)
        metadata = metadata_of(camera, 6, 10)
        metadata["devices"]["lens"]["zoomStep"] = 100 * number
        tags = {"white": number > 0, "dark": number == 0}
        found[f"MOD_{number:04d}"] = (raw, *pair_bytes(raw, metadata, PRIVATE, **tags))
    return found


def tar_of(members: dict[str, bytes], **changes: object) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.GNU_FORMAT) as tar:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            for key, value in changes.items():
                setattr(info, key, value)
            tar.addfile(info, io.BytesIO(data))
    return buffer.getvalue()


@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_images_of_an_archive(tmp_path, camera) -> None:
    contents = images(camera)
    files = {}
    for name, (_, raw, text) in contents.items():
        prefix = "C:\\T1CALIB\\" if camera == "f01" else "unitdata/"
        files |= {f"{prefix}{name}.TXT": text, f"{prefix}{name}.RAW": raw}
    files["C:\\CALIB\\WIFI_MAC_ADDR.TXT"] = b"00:11:22"
    path = tmp_path / ("data.C.0" if camera == "f01" else "caldata-B5143909630.tar")
    if camera == "f01":
        write_storage(path, files)
    else:
        path.write_bytes(tar_of(files))
    entries = list(archive_entries(path))
    assert [entry.name for entry in entries] == ["MOD_0000.RAW", "MOD_0001.RAW", "MOD_0002.RAW"]
    assert [entry.kind for entry in entries] == ["dark", "white", "white"]
    assert [entry.zoom for entry in entries] == [0, 100, 200]
    assert {entry.serial for entry in entries} == {"A202110453"}
    for entry in entries:
        ds = xr.open_dataset(entry.path, engine="lfp")
        RAW.check(ds)
        assert np.array_equal(ds["raw"].values, contents[entry.name[:8]][0])
        assert ds.identical(entry.open())


def test_a_damaged_image_in_a_storage_container_is_noticed(tmp_path) -> None:
    name, (_, raw, text) = next(iter(images("f01").items()))
    path = tmp_path / "data.C.1"
    write_storage(path, {f"C:\\{name}.RAW": raw, f"C:\\{name}.TXT": text})
    data = bytearray(path.read_bytes())
    data[data.find(raw) + 3] ^= 1
    path.write_bytes(data)
    (entry,) = archive_entries(path)
    with pytest.raises(ChecksumError, match=r"MOD_0000\.RAW"):
        entry.open().load()
    (entry,) = archive_entries(path, accept_damaged=True)
    assert "SHA-1" in entry.open().attrs["damaged"]


def test_an_image_without_metadata_is_listed_with_its_error(tmp_path) -> None:
    contents = images("illum", 2)
    files = {"MOD_0000.RAW": contents["MOD_0000"][1], "MOD_0001.RAW": b"short", "MOD_0001.TXT": contents["MOD_0001"][2]}
    path = tmp_path / "caldata.tar"
    path.write_bytes(tar_of(files))
    first, second = archive_entries(path)
    assert "MOD_0000.TXT" in str(first.error)
    assert "5 bytes" in str(second.error)
    with pytest.raises(FileFormatError):
        first.open()


def test_names_that_try_to_leave_are_names_only(tmp_path) -> None:
    _, raw, text = images("illum", 1)["MOD_0000"]
    path = tmp_path / "caldata.tar"
    path.write_bytes(tar_of({"../../../etc/MOD_0000.RAW": raw, "/abs/olute/MOD_0000.TXT": text, "x" * 200: b""}))
    before = sorted(tmp_path.rglob("*"))
    (entry,) = archive_entries(path)
    assert entry.name == "MOD_0000.RAW"
    entry.open().load()
    assert sorted(tmp_path.rglob("*")) == before
    assert archive_members(path)[2].name == "x" * 200


def test_links_are_passed_over(tmp_path) -> None:
    path = tmp_path / "caldata.tar"
    path.write_bytes(tar_of({"MOD_0000.RAW": b""}, type=tarfile.SYMTYPE, linkname="/etc/passwd"))
    assert list(archive_entries(path)) == []


def test_broken_tars_are_refused(tmp_path) -> None:
    whole = tar_of({"MOD_0000.RAW": bytes(5000)})
    path = tmp_path / "caldata.tar"
    path.write_bytes(whole[:3000])
    with pytest.raises(TruncatedError, match="2488 bytes before the file ends"):
        list(tar_members(str(path)))
    path.write_bytes(whole[:5632] + b"rubbish" * 100)
    with pytest.raises(StructureError, match="wrong checksum"):
        list(tar_members(str(path)))
    path.write_bytes(tar_of({"a": b""}, type=tarfile.GNUTYPE_SPARSE))
    with pytest.raises(UnsupportedError, match="sparse"):
        list(tar_members(str(path)))


def test_a_pair_opens_by_either_half(tmp_path) -> None:
    raw = np.random.default_rng(0).integers(0, 1024, (6, 10)).astype(np.uint16)
    write_pair(tmp_path / "MOD_0007.RAW", raw, metadata_of("illum", 6, 10), PRIVATE)
    for name in ("MOD_0007.RAW", "MOD_0007.TXT"):
        ds = xr.open_dataset(tmp_path / name)
        RAW.check(ds)
        assert np.array_equal(ds["raw"].values, raw)
        assert str(ds["kind"].values) == "white"
        assert str(ds["capture"].values) == "MOD_0007"
    (tmp_path / "MOD_0007.TXT").unlink()
    with pytest.raises(FileFormatError):
        xr.open_dataset(tmp_path / "MOD_0007.RAW", engine="lfp")


def test_real_metadata_of_an_illum_white_image(tmp_path, shared_data) -> None:
    text = (shared_data / "containers" / "imageio_Illum_lenslet_whiteimage.TXT").read_bytes()
    (tmp_path / "MOD_0001.TXT").write_bytes(text)
    with (tmp_path / "MOD_0001.RAW").open("wb") as file:
        file.truncate(51854880)
    ds = xr.open_dataset(tmp_path / "MOD_0001.RAW", engine="lfp")
    assert dict(ds["raw"].sizes) == {"y": 5368, "x": 7728}
    assert str(ds["kind"].values) == "white"
    assert str(ds["camera_serial"].values) == "B5143909630"
    assert float(ds["zoom_step"]) == -1040
    assert ds["time"].values == np.datetime64("2014-09-06T10:41:51", "ns")
    assert ds["raw"][5367, 7727].item() == 0


def test_an_entry_opens_by_archive_and_name(tmp_path) -> None:
    contents = images("f01")
    files = {f"C:\\T1CALIB\\{name}.{end}": data for name, (_, *two) in contents.items() for end, data in zip(("RAW", "TXT"), two, strict=True)}  # fmt: skip  # noqa: E501
    path = tmp_path / "data.C.0"
    write_storage(path, files)
    assert is_archive(path)
    for name in ("MOD_0002.RAW", "mod_0002.raw", "C:\\T1CALIB\\MOD_0002.RAW"):
        assert np.array_equal(open_entry(path, name)["raw"].values, contents["MOD_0002"][0])
    with pytest.raises(StructureError, match=r"data\.C\.0: members: found 0 members 'mod_0009.raw', expected one"):
        open_entry(path, "MOD_0009.RAW")


def test_listing_is_lazy(tmp_path, monkeypatch) -> None:
    contents = images("illum", 3)
    files = {f"{name}.{end}": data for name, (_, *two) in contents.items() for end, data in zip(("RAW", "TXT"), two, strict=True)}  # fmt: skip  # noqa: E501
    path = tmp_path / "caldata.tar"
    path.write_bytes(tar_of(files))
    read = []
    original = Region._read
    monkeypatch.setattr(Region, "_read", lambda self, file, *at: read.append(self.name) or original(self, file, *at))
    listing = archive_entries(path)
    assert next(listing).name == "MOD_0000.RAW"
    assert read == ["member 'MOD_0000.TXT'"]


def test_a_name_in_two_folders_is_told_with_its_folder(tmp_path) -> None:
    (one, *first), (two, *second) = images("f01", 2).values()
    path = tmp_path / "data.C.0"
    ends = ("RAW", "TXT")
    files = {f"C:\\{folder}\\MOD_0000.{end}": data for folder, pair in (("A", first), ("B", second)) for end, data in zip(ends, pair, strict=True)}  # fmt: skip  # noqa: E501
    write_storage(path, files)
    entries = list(archive_entries(path))
    assert [entry.name for entry in entries] == ["C:\\A\\MOD_0000.RAW", "C:\\B\\MOD_0000.RAW"]
    assert [entry.zoom for entry in entries] == [0, 100]
    for entry, raw in zip(entries, (one, two), strict=True):
        assert np.array_equal(xr.open_dataset(entry.path, engine="lfp")["raw"].values, raw)
    with pytest.raises(StructureError, match="2 members"):
        open_entry(path, "MOD_0000.RAW")


def test_the_text_of_an_image_may_lie_in_the_next_archive(tmp_path) -> None:
    raw, image, text = images("f01", 1)["MOD_0000"]
    write_storage(tmp_path / "data.C.0", {"C:\\T1CALIB\\MOD_0000.RAW": image})
    write_storage(tmp_path / "data.C.1", {"C:\\T1CALIB\\MOD_0000.TXT": text})
    (entry,) = archive_entries(tmp_path / "data.C.0")
    assert entry.serial == "A202110453"
    assert np.array_equal(entry.open()["raw"].values, raw)


def test_a_section_under_thousands_of_names_is_refused(tmp_path) -> None:
    data = bytes(1000)
    listed = [{"name": f"MOD_{number:04d}.TXT", "dataRef": chunk_id(data)} for number in range(9999)]
    write_container(tmp_path / "data.C.0", {"files": listed}, [data])
    with pytest.raises(LimitError, match="at most 8 times"):
        archive_members(tmp_path / "data.C.0")


def test_an_archive_is_not_one_picture(tmp_path) -> None:
    _, raw, text = images("f01", 1)["MOD_0000"]
    write_storage(tmp_path / "data.C.0", {"C:\\MOD_0000.RAW": raw, "C:\\MOD_0000.TXT": text})
    (tmp_path / "caldata.tar").write_bytes(tar_of({"MOD_0000.RAW": raw, "MOD_0000.TXT": text}))
    for name in ("data.C.0", "caldata.tar"):
        with pytest.raises(UnsupportedError, match="found an archive of many images, expected one of them"):
            xr.open_dataset(tmp_path / name)


def test_what_is_no_archive(tmp_path) -> None:
    write_container(tmp_path / "a.lfp", {"frames": []}, [])
    (tmp_path / "b").write_bytes(b"x" * 600)
    (tmp_path / "c").write_bytes(b"")
    assert not any(is_archive(tmp_path / name) for name in ("a.lfp", "b", "c", "none"))
