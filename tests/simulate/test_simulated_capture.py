"""The forward model against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from lfflow.lattice import Lattice
from lfflow.schema import RAW, lattice_of
from lfflow.simulate import simulate_capture, simulate_white
from lfflow.simulate.body import BODIES
from lfflow.simulate.collection import settings_of, white_settings
from lfflow.simulate.optics import Optics
from lfflow.simulate.scene import Layer, Scene
from lfflow.simulate.texture import flat_texture, wave_texture

LATTICE = Lattice(10.0086, 10.0103, 0.00143, 3.3, 4.7)
PLAIN = Optics(rays=1, softness=0.01, droop=0.0, falloff=0.0, aperture=1.0)
SIZE = {"height": 200, "width": 240}


def flat_scene(colour: tuple[float, float, float] = (0.2, 0.4, 0.6)) -> Scene:
    return Scene([Layer(flat_texture(colour))])


def test_raw_and_white_follow_the_schema() -> None:
    raw, _ = simulate_capture(LATTICE, flat_scene(), **SIZE)
    white, _ = simulate_white(LATTICE, **SIZE)
    for ds, kind in ((raw, "scene"), (white, "white")):
        RAW.check(ds)
        assert ds["raw"].dtype == np.uint16
        assert ds["kind"].item() == kind
        assert ds["raw"].max() <= 4095


def test_same_seed_same_bytes_other_seed_other_noise() -> None:
    first, again = (simulate_capture(LATTICE, flat_scene(), seed=5, **SIZE)[0] for _ in range(2))
    other, _ = simulate_capture(LATTICE, flat_scene(), seed=6, **SIZE)
    assert first.identical(again)
    assert (first["raw"] != other["raw"]).mean() > 0.5


@pytest.mark.parametrize(("camera", "pattern", "white"), [("f01", "BGGR", 4095), ("illum", "GRBG", 1023)])
def test_bayer_pattern_of_a_flat_scene(camera: str, pattern: str, white: int) -> None:
    level = {"R": 0.2, "G": 0.4, "B": 0.6}
    raw, _ = simulate_capture(LATTICE, flat_scene(), camera=camera, optics=PLAIN, noise=False, **SIZE)
    black = raw["black_level"].values[0]
    for site, colour in enumerate(pattern):
        samples = raw["raw"].values[site // 2 :: 2, site % 2 :: 2]
        assert samples.max() == round(level[colour] * (white - black) + black)


def interior(lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    t, s = np.meshgrid(np.arange(40), np.arange(40), indexing="ij")
    x, y = lattice.centres(t, s)
    inside = (x > 15) & (x < SIZE["width"] - 16) & (y > 15) & (y < SIZE["height"] - 16)
    return t[inside], s[inside]


@pytest.mark.parametrize("disparity", [-0.4, 0.0, 0.3])
def test_a_wave_on_a_plane_is_sampled_where_the_closed_form_says(disparity: float) -> None:
    frequency, contrast = (32 / 128, 16 / 128), 0.5
    scene = Scene([Layer(wave_texture(frequency, contrast=contrast, size=256), disparity)])
    raw, truth = simulate_capture(LATTICE, scene, optics=PLAIN, noise=False, views=(0,), **SIZE)
    lattice = lattice_of(truth)
    t, s = interior(lattice)
    cx, cy = lattice.centres(t, s)
    cos, sin = np.cos(lattice.theta), np.sin(lattice.theta)
    for v, u in ((0, 0), (0, 3), (0, -3), (3, 0), (-3, 0), (2, -2)):
        x, y = np.rint(cx).astype(int) + u, np.rint(cy).astype(int) + v
        # Lens and angle along the lattice's axes; the view at the residual of the rounding, not at the integer.
        mx, my = cx - (SIZE["width"] - 1) / 2, cy - (SIZE["height"] - 1) / 2
        lens_x, lens_y = (cos * mx + sin * my) / lattice.dh, (cos * my - sin * mx) / lattice.dh
        a, b = cos * (x - cx) + sin * (y - cy), cos * (y - cy) - sin * (x - cx)
        phase = frequency[0] * (lens_x + disparity * a) + frequency[1] * (lens_y + disparity * b)
        mean = np.array([0.3, 0.4, 0.3])[np.array([[2, 1], [1, 0]])[y % 2, x % 2]]
        expected = mean * (1 + contrast * np.sin(2 * np.pi * phase)) * (4095 - 168) + 168
        assert np.abs(raw["raw"].values[y, x] - expected).max() < 2.5


@pytest.mark.parametrize(("v", "u"), [(0, 1), (0, -1), (1, 0), (-1, 0)])
def test_a_near_edge_moves_against_the_view(v: int, u: int) -> None:
    """A point at X in view (0, 0) lies at X − d·u in view (u, v)."""
    d, step = 0.5, 4
    spot = (-5.0, 5.0, -5.0, 5.0)
    scene = Scene([Layer(flat_texture((0.1, 0.1, 0.1)), -0.3), Layer(flat_texture((0.8, 0.8, 0.8)), d, bounds=spot)])
    _, truth = simulate_capture(LATTICE, scene, optics=PLAIN, noise=False, views=(-step, 0, step), **SIZE)
    lattice = lattice_of(truth)
    weight = truth["rgb"].isel(channel=1) > 0.5
    x = truth["s"] + 0.5 * (truth["t"] % 2)
    y = truth["t"] * lattice.row_pitch

    def middle(v: int, u: int) -> tuple[float, float]:
        mask = weight.sel(v=v, u=u)
        return float((x * mask).sum() / mask.sum()), float((y * mask).sum() / mask.sum())

    x0, y0 = middle(0, 0)
    x1, y1 = middle(v * step, u * step)
    assert x1 - x0 == pytest.approx(-d * u * step, abs=0.3)
    assert y1 - y0 == pytest.approx(-d * v * step, abs=0.3)


def test_the_nearer_layer_hides_the_farther_in_whatever_order_they_are_given() -> None:
    """Against brute force in plain numpy: two slanted half planes and a backdrop."""
    far = Layer(flat_texture((0.1, 0.1, 0.1)), -0.4)
    left = Layer(flat_texture((0.5, 0.5, 0.5)), 0.1, (0.02, 0.0), bounds=(-1e9, 4.0, -1e9, 1e9))
    below = Layer(flat_texture((0.9, 0.9, 0.9)), 0.1, (0.0, -0.03), bounds=(-1e9, 1e9, -3.0, 1e9))
    first = simulate_capture(LATTICE, Scene([far, left, below]), noise=False, optics=PLAIN, **SIZE)[1]
    other = simulate_capture(LATTICE, Scene([below, far, left]), noise=False, optics=PLAIN, **SIZE)[1]
    np.testing.assert_array_equal(first["disparity"], other["disparity"])
    lattice = lattice_of(first)
    t, s = np.meshgrid(first["t"], first["s"], indexing="ij")
    px, py = lattice.centres(t, s)
    px, py = px - (SIZE["width"] - 1) / 2, py - (SIZE["height"] - 1) / 2
    cos, sin = np.cos(lattice.theta), np.sin(lattice.theta)
    x, y = (cos * px + sin * py) / lattice.dh, (cos * py - sin * px) / lattice.dh
    for v, u in ((0, 0), (3, -4), (-5, 2)):
        a, b = cos * u + sin * v, cos * v - sin * u
        candidates = []
        for layer in (far, left, below):
            d = np.full(x.shape, layer.disparity)
            for _ in range(60):  # the point's own disparity, by fixed-point iteration instead of the closed form
                d = layer.disparity + layer.slope[0] * (x + d * a) + layer.slope[1] * (y + d * b)
            bx0, bx1, by0, by1 = layer.bounds
            seen = (x + d * a >= bx0) & (x + d * a <= bx1) & (y + d * b >= by0) & (y + d * b <= by1)
            candidates.append(np.where(seen, d, -np.inf))
        np.testing.assert_allclose(first["disparity"].sel(v=v, u=u), np.max(candidates, axis=0), atol=1e-5)


def test_photon_noise_grows_with_the_signal() -> None:
    stds = []
    for level in (0.1, 0.4):
        colour = (level, level, level)
        raw, _ = simulate_capture(LATTICE, flat_scene(colour), optics=PLAIN, seed=2, **SIZE)
        quiet, _ = simulate_capture(LATTICE, flat_scene(colour), optics=PLAIN, noise=False, **SIZE)
        samples = raw["raw"].values[quiet["raw"].values == quiet["raw"].values.max()].astype(float)
        stds.append(1.4826 * np.median(np.abs(samples - np.median(samples))))
        electrons = level * 5000 * 80 / 100
        expected = np.sqrt(electrons + 4.0**2) * (4095 - 168) / (5000 * 80 / 100)
        assert stds[-1] == pytest.approx(expected, rel=0.05)
    assert stds[1] / stds[0] == pytest.approx(2.0, rel=0.07)


def test_white_image_shades_as_its_truth_and_hot_pixels_stay_put() -> None:
    white, truth = simulate_white(LATTICE, height=400, width=400, noise=True)
    _, scene_truth = simulate_capture(LATTICE, flat_scene(), height=400, width=400)
    np.testing.assert_array_equal(truth["defects"], scene_truth["defects"])
    quiet, _ = simulate_white(LATTICE, height=400, width=400, noise=False)
    light = truth["vignetting"].values
    assert light.max() == pytest.approx(1.0, abs=0.01)
    green = (quiet["raw"].values[::2, 1::2] - 168.0) / light[::2, 1::2].clip(0.2)
    bright = light[::2, 1::2] > 0.3
    assert green[bright].std() / green[bright].mean() < 2e-3
    hot = truth["defects"].values == 1
    assert hot.any()
    assert (white["raw"].values[hot] > quiet["raw"].values[hot] + 800).all()


def test_cat_eye_moves_the_light_but_not_the_lattice_of_the_truth() -> None:
    plain, truth = simulate_white(LATTICE, height=400, width=400, noise=False)
    clipped, other = simulate_white(LATTICE, height=400, width=400, noise=False, optics=Optics(cat_eye=0.5))
    assert lattice_of(truth) == lattice_of(other)
    corner, middle = (slice(0, 40), slice(0, 40)), (slice(180, 220), slice(180, 220))
    for place, low, high in ((corner, 0.3, 0.9), (middle, 0.96, 1.001)):
        ratio = other["vignetting"].values[place].sum() / truth["vignetting"].values[place].sum()
        assert low < ratio < high
    assert (clipped["raw"].sum() < plain["raw"].sum()).item()


def test_crosstalk_keeps_the_light() -> None:
    sharp, _ = simulate_capture(LATTICE, flat_scene(), noise=False, **SIZE)
    soft, _ = simulate_capture(LATTICE, flat_scene(), noise=False, optics=Optics(crosstalk=0.1), **SIZE)
    inner = {"y": slice(2, -2), "x": slice(2, -2)}
    before, after = (float((ds["raw"].isel(inner) - 168.0).sum()) for ds in (sharp, soft))
    assert after == pytest.approx(before, rel=0.01)
    assert soft["raw"].isel(inner).std() < sharp["raw"].isel(inner).std()


def test_white_images_are_spread_over_zoom_and_focus() -> None:
    body = BODIES["f01"]
    settings = settings_of(body, 4, 0, 2)
    grid = white_settings(body, settings, 2, 3)
    assert [(setting.zoom_step, setting.focus_step) for setting in grid] == [
        (zoom, focus) for zoom in (981, 540) for focus in (382.0, 682.0, 982.0)
    ]
    one_each = white_settings(body, settings, 2, 1)
    assert [(s.zoom_step, s.focus_step) for s in one_each] == [(s.zoom_step, s.focus_step) for s in settings[:2]]
