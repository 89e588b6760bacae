"""Raw pictures: written and read back, lazy, whole or refused."""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path

import dask
import numpy as np
import pytest
import xarray as xr
from format_examples import PRIVATE, metadata_of

from lfflow.formats import region as region_module
from lfflow.formats.container import open_container, write_container
from lfflow.formats.errors import ChecksumError, FileFormatError, StructureError, UnknownFormatError
from lfflow.formats.lfp import open_lfp, raw_frame, read_hot_pixels, write_lfp
from lfflow.formats.opening import verify
from lfflow.schema import RAW


@pytest.fixture
def picture(tmp_path, samples) -> Path:
    path = tmp_path / "IMG_0001.lfp"
    write_lfp(path, samples, metadata_of("f01", 24, 30), PRIVATE)
    return path


def flip(path: Path, offset: int, bit: int = 0) -> None:
    data = bytearray(path.read_bytes())
    data[offset] ^= 1 << bit
    path.write_bytes(bytes(data))


def image_section(path: Path):
    return next(section for section in open_container(path).sections if section.region.length == 24 * 45)


def test_typed_metadata(picture) -> None:
    ds = open_lfp(picture)
    assert str(ds["capture"].values) == "IMG_0001"
    assert str(ds["kind"].values) == "scene"
    assert str(ds["camera_model"].values) == "F01"
    assert str(ds["camera_serial"].values) == "A202110453"
    assert ds["time"].values == np.datetime64("2012-08-15T04:47:08", "ns")
    assert ds["time"].dtype == "datetime64[ns]"
    assert float(ds["zoom_step"]) == 981
    assert ds["white_balance"].values.tolist() == [1.0, 1.1171875, 1.72265625]
    assert ds["color_matrix"].values[0].tolist() == [2.25, -0.91, -0.34]
    assert ds["black_level"].sel(site="gr") == 168
    assert ds["mla_offset_z"].attrs["units"] == "m"


def test_kind_comes_from_the_tags(tmp_path, samples) -> None:
    for name, flags in (("white", {"white": True}), ("dark", {"dark": True})):
        write_lfp(tmp_path / name, samples, metadata_of("f01", 24, 30), **flags)
        assert str(open_lfp(tmp_path / name)["kind"].values) == name


def test_optional_metadata_may_be_missing(tmp_path, samples) -> None:
    metadata = metadata_of("f01", 24, 30)
    del metadata["devices"], metadata["camera"], metadata["image"]["color"]
    write_lfp(tmp_path / "a.lfp", samples, metadata)
    ds = open_lfp(tmp_path / "a.lfp")
    RAW.check(ds)
    assert np.isnan(ds["zoom_step"])
    assert np.isnat(ds["time"])
    assert np.isnan(ds["color_matrix"]).all()
    assert str(ds["camera_model"].values) == ""


def test_opening_and_windows_read_what_they_need(picture, monkeypatch) -> None:
    read: list[tuple[int, int]] = []
    original = region_module.Region._read

    def counted(self, file, start, length):
        read.append((self.offset + start, length))
        return original(self, file, start, length)

    monkeypatch.setattr(region_module.Region, "_read", counted)
    ds = xr.open_dataset(picture, engine="lfp")
    image = image_section(picture).region
    assert not any(begin == image.offset and length > 1000 for begin, length in read), "opening reads JSON only"
    read.clear()
    window = ds["raw"][4:6]
    assert not read
    window.load()
    assert read == [(image.offset + 4 * 45, 2 * 45)]


def test_windows_of_every_kind(picture, samples) -> None:
    raw = open_lfp(picture)["raw"]
    for key in (
        (slice(None, None, -3), slice(2, 9, 2)),
        (5, slice(None)),
        (slice(3, 3), 1),
        (-1, -1),
        ([3, 1, 9], [4]),
    ):
        expected = samples[key] if not isinstance(key[0], list) else samples[np.ix_(*key)]
        assert np.array_equal(raw[key].values, expected), key


