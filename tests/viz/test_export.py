from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "stages"))
from analytic_field import make_field

from lfflow.errors import LfflowError
from lfflow.formats.eslf import open_eslf
from lfflow.formats.pfm import read_pfm
from lfflow.formats.toolbox import open_toolbox
from lfflow.formats.views import open_views
from lfflow.viz.export import Options, export_capture


@pytest.fixture(scope="module")
def capture() -> tuple[xr.Dataset, xr.Dataset]:
    lf, disp, _ = make_field([(-0.1, -99.0), (0.25, 10.0)], shape=(24, 20), radius=2)
    gains = ("channel", [1.0, 1.1, 1.7])
    return lf.assign_coords(channel=list("RGB"), white_balance=gains), disp


def test_views_come_back_as_written(capture: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    sizes = {"v": 5, "u": 5, "t": 20, "s": 20, "channel": 3}
    folder = export_capture(*capture, "views", tmp_path, "A")
    assert dict(open_views(folder).sizes) == sizes
    found = open_eslf(export_capture(*capture, "eslf", tmp_path, "A", Options(bits=16)))
    np.testing.assert_allclose(found["rgb"], open_views(folder)["rgb"], atol=1 / 254)
    assert dict(open_toolbox(export_capture(*capture, "toolbox", tmp_path, "A")).sizes) == sizes


def test_disparities_come_back_as_written(capture: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    values = read_pfm(export_capture(*capture, "pfm", tmp_path, "A"))
    assert set(np.unique(values.round(5))) == {np.float32(-0.1), np.float32(0.25)}
    levels = cv2.imread(str(export_capture(*capture, "png16", tmp_path, "A")), cv2.IMREAD_UNCHANGED)
    assert levels.dtype == np.uint16
    np.testing.assert_array_equal(levels[..., 0] if levels.ndim == 3 else levels, np.where(values > 0, 65535, 1))


@pytest.mark.parametrize("to", ["gif", "webp"])
def test_a_parallax_moves_for_ever(capture: tuple[xr.Dataset, xr.Dataset], to: str, tmp_path: Path) -> None:
    with Image.open(export_capture(*capture, to, tmp_path, "A", Options(scale=2.0))) as moving:
        assert moving.format == to.upper()
        assert (moving.n_frames, moving.info["loop"]) == (16, 0)
        assert moving.size == (39, 40)


def test_the_square_of_views_with_light_is_written(capture: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    lf, disp = capture
    dark = lf.copy(deep=True)
    dark["cfa"].loc[{"u": 2}] = 255
    assert dict(open_views(export_capture(dark, disp, "views", tmp_path, "A")).sizes)["u"] == 3


def test_pictures_for_people(capture: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    stack = export_capture(*capture, "focal-stack", tmp_path, "A", Options(planes=3))
    assert len(cv2.imreadmulti(str(stack))[1]) == 3
    cloud = export_capture(*capture, "ply", tmp_path, "A").read_bytes()
    assert b"element vertex 400\n" in cloud
    assert len(cloud) == cloud.index(b"end_header\n") + len(b"end_header\n") + 400 * 15


def test_points_are_in_metres_where_the_focus_is_told(capture: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    lf, disp = capture
    optics = {"focal_length": 0.00684, "pixel_pitch": 1.4e-6, "lens_pitch": 14e-6, "mla_offset_z": 25e-6}
    options = Options(focus_distance=0.8)
    file = export_capture(lf.assign_coords(optics), disp, "ply", tmp_path, "M", options).read_bytes()
    header, _, body = file.partition(b"end_header\n")
    assert b"metres" in header
    record = np.dtype([("place", "<f4", 3), ("tint", "u1", 3)])
    z = np.frombuffer(body, record)["place"][:, 2]
    behind = 1 / (1 / 0.00684 - 1 / 0.8)
    power = 1.4e-6 * behind**2 / (25e-6 * 14e-6)
    expected = [1 / (1 / 0.8 + d / power) for d in (0.25, -0.1)]
    np.testing.assert_allclose(np.unique(z.round(4)), expected, atol=2e-4)


def test_an_unknown_format_is_refused(capture: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    with pytest.raises(LfflowError, match="there are views"):
        export_capture(*capture, "bmp", tmp_path, "A")
