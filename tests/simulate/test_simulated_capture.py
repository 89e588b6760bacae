"""The forward model against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from lfflow.lattice import Lattice
from lfflow.schema import RAW, lattice_of
from lfflow.simulate import simulate_capture, simulate_white
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
