"""Simulated captures come back: to the quantisation, with the noise that the weight claims, flat, and upright."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from lfflow.lattice import Lattice
from lfflow.schema import lattice_of
from lfflow.simulate import simulate_capture, simulate_white
from lfflow.simulate.body import BODIES, Setting
from lfflow.simulate.metadata import frame_metadata, private_metadata
from lfflow.simulate.optics import Optics
from lfflow.simulate.scene import Layer, Scene
from lfflow.simulate.texture import flat_texture, wave_texture
from lfflow.stages.calibrate import calibrate
from lfflow.stages.demultiplex import demultiplex

SIZE = {"height": 240, "width": 260}


def as_calibration(white: xr.Dataset) -> xr.Dataset:
    """The truth of a white image as the calibration of its camera."""
    return white.rename(defects="pixel_flags").reset_coords()


@pytest.mark.parametrize(
    ("camera", "lattice"),
    [
        ("f01", None),
        ("illum", None),
        ("f01", Lattice(9.93, 9.95, -0.004, 5.0, 3.0)),
        ("f01", Lattice(10.0, 10.0, 0.0, 4.0, 4.5)),
        ("f01", Lattice(11.7, 12.4, 0.03, 2.2, 8.1, "square")),
    ],
)
def test_samples_are_the_simulated_ones_to_the_quantisation(camera: str, lattice: Lattice | None) -> None:
    """A wave on a plane, noise off: every sample is the count that the closed form says, wherever its lens lies."""
    optics = Optics(rays=1, softness=0.01, droop=0.0, falloff=0.0, aperture=1.0)
    frequency, d = (8 / 128, 4 / 128), 0.3
    scene = Scene([Layer(wave_texture(frequency, size=256), d)])
    raw, truth = simulate_capture(lattice, scene, camera=camera, optics=optics, noise=False, views=[0], **SIZE)
    ones = xr.ones_like(raw["raw"].reset_coords(drop=True))
    cal = as_calibration(truth[["defects", "dh", "dv", "theta", "cx", "cy", "arrangement"]])
    lf = demultiplex(raw, cal.assign(vignetting=ones.astype(np.float32)), radius=4)
    mine = lattice_of(lf)
    v, u, t, s = np.nonzero(lf["cfa"].values != 255)
    cx, cy = mine.centres(t, s)
    x, y = np.floor(cx + 0.5) + lf["u"].values[u], np.floor(cy + 0.5) + lf["v"].values[v]
    cos, sin = np.cos(mine.theta), np.sin(mine.theta)
    a, b = cos * (x - cx) + sin * (y - cy), cos * (y - cy) - sin * (x - cx)
    middle_x, middle_y = cx - (SIZE["width"] - 1) / 2, cy - (SIZE["height"] - 1) / 2
    lens_x, lens_y = (cos * middle_x + sin * middle_y) / mine.dh, (cos * middle_y - sin * middle_x) / mine.dh
    # the simulator scales an offset along the lattice's axes: rows by dv like the lattice itself
    phase = frequency[0] * (lens_x + d * a) + frequency[1] * (lens_y + d * b)
    mean = np.array([0.3, 0.4, 0.3])[lf["cfa"].values[v, u, t, s]]
    inside = np.hypot(a, b) < 0.49 * min(mine.dh, mine.dv)
    error = np.abs(lf["mosaic"].values[v, u, t, s] - mean * (1 + 0.5 * np.sin(2 * np.pi * phase)))[inside]
    assert inside.sum() > 20_000
    assert error.max() < 0.51 / float((raw["white_level"] - raw["black_level"]).min())


@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_noise_is_unbiased_and_of_the_variance_that_the_weight_claims(camera: str) -> None:
    size: dict[str, Any] = {"height": 320, "width": 330, "camera": camera}
    quiet, _ = simulate_white(noise=False, **size)
    noisy, white = simulate_white(noise=True, **size)
    cal = as_calibration(white)
    clean, spoilt = demultiplex(quiet, cal), demultiplex(noisy, cal)
    good: xr.DataArray = (clean.weight >= 0.2) & (spoilt.weight >= 0.2) & (clean.cfa == 1)
    error = (spoilt.mosaic - clean.mosaic).values[good.values]
    weight, level = clean.weight.values[good.values], clean.mosaic.values[good.values]
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(error.size)
    sensor = BODIES[camera].sensor_at(Setting())
    step = 1 / float((quiet["white_level"] - quiet["black_level"]).min())
    for low, high in ((0.2, 0.4), (0.4, 0.7), (0.7, 1.0)):
        mine = (weight >= low) & (weight < high)
        fixed = (sensor.read_noise / sensor.full_well) ** 2 + 2 * step**2 / 12
        claimed = level[mine] / (sensor.full_well * weight[mine]) + fixed / weight[mine] ** 2
        assert error[mine].var() == pytest.approx(claimed.mean(), rel=0.06)


@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_a_gray_scene_is_flat_with_a_white_image_that_has_noise(camera: str) -> None:
    """0.5 % rms in nine views of ten, on a sensor of few lenses; the white image alone has 1.5 to 3 % of noise."""
    size: dict[str, Any] = {"height": 900, "width": 900, "camera": camera}
    white, _ = simulate_white(seed=1, **size)
    gray = Scene([Layer(flat_texture((0.4, 0.4, 0.4)))])
    scene, _ = simulate_capture(scene=gray, noise=False, views=[0], **size)
    cal = calibrate(white, precise=False)
    smooth, rough = (flatness(demultiplex(scene, c)) for c in (cal, cal.assign(vignetting=_by_pixel(white))))
    assert len(smooth) == {"f01": 69, "illum": 145}[camera]
    assert np.quantile(smooth, 0.9) < 0.0055
    assert np.median(smooth) < 0.0045
    assert np.min(rough) > 0.012


@pytest.mark.heavy
@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_a_gray_scene_is_flat_in_every_view_of_a_whole_sensor(camera: str) -> None:
    model = BODIES[camera].model
    size: dict[str, Any] = {"height": model.height, "width": model.width, "camera": camera}
    gray = Scene([Layer(flat_texture((0.4, 0.4, 0.4)))])
    scene, _ = simulate_capture(scene=gray, noise=False, views=[0], **size)
    found = flatness(demultiplex(scene, calibrate(simulate_white(seed=1, **size)[0], precise=False)))
    assert len(found) == {"f01": 69, "illum": 145}[camera]
    assert max(found) < 0.005


def _by_pixel(white: xr.Dataset) -> xr.DataArray:
    """Vignetting straight from a white image: each Bayer site over its peak."""
    light = white["raw"].reset_coords(drop=True).astype(np.float32) - np.float32(white["black_level"][0])
    for row in (0, 1):
        for column in (0, 1):
            site = light[row::2, column::2]
            light[row::2, column::2] = site / np.float32(np.percentile(site, 99.5))
    return light.clip(0, 1)


def flatness(lf: xr.Dataset) -> list[float]:
    """Rms deviation from the mean of their colour of the samples of weight ≥ 0.3, of every view of that median."""
    weight, cfa, mosaic = (lf[name].transpose("v", "u", "t", "s").values for name in ("weight", "cfa", "mosaic"))
    bright = weight >= 0.3
    means = np.array([mosaic[bright & (cfa == colour)].mean() for colour in range(3)])
    found = []
    for view in np.ndindex(weight.shape[:2]):
        lit = weight[view] > 0
        if lit.any() and np.median(weight[view][lit]) >= 0.3:
            kept = bright[view]
            found.append(float(np.sqrt(np.mean((mosaic[view][kept] / means[cfa[view][kept]] - 1) ** 2))))
    return found


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_camera_s_orientation_comes_out_of_the_file_upright(orientation: int, tmp_path: Path) -> None:
    """From the container's metadata to `square`: the scene's upper left corner is bright, however the camera lay."""
    from lfflow.formats.lfp import write_lfp

    body, size = BODIES["f01"], (160, 200)
    spot = Layer(flat_texture((0.8, 0.8, 0.8)), bounds=_stored_corner(orientation, size))
    scene = Scene([Layer(flat_texture((0.05, 0.05, 0.05)), -0.2), spot])
    raw, truth = simulate_capture(scene=scene, height=size[0], width=size[1], noise=False, views=[0])
    _, white = simulate_white(height=size[0], width=size[1], noise=False)
    metadata = frame_metadata(body, Setting(), *size, raw["time"].values)
    metadata["image"]["orientation"] = orientation
    write_lfp(tmp_path / "A.lfp", raw["raw"].values, metadata, private_metadata(body))
    with xr.open_dataset(tmp_path / "A.lfp", engine="lfp") as stored:
        lf = demultiplex(stored.load(), as_calibration(white))
    green = lf.lf.picture().sel(u=0, v=0, channel="G")
    t, s = green.sizes["t"], green.sizes["s"]
    assert (t < s) == (orientation < 5)
    bright = green > 0.5 * float(green.max())
    assert bool(bright.isel(t=slice(2, t // 4), s=slice(2, s // 4)).mean() > 0.9)
    assert float(bright.isel(t=slice(t // 2 + 3, None)).mean()) == 0
    assert float(bright.isel(s=slice(s // 2 + 3, None)).mean()) == 0
    assert truth["dh"] == lf["dh"]


def _stored_corner(orientation: int, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Quarter (x0, x1, y0, y1) of the stored frame, lens pitches, that EXIF shows at the upper left."""
    right = orientation in (2, 3, 7, 8)
    below = orientation in (3, 4, 6, 7)
    x = (0.0, 1e9) if right else (-1e9, 0.0)
    y = (0.0, 1e9) if below else (-1e9, 0.0)
    return (*x, *y)
