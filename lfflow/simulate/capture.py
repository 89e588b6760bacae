"""One simulated capture in memory: the raw frame and the truth beside it."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.lattice import Lattice
from lfflow.schema import lattice_variables
from lfflow.simulate.body import BODIES, Body, Setting
from lfflow.simulate.hard import hard_scene
from lfflow.simulate.metadata import raw_dataset
from lfflow.simulate.natural import natural_scene
from lfflow.simulate.optics import Optics
from lfflow.simulate.render import blurred, illumination, over_rows, render
from lfflow.simulate.scene import Scene, Texture
from lfflow.simulate.sensor import RawImage
from lfflow.simulate.truth import Grid, truth_disparity, truth_views

SCENES = {"natural": natural_scene, "hard": hard_scene}
"""Kinds of scenes that can be asked for by name."""
WHITE_LEVEL = 0.75
"""Peak of a white image's brightest channel."""

FloatImage = npt.NDArray[np.float32]


def simulate_capture(
    lattice: Lattice | None = None,
    scene: Scene | str = "natural",
    *,
    height: int | None = None,
    width: int | None = None,
    seed: int = 0,
    camera: str | Body = "f01",
    setting: Setting | None = None,
    optics: Optics | None = None,
    noise: bool = True,
    views: Sequence[int] | None = None,
    rgb_views: Sequence[int] | None = None,
    capture: str = "IMG_0001",
) -> tuple[xr.Dataset, xr.Dataset]:
    """Simulate a capture of a scene by a plenoptic camera.

    Every sensor pixel belongs to the nearest lens; its angle is its offset from that lens's true centre, not the
    rounded one, and its value the mean over rays through its own area and its lens (METHOD 7, conventions).

    Parameters
    ----------
    lattice
        Microlens lattice; the camera's own, at its zoom and focus, by default.
    scene
        What is seen, in camera colours (see `Scene`), or the kind of the scene that is made from `seed`: "natural"
        (detail everywhere) or "hard" (plain surfaces, thin things, slanted planes).
    height, width
        Sensor size, pixels; that of the camera by default.
    seed
        Source of all chance, together with `capture`.
    camera
        "f01", "illum" or a `Body`.
    setting
        Zoom, focus, sensitivity.
    optics
        Subimages and the rays of a pixel.
    noise
        Photon and read noise, hot and dead pixels.
    views
        View offsets (the same in u and v) of the truth; all of the camera's by default.
    rgb_views
        View offsets of the radiance where they are not those of the disparity; its dims are then rgb_v and rgb_u.
    capture
        Id of the capture.

    Returns
    -------
    raw : Dataset
        As the engine "lfp" gives it (schema RAW): raw(y, x) uint16.
    truth : Dataset
        disparity(v, u, t, s) float32, lens pitches per view step; rgb(v, u, t, s, channel) float32, linear radiance
        in camera colours (1 is the white level at a subimage's peak); defects(y, x) uint8; the lattice's scalars.
    """
    body = BODIES[camera] if isinstance(camera, str) else camera
    setting = setting or Setting()
    optics = optics or Optics()
    height, width = height or body.model.height, width or body.model.width
    lattice = lattice or body.lattice(setting, height, width)
    rng = np.random.default_rng(_entropy(seed, capture))
    if isinstance(scene, str):
        scene = camera_scene(SCENES[scene](rng, max(height, width) / lattice.dh / 2), body)
    levels = render(lattice, scene, optics, body.sensor.cfa, height, width)
    samples, defects = _digitise(levels, body, setting, seed=_entropy(seed, capture), noise=noise)
    time = _time(seed, capture)
    raw = raw_dataset(samples, body, setting, capture=capture, kind="scene", time=time)
    grid = Grid.of(lattice, height, width, body.model)
    truth = truth_disparity(grid, scene, views)
    if rgb_views is None:
        truth["rgb"] = truth_views(grid, scene, optics, views)["rgb"]
    else:
        truth["rgb"] = truth_views(grid, scene, optics, rgb_views)["rgb"].rename(v="rgb_v", u="rgb_u")
    truth["defects"] = (("y", "x"), defects)
    return raw, truth.assign_coords(capture=capture)


