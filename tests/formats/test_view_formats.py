"""Views in folders, lenslet pictures and LFToolbox files: there and back, and refused when broken."""

from __future__ import annotations

import pickle

import cv2
import numpy as np
import pytest
import xarray as xr
from scipy.io import loadmat, savemat

from lfflow.formats.errors import (
    ChecksumError,
    FileFormatError,
    MetadataError,
    StructureError,
    TruncatedError,
    UnknownFormatError,
)
from lfflow.formats.pfm import read_pfm
from lfflow.formats.png import read_png, write_png
from lfflow.formats.toolbox import write_toolbox
from lfflow.formats.views import as_floats, write_views

DIMS = ("v", "u", "t", "s", "channel")


def light_field(side: int, height: int, width: int, bits: int, seed: int = 0) -> xr.Dataset:
    kind = np.uint8 if bits == 8 else np.uint16
    integers = np.random.default_rng(seed).integers(0, 1 << bits, (side, side, height, width, 3)).astype(kind)
    return xr.Dataset({"rgb": (DIMS, as_floats(integers))})


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("shape", [(3, 5), (3, 5, 3)])
def test_pngs_come_back(tmp_path, bits, shape) -> None:
    kind = np.uint8 if bits == 8 else np.uint16
    picture = np.random.default_rng(0).integers(0, 1 << bits, shape).astype(kind)
    write_png(tmp_path / "a.png", picture)
    back = read_png(tmp_path / "a.png")
    assert back.dtype == kind
    assert np.array_equal(back, picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2))
    bgr = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    assert np.array_equal(bgr[..., ::-1], back)


def test_lens_and_view_of_a_lenslet_picture(tmp_path) -> None:
    picture = np.zeros((28, 42, 3), np.uint8)
    picture[14 + 3, 28 + 5] = 255, 0, 51
    write_png(tmp_path / "a_eslf.png", picture)
    ds = xr.open_dataset(tmp_path / "a_eslf.png", engine="eslf")
    assert ds["u"].values.tolist() == list(range(-7, 7))
    assert ds["rgb"].sel(v=3 - 7, u=5 - 7, t=1, s=2).values.tolist() == pytest.approx([1, 0, 0.2])
    assert float(ds["rgb"].sum()) == pytest.approx(1.2)


def test_toolbox_order_of_axes(tmp_path) -> None:
    lf = np.zeros((3, 5, 4, 6, 4), np.uint16)
    lf[2, 1, 3, 5] = 65535, 0, 0, 13107
    for compressed in (False, True):
        savemat(tmp_path / "a.mat", {"other": np.arange(5), "LF": lf}, do_compression=compressed)
        ds = xr.open_dataset(tmp_path / "a.mat", engine="lftoolbox")
        assert ds["rgb"].sel(v=1, u=-1, t=3, s=5, channel="R") == 1
        assert float(ds["weight"].sel(v=1, u=-1, t=3, s=5)) == pytest.approx(0.2)
        assert float(ds["rgb"].sum()) == 1
    savemat(tmp_path / "b.mat", {"LF": lf[..., :3].astype(np.float32) / 65535})
    assert float(xr.open_dataset(tmp_path / "b.mat")["rgb"].sum()) == 1
    write_toolbox(tmp_path / "c.mat", ds)
    assert np.array_equal(loadmat(tmp_path / "c.mat")["LF"], lf)


def test_star_shaped_subset(tmp_path) -> None:
    ds = light_field(9, 4, 5, 8)
    row, column = np.divmod(np.arange(81), 9)
    star = (row == 4) | (column == 4) | (row == column) | (row + column == 8)
    write_views(tmp_path, ds)
    for number in np.flatnonzero(~star):
        (tmp_path / f"input_Cam{number:03d}.png").unlink()
    for with_parameters in (True, False):
        back = pickle.loads(pickle.dumps(xr.open_dataset(tmp_path, engine="views")))  # noqa: S301
        assert int(back["present"].sum()) == star.sum() == 33
        assert np.isnan(back["rgb"].sel(v=-4, u=-3).values).all()
        assert np.array_equal(back["rgb"].sel(v=-4, u=4).values, ds["rgb"][0, 8].values)
        if with_parameters:
            (tmp_path / "parameters.cfg").unlink()


def test_numbers_of_the_camera(tmp_path) -> None:
    ds = light_field(3, 2, 2, 8).assign_coords(baseline_mm=12.5, focal_length_mm=35.0, disp_max=1.75)
    write_views(tmp_path, ds)
    back = xr.open_dataset(tmp_path)
    assert float(back["baseline_mm"]) == 12.5
    assert float(back["disp_max"]) == 1.75
    assert back["focal_length_mm"].attrs["units"] == "mm"


def test_real_views(shared_data) -> None:
    ds = xr.open_dataset(shared_data / "hci" / "antinous", engine="views")
    assert ds["rgb"].shape == (9, 9, 512, 512, 3)
    bgr = cv2.imread(str(shared_data / "hci" / "antinous" / "input_Cam041.png"))
    assert np.array_equal(np.rint(ds["rgb"].sel(v=0, u=1).values * 255), bgr[..., ::-1])
    truth = read_pfm(shared_data / "hci" / "antinous" / "gt_disp_lowres.pfm")
    assert truth.shape == (512, 512)
    assert np.array_equal(truth, cv2.imread(str(shared_data / "hci" / "antinous" / "gt_disp_lowres.pfm"), -1))


def test_broken_folders(tmp_path) -> None:
    with pytest.raises(UnknownFormatError):
        xr.open_dataset(tmp_path, engine="views")
    write_views(tmp_path, light_field(3, 4, 5, 8))
    view = tmp_path / "input_Cam004.png"
    whole = view.read_bytes()
    view.write_bytes(whole[:-20])
    with pytest.raises(TruncatedError):
        xr.open_dataset(tmp_path, engine="views")["rgb"].load()
    view.write_bytes(whole[:60] + bytes([whole[60] ^ 1]) + whole[61:])
    with pytest.raises(ChecksumError):
        xr.open_dataset(tmp_path, engine="views")["rgb"].load()
    write_png(view, np.zeros((2, 2), np.uint8))
    with pytest.raises(StructureError, match="2 sizes"):
        xr.open_dataset(tmp_path, engine="views")
    view.write_bytes(whole)
    (tmp_path / "parameters.cfg").write_text("[extrinsics]\nnum_cams_x = 1e300\nnum_cams_y = 1e300\n")
    with pytest.raises(MetadataError, match="grid"):
        xr.open_dataset(tmp_path, engine="views")


def test_broken_maps_and_matrices(tmp_path) -> None:
    for text in (
        b"",
        b"PF",
        b"Pf\n999999999 999999999\n-1\n",
        b"Pf\n2 2\n0\n" + bytes(16),
        b"Pf\n2 2\n-1\n" + bytes(15),
    ):
        (tmp_path / "a.pfm").write_bytes(text)
        with pytest.raises(FileFormatError):
            read_pfm(tmp_path / "a.pfm")
    for name, values in (("LG", np.zeros((3, 3, 2, 2, 3))), ("LF", np.zeros((3, 3))), ("LF", "text")):
        savemat(tmp_path / "a.mat", {name: values})
        with pytest.raises(FileFormatError):
            xr.open_dataset(tmp_path / "a.mat", engine="lftoolbox")