def test_pickled_and_chunked_datasets_hold_the_same(picture, samples) -> None:
    ds = pickle.loads(pickle.dumps(open_lfp(picture)))  # noqa: S301
    assert np.array_equal(ds["raw"].values, samples)
    chunked = xr.open_dataset(picture, engine="lfp", chunks={"y": 7})
    assert chunked["raw"].chunksizes["y"] == (7, 7, 7, 3)
    with dask.config.set(scheduler="threads"):
        assert np.array_equal(chunked["raw"].values, samples)


def test_many_files_open_as_one(tmp_path, samples) -> None:
    for number in range(3):
        write_lfp(tmp_path / f"IMG_{number}.lfp", samples + number, metadata_of("f01", 24, 30, 16))
    ds = xr.open_mfdataset(sorted(tmp_path.glob("*.lfp")), engine="lfp", combine="nested", concat_dim="capture", coords="all", compat="override", join="override")  # fmt: skip  # noqa: E501
    assert ds["capture"].values.tolist() == ["IMG_0", "IMG_1", "IMG_2"]
    assert np.array_equal(ds["raw"].isel(capture=2).values, samples + 2)


def test_engine_is_guessed_from_the_magic_bytes(picture, samples) -> None:
    renamed = picture.rename(picture.with_name("stranger.bin"))
    assert np.array_equal(xr.open_dataset(renamed)["raw"].values, samples)


def test_any_flipped_bit_is_noticed(picture) -> None:
    size = picture.stat().st_size
    original = picture.read_bytes()
    for offset in [*range(130), *range(130, size, 7)]:
        flip(picture, offset, offset % 8)
        changed = picture.read_bytes()
        try:
            values = raw_frame(open_container(picture)).region.read()
        except FileFormatError:
            values = None
        # What lies between sections carries no data: padding, reserved fields.
        if values is not None:
            sections = open_container(picture).sections
            assert not any(s.region.offset <= offset < s.region.offset + s.region.length for s in sections), offset
        picture.write_bytes(original)
        assert changed != original


def test_a_flipped_bit_is_noticed_by_every_way_to_read(picture) -> None:
    region = image_section(picture).region
    good = open_lfp(picture)["raw"][:2].values
    verify(picture)
    flip(picture, region.offset + 700)
    ds = open_lfp(picture)
    with pytest.raises(ChecksumError, match="SHA-1"):
        verify(picture)
    for read in (lambda: ds["raw"].values, lambda: ds["raw"][:2].values, lambda: ds["raw"][0, 0].values):
        with pytest.raises(ChecksumError, match="SHA-1"):
            read()
    damaged = open_lfp(picture, accept_damaged=True)
    assert "SHA-1" in damaged.attrs["damaged"]
    assert np.array_equal(damaged["raw"][:2].values, good)


def test_accepted_damage_of_the_metadata_is_recorded(picture) -> None:
    data = picture.read_bytes()
    picture.write_bytes(data.replace(b'"iso" : 200', b'"iso" : 201'))
    with pytest.raises(ChecksumError):
        open_lfp(picture)
    ds = open_lfp(picture, accept_damaged=True)
    assert float(ds["iso"]) == 201
    assert "section at byte" in ds.attrs["damaged"]


def test_a_file_that_is_changed_after_it_was_read_is_checked_again(picture) -> None:
    ds = open_lfp(picture)
    ds["raw"][:2].load()
    flip(picture, image_section(picture).region.offset + 5)
    with pytest.raises(ChecksumError):
        open_lfp(picture)["raw"][:2].load()