def simulate_white(
    lattice: Lattice | None = None,
    *,
    height: int | None = None,
    width: int | None = None,
    seed: int = 0,
    camera: str | Body = "f01",
    setting: Setting | None = None,
    optics: Optics | None = None,
    noise: bool = True,
    level: float = WHITE_LEVEL,
    capture: str = "WHITE_0001",
) -> tuple[xr.Dataset, xr.Dataset]:
    """Simulate a white image: an evenly lit grey card without detail.

    Parameters
    ----------
    level
        Linear level of the brightest channel at the peak of a subimage in the middle of the field.

    The other parameters are those of `simulate_capture`.

    Returns
    -------
    raw : Dataset
        As the engine "lfp" gives it, kind "white".
    truth : Dataset
        vignetting(y, x) float32 (1 at its peak), defects(y, x) uint8, and the lattice's scalars.
    """
    body = BODIES[camera] if isinstance(camera, str) else camera
    setting = setting or Setting()
    optics = optics or Optics()
    height, width = height or body.model.height, width or body.model.width
    lattice = lattice or body.lattice(setting, height, width)
    light = illumination(lattice, optics, height, width)
    colour = body.to_camera(np.ones(3))
    colour = (colour * level / colour.max()).astype(np.float32)
    levels = light * np.tile(colour[body.sensor.cfa], (height // 2 + 1, width // 2 + 1))[:height, :width]
    samples, defects = _digitise(
        blurred(levels, optics.crosstalk), body, setting, seed=_entropy(seed, capture), noise=noise
    )
    raw = raw_dataset(samples, body, setting, capture=capture, kind="white", time=_time(seed, capture))
    truth = xr.Dataset(
        {"vignetting": (("y", "x"), light), "defects": (("y", "x"), defects)},
        lattice_variables(Grid.of(lattice, height, width, body.model).lattice),
    )
    return raw, truth.assign_coords(capture=capture)


def camera_scene(scene: Scene, body: Body) -> Scene:
    """Scene of linear sRGB colours as the body's sensor sees it."""
    converted: dict[int, Texture] = {}
    layers = []
    for layer in scene.layers:
        key = id(layer.texture)
        if key not in converted:
            seen = body.to_camera(np.moveaxis(layer.texture.values, 0, -1))
            seen = np.maximum(np.moveaxis(seen, -1, 0), 0.002).astype(np.float32)
            converted[key] = Texture(np.ascontiguousarray(seen), layer.texture.scale)
        layers.append(replace(layer, texture=converted[key]))
    return Scene(tuple(layers), scene.name)


def _digitise(
    levels: FloatImage, body: Body, setting: Setting, *, seed: Sequence[int], noise: bool
) -> tuple[RawImage, npt.NDArray[np.uint8]]:
    """Samples (y, x) of the levels and the defects of the sensor; every block of rows has its own stream of noise."""
    sensor = body.sensor_at(setting)
    height, width = levels.shape
    if not noise:
        return sensor.digitise(levels, None), np.zeros((height, width), dtype=np.uint8)
    samples = np.empty((height, width), dtype=np.uint16)

    def fill(a: int, b: int) -> None:
        samples[a:b] = sensor.digitise(levels[a:b], np.random.default_rng([*seed, 1, a]))

    over_rows(height, fill)
    defects = sensor.defects(height, width, body.seed)
    return sensor.with_defects(samples, defects, body.seed), defects


def _entropy(seed: int, capture: str) -> list[int]:
    return [seed, zlib.crc32(capture.encode())]


def _time(seed: int, capture: str) -> np.datetime64:
    """A time of exposure that depends on seed and capture alone."""
    minutes = np.random.default_rng([*_entropy(seed, capture), 2]).integers(0, 500_000)
    return np.datetime64("2012-08-15T04:47:08.000") + np.timedelta64(int(minutes), "m")
