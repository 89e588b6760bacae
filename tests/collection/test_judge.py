"""What a frame shows is judged from its samples: a white image by a stranger's name is found, a scene never is one."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from tiny_captures import frame_of, lens_pattern

from lfflow.collection.judge import judge
from lfflow.kernels.sensor.flatness import flatness
from lfflow.simulate.body import BODIES, Setting
from lfflow.simulate.capture import simulate_capture, simulate_white

SIZE = 960
Y, X = np.mgrid[-1 : 1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
R2 = X**2 + Y**2
LENSES = lens_pattern(SIZE, SIZE)
EVEN = 0.6 * LENSES * (1 - 0.3 * R2)


def raw_of(light: np.ndarray, kind: str = "scene", seed: int = 0) -> xr.Dataset:
    levels = {"black_level": ("site", [168.0] * 4), "white_level": ("site", [4095.0] * 4)}
    return xr.Dataset(
        {"raw": (("y", "x"), frame_of(light, seed))}, coords={"kind": kind, "cfa_pattern": "BGGR", **levels}
    )


def colours(red: float, blue: float) -> np.ndarray:
    gains = np.ones((SIZE, SIZE))
    gains[1::2, 1::2], gains[::2, ::2] = red, blue
    return gains


WHITES = {
    "even light": EVEN,
    "strong vignetting": 0.7 * LENSES * np.exp(-0.8 * R2),
    "tungsten light": EVEN * colours(1.3, 0.4),
    "weakly lit": 0.15 * EVEN,
    "a slightly oblique diffuser": EVEN * (1 + 0.07 * X),
    "dust": EVEN * (1 - 0.05 * (np.hypot(X - 0.3, Y) < 0.04)),
}
SCENES = {
    "an edge": EVEN * np.where(X > 0.2, 1, 0.8),
    "a small thing on a white wall": EVEN * (1 - 0.4 * ((abs(X - 0.3) < 0.07) & (abs(Y + 0.4) < 0.07))),
    "a sky": EVEN * (1 - 0.3 * (Y + 1) / 2),
    "a lamp out of focus": EVEN * (0.4 + 0.6 * np.exp(-3 * ((X - 0.3) ** 2 + Y**2))),
    "a wall of two colours": EVEN * np.where(Y > 0, 1, colours(1.2, 0.8)),
    "a coloured glow": EVEN * (1 + (colours(1.3, 0.8) - 1) * (X + 1) / 2),
    "ripples": EVEN * (1 + 0.15 * np.sin(9 * X) * np.sin(7 * Y)),
    "clipped": 3 * EVEN,
    "nearly dark": 0.02 * EVEN,
    "a candle in the dark": EVEN * 0.003 + 0.5 * LENSES * np.exp(-900 * ((X - 0.5) ** 2 + Y**2)),
}


@pytest.mark.parametrize("name", WHITES)
def test_even_light_is_white(name):
    assert judge(raw_of(WHITES[name])) == ("white", "content")


@pytest.mark.parametrize("name", SCENES)
def test_whatever_else_is_a_scene(name):
    assert judge(raw_of(SCENES[name])) == ("scene", "content")


@pytest.mark.parametrize("light", [np.zeros((SIZE, SIZE)), np.full((SIZE, SIZE), 0.002)], ids=["black", "offset"])
def test_no_light_is_dark_also_with_hot_pixels(light):
    light = light.copy()
    light.flat[np.random.default_rng(2).integers(0, light.size, 500)] = 1
    assert judge(raw_of(light)) == ("dark", "content")


def test_the_camera_and_people_are_believed():
    assert judge(raw_of(SCENES["an edge"], "white")) == ("white", "camera")
    assert judge(raw_of(WHITES["even light"], "dark")) == ("dark", "camera")
    assert judge(raw_of(WHITES["even light"], "dark"), "scene") == ("scene", "told")


def test_a_frame_too_small_to_say_is_what_the_camera_says():
    assert judge(raw_of(EVEN).isel(y=slice(0, 100))) == ("scene", "camera")
    assert flatness(np.zeros((100, 400), np.uint16), np.zeros(4), np.ones(4)) is None


def test_a_scene_is_known_from_few_of_its_rows(monkeypatch):
    read = []
    raw = raw_of(np.tile(SCENES["ripples"], (4, 1)))
    monkeypatch.setattr("lfflow.collection.judge.flatness", lambda samples, *levels: (
        read.append(samples.shape[0]), flatness(samples, *levels))[1])  # fmt: skip
    assert judge(raw)[0] == "scene"
    assert sum(read) <= raw.sizes["y"] / 10


@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_simulated_pictures_of_both_cameras(camera):
    size = {"height": 600, "width": 640, "camera": camera}
    body = BODIES[camera]
    for iso in (body.base_iso, 8 * body.base_iso):
        white, _ = simulate_white(setting=Setting(iso=iso), **size)
        assert judge(white.assign_coords(kind="scene")) == ("white", "content")
    for scene in ("natural", "hard"):
        for seed in range(2):
            raw, _ = simulate_capture(None, scene, seed=seed, views=[0], rgb_views=[0], **size)
            assert judge(raw) == ("scene", "content")


def test_real_pictures_are_scenes(shared_data):
    for path in sorted((shared_data / "f01").glob("*.lfp")):
        with xr.open_dataset(path, engine="lfp") as raw:
            assert judge(raw) == ("scene", "content")