@pytest.mark.parametrize("end", [0, 1, 8, 15, 16, 17, 31, 32, 60, 111, 112, 500, -1])
def test_a_cut_file_is_refused(picture, end) -> None:
    region = image_section(picture).region
    data = picture.read_bytes()[: region.offset + region.length]
    picture.write_bytes(data[:end])
    with pytest.raises(FileFormatError) as caught:
        open_lfp(picture)["raw"].load()
    assert str(picture) in str(caught.value)
    assert pickle.loads(pickle.dumps(caught.value)).args == caught.value.args  # noqa: S301


def test_chunks_in_any_order_and_padding(picture, samples) -> None:
    container = open_container(picture)
    whole = picture.read_bytes()
    pieces = [whole[s.offset : s.region.offset + s.region.length] for s in container.sections]
    picture.write_bytes(whole[:16] + b"".join(piece + bytes(3 + 5 * i) for i, piece in enumerate(reversed(pieces))))
    assert np.array_equal(open_lfp(picture)["raw"].values, samples)


def test_references_that_do_not_fit(picture, tmp_path) -> None:
    container = open_container(picture)
    chunks = [s.region.read() for s in container.sections if s.kind == "chunk"]
    toc = container.toc.value
    write_container(tmp_path / "missing.lfp", toc, chunks[:-1])
    with pytest.raises(StructureError, match=r"imageRef.*no section"):
        open_lfp(tmp_path / "missing.lfp")
    frame = toc["picture"]["frameArray"][0]["frame"]
    frame["imageRef"] = frame["metadataRef"]
    write_container(tmp_path / "size.lfp", toc, chunks)
    with pytest.raises(StructureError, match="1080 bytes by the metadata"):
        open_lfp(tmp_path / "size.lfp")


def test_something_else_is_refused(tmp_path) -> None:
    (tmp_path / "a.lfp").write_bytes(b"GIF89a and so on")
    with pytest.raises(UnknownFormatError, match="47 49 46"):
        open_lfp(tmp_path / "a.lfp")
    with pytest.raises(FileFormatError, match="No such file"):
        open_lfp(tmp_path / "b.lfp")


def test_illum_embeds_a_white_image_and_hot_pixels(tmp_path) -> None:
    rng = np.random.default_rng(0)
    raw, white = rng.integers(64, 1024, (2, 8, 10)).astype(np.uint16)
    path = tmp_path / "IMG.lfr"
    for embed in (False, True):
        write_lfp(path, raw, metadata_of("illum", 8, 10), PRIVATE, modulation=white, hot_pixels=([3, 4], [5, 7]), embed_metadata=embed)  # fmt: skip  # noqa: E501
        ds = xr.open_dataset(path, engine="lfp")
        assert str(ds["camera_model"].values) == "B01"
        assert float(ds["iso"]) == 122
        assert np.isnan(ds["gamma"])
        assert np.array_equal(ds["raw"].values, raw)
        for modulation in (xr.open_dataset(path, engine="lfp", image="modulation"), xr.open_dataset(f"{path}::modulation", engine="lfp")):  # fmt: skip  # noqa: E501
            assert str(modulation["kind"].values) == "white"
            assert np.array_equal(modulation["raw"].values, white)
        hot = read_hot_pixels(path)
        assert hot["x"].values.tolist() == [3, 4]
        assert hot["y"].values.tolist() == [5, 7]


def test_real_raw_pictures(shared_data) -> None:
    path = shared_data / "f01" / "IMG_1.lfp"
    ds = xr.open_dataset(path, engine="lfp")
    RAW.check(ds)
    packed = path.read_bytes()[608 : 608 + 16137600]
    assert hashlib.sha1(packed, usedforsecurity=False).hexdigest() == "f724d403c41eefa4f097a31d1533456a165586a0"
    first, second = packed[3280 * 3 // 2 * 171 :][141:143], packed[3280 * 3 // 2 * 171 :][142:144]
    assert ds["raw"][171, 94].item() == first[0] << 4 | first[1] >> 4
    assert ds["raw"][171, 95].item() == (second[0] & 15) << 8 | second[1]
    assert ds["raw"].values.max() == 4080
