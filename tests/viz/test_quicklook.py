"""What the pictures show, by their pixels."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr

from lfflow.lattice import Lattice
from lfflow.simulate import Layer, Scene, simulate_capture, simulate_white
from lfflow.simulate.texture import flat_texture
from lfflow.stages.demultiplex import demultiplex
from lfflow.viz.canvas import Canvas, coloured, palette
from lfflow.viz.display import to_square
from lfflow.viz.quicklook import _even_blur, draw_quicklook, quicklook, telling_row
from lfflow.viz.report import ReportRow, report_page

LATTICE = Lattice(10.0086, 10.0103, 0.00143, 3.3, 4.7)
SIZE = {"height": 260, "width": 260}
COLOUR = (0.3, 0.4, 0.2)


@pytest.fixture(scope="module")
def field() -> xr.Dataset:
    raw, _ = simulate_capture(LATTICE, Scene([Layer(flat_texture(COLOUR))]), noise=False, views=(0,), **SIZE)
    _, truth = simulate_white(LATTICE, noise=False, **SIZE)
    return demultiplex(raw, truth.rename(defects="pixel_flags"), radius=5).load()


@pytest.fixture(scope="module")
def disparity(field: xr.Dataset) -> xr.Dataset:
    t, s = field["t"], field["s"]
    d = xr.where((t == 12) & (s > 10), 0.4, 0.0) + 0 * s
    flags = xr.zeros_like(d, dtype=np.uint8)
    return xr.Dataset(
        {"disparity": d.astype("float32"), "disparity_std": (0.1 * abs(d)).astype("float32"), "flags": flags}
    )


def test_a_flat_scene_is_shown_in_one_colour_everywhere(field: xr.Dataset, disparity: xr.Dataset) -> None:
    sheet = quicklook(field, disparity).pixels
    picture = sheet[62 + 24 + 40 : 62 + 24 + 440, 24 + 40 : 24 + 448].reshape(-1, 3).astype(float)
    assert picture.std(axis=0).max() < 3
    assert picture.mean(axis=0).min() > 20


def test_the_lines_of_the_disparity_are_drawn_in_the_epipolar_image(field: xr.Dataset, disparity: xr.Dataset) -> None:
    pixels = quicklook(field, disparity).pixels.astype(int)
    red = pixels[..., 0] - np.maximum(pixels[..., 1], pixels[..., 2]) > 60
    strip = np.flatnonzero(red[:, 24:1020].sum(axis=1) >= 1)
    assert strip[0] > 62 + 2 * 488
    assert (np.diff(strip[:30]) == 1).all()


def test_values_are_coloured_and_what_is_unknown_is_grey() -> None:
    colours = palette(cv2.COLORMAP_MAGMA)
    found = coloured(np.array([[0.0, 1.0, np.nan]], np.float32), 0.0, 1.0, colours)
    np.testing.assert_array_equal(found[0], [colours[0], colours[255], (201, 204, 209)])
    sheet = Canvas(60, 40)
    sheet.picture(0, 0, 20, 20, np.zeros((4, 4, 3), np.uint8))
    sheet.text(24, 4, "text")
    back = cv2.imdecode(np.frombuffer(sheet.png(), np.uint8), cv2.IMREAD_COLOR)
    assert back[10, 10].max() == 0
    assert back[:, 24:].min() < 128


def test_square_pixels_undo_the_brick(field: xr.Dataset) -> None:
    """A plane X + 2·Y over the lens centres is the same plane over the pixels."""
    lattice = Lattice(*(float(field[n]) for n in ("dh", "dv", "theta", "cx", "cy")))
    t, s = np.meshgrid(np.arange(field.sizes["t"]), np.arange(field.sizes["s"]), indexing="ij")
    plane = (s + lattice.row_offset(t) + 2 * t * lattice.row_pitch).astype(np.float32)
    square = to_square(plane, field)
    y, x = np.mgrid[: square.shape[0], : square.shape[1]].astype(float)
    expected = ((x + 0.5) / 2 - 0.5) + 2 * ((y + 0.5) / 2 - 0.5 * lattice.row_pitch)
    inside = slice(8, -8), slice(8, -8)
    np.testing.assert_allclose(square[inside], expected[inside], atol=0.04)


def test_the_epipolar_image_is_of_the_row_with_most_depth(disparity: xr.Dataset) -> None:
    assert telling_row(disparity) == 12


def test_a_picture_is_written_also_from_threads(field: xr.Dataset, disparity: xr.Dataset, tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.png" for number in range(2)]
    threads = [threading.Thread(target=draw_quicklook, args=(field, disparity, path)) for path in paths]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    first, second = (cv2.imread(str(path)) for path in paths)
    assert first.shape[1] == 1560
    np.testing.assert_array_equal(first, second)
    assert first.std() > 20


def test_the_page_is_whole_and_safe(tmp_path: Path) -> None:
    picture = tmp_path / "IMG_1.png"
    cv2.imwrite(str(picture), np.zeros((80, 100, 3), np.uint8))
    rows = [
        ReportRow(
            "IMG_1",
            "scene",
            "F01",
            {"ISO": "100"},
            {"disparity": "done"},
            {"disparity": 1.5},
            "",
            picture.read_bytes,
            "quicklook/IMG_1.png",
        ),
        ReportRow("<b>", "", "", states={"disparity": "unreadable"}, reason="cut <off> & empty"),
    ]
    page = report_page("two", "/somewhere", rows)
    assert "cut &lt;off&gt; &amp; empty" in page
    assert "<td><b></td>" not in page
    assert '<a href="quicklook/IMG_1.png"><img alt="IMG_1" src="data:image/jpeg;base64,' in page
    assert "http" not in page.replace("http-equiv", "")


def test_blurred_edges_wear_no_comb_and_what_is_in_focus_stays() -> None:
    rows = np.where(np.arange(24) % 2, 0.2, 0.6).astype(np.float32)
    picture = xr.DataArray(np.broadcast_to(rows[:, None, None], (24, 20, 3)), dims=("t", "s", "channel"))
    off = np.where(np.arange(20) < 10, 0.0, 1.0) * np.ones((24, 1), np.float32)
    even = _even_blur(picture, off).values
    np.testing.assert_array_equal(even[:, :10], picture.values[:, :10])
    assert even[4:-4, 10:].std() < 0.1 * picture.values.std()
    assert even[4:-4, 10:].mean() == pytest.approx(0.4, abs=0.01)
