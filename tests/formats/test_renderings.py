"""Derived pictures of Lytro's software, real ones."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from lfflow.formats.container import open_container, write_container
from lfflow.formats.errors import ChecksumError, FileFormatError, StructureError
from lfflow.formats.renderings import open_rendering


def test_refocus_stack_of_an_f01(shared_data) -> None:
    ds = xr.open_dataset(shared_data / "containers" / "behnam_IMG_0001-stk.lfp", engine="lfp")
    assert dict(ds.sizes) == {"depth_y": 20, "depth_x": 20, "layer": 12, "y": 1080, "x": 1080, "channel": 3}
    assert ds["refocus_lambda"].values[0] == pytest.approx(-8.9229278564453125)
    assert float(ds["depth"][0, 0]) == np.frombuffer(b"\x7f\xa0~@", "<f4")[0]
    layer = ds["picture"].isel(layer=3, y=slice(0, 1080, 200))
    assert layer.shape == (6, 1080, 3)
    assert np.array_equal(layer.values, ds["picture"].isel(layer=slice(3, 4)).values[0, ::200])


def test_depth_map_of_an_f01(shared_data) -> None:
    ds = xr.open_dataset(shared_data / "containers" / "behnam_IMG_0002-dm.lfp", engine="lfp")
    assert ds["depth"].shape == ds["confidence"].shape == (330, 330)
    assert float(ds["depth"][0, 0]) == 3.0
    assert 0 <= ds["confidence"].min() <= ds["confidence"].max() <= 1


def test_web_picture_of_an_illum(shared_data) -> None:
    ds = xr.open_dataset(shared_data / "containers" / "bkerley_illum_demo.LFP", engine="lfp")
    assert ds["picture"].shape == (10, 480, 704, 3)
    assert ds["depth"].shape == (60, 88)
    assert ds["refocus_lambda"].values.tolist() == [-15, -10, -7.5, -5, -1.5, 1.5, 5, 7.5, 10, 12.5]


def test_a_cut_raw_picture_is_refused(shared_data) -> None:
    with pytest.raises(StructureError, match=r"frameArray\[0\]\.frame\.imageRef: found no section"):
        xr.open_dataset(shared_data / "containers" / "exiftool_Lytro_truncated.lfp", engine="lfp")


def test_a_damaged_layer_is_noticed(shared_data, tmp_path) -> None:
    data = bytearray((shared_data / "containers" / "bkerley_illum_demo.LFP").read_bytes())
    data[-100] ^= 4
    (tmp_path / "a.lfp").write_bytes(data)
    ds = open_rendering(tmp_path / "a.lfp")
    assert ds["picture"].isel(layer=1).load().size
    with pytest.raises(ChecksumError):
        ds["picture"].isel(layer=0).load()


def test_a_jpeg_of_another_size_is_refused(shared_data, tmp_path) -> None:
    container = open_container(shared_data / "containers" / "bkerley_illum_demo.LFP")
    toc = container.toc.value
    toc["views"][0]["accelerations"][0]["width"] = 60000
    chunks = [s.region.read() for s in container.sections if s.kind == "chunk"]
    write_container(tmp_path / "a.lfp", toc, chunks)
    ds = open_rendering(tmp_path / "a.lfp")
    with pytest.raises(FileFormatError, match=r"JPEG of .*\(480, 704\)"):
        ds["picture"].isel(layer=0, y=0, x=0).load()
