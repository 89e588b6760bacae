"""Calibration archives and RAW + TXT pairs: every image is found, none is extracted, tricks are refused."""

from __future__ import annotations

import io
import tarfile

import numpy as np
import pytest
import xarray as xr
from format_examples import PRIVATE, metadata_of

from lfflow.formats.archives import archive_entries, archive_members, write_storage
from lfflow.formats.errors import ChecksumError, FileFormatError, StructureError, TruncatedError, UnsupportedError
from lfflow.formats.raw_pair import pair_bytes, write_pair
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
