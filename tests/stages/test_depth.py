from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from lfflow.errors import LfflowError
from lfflow.simulate import Layer, Scene, simulate_capture, simulate_white
from lfflow.simulate.texture import natural_texture
from lfflow.stages.calibrate import calibrate
from lfflow.stages.demultiplex import demultiplex
from lfflow.stages.depth import depth
from lfflow.stages.disparity import disparity

F, PITCH, LENS, GAP = 0.00684, 1.4e-6, 14e-6, 25e-6


def traced(z: np.ndarray, focus: float, optics: tuple[float, ...] = (F, PITCH, LENS, GAP)) -> np.ndarray:
    """Disparities by tracing two rays: a view step moves the pupil by δB/f, the lens plane lies at B."""
    focal, pitch, lens, gap = optics
    behind = 1 / (1 / focal - 1 / focus)
    image = 1 / (1 / focal - 1 / z)
    return pitch * behind / gap * (1 - behind / image) / lens


def capture(z: np.ndarray, focus: float, sigma: float = 0.01) -> xr.Dataset:
    shift = traced(z, focus)
    coords = {"focal_length": F, "pixel_pitch": PITCH, "lens_pitch": LENS, "mla_offset_z": GAP}
    data = {"disparity": ("s", shift), "disparity_std": ("s", np.full(z.shape, sigma))}
    return xr.Dataset(data, coords)


def test_depth_is_that_of_the_thin_lens() -> None:
    z = np.array([0.2, 0.5, 1.0, 3.0])
    found = depth(capture(z, focus=0.8), focus_distance=0.8)
    np.testing.assert_allclose(found["depth"], z, rtol=1e-4)
    assert found["depth"].attrs["units"] == "m"


def test_the_wide_end_of_an_f01_has_disparity_0_94_at_20_cm() -> None:
    ds = capture(np.array([0.2, 1.0]), focus=1e9)
    np.testing.assert_allclose(ds["disparity"], [0.94, 0.19], atol=0.01)


def test_two_thirds_of_noisy_depths_lie_within_the_stated_deviation() -> None:
    rng, sigma = np.random.default_rng(0), 0.005
    z = np.full(20000, 0.4)
    ds = capture(z, focus=0.8, sigma=sigma)
    ds["disparity"] = ds["disparity"] + rng.normal(0, sigma, z.shape)
    found = depth(ds, focus_distance=0.8)
    within = np.abs(found["depth"] - 0.4) < found["depth_std"]
    assert float(within.mean()) == pytest.approx(0.683, abs=0.015)


@pytest.mark.parametrize("count", [1, 2])
def test_the_distance_in_focus_is_fitted_to_known_points_and_said_so(count: int) -> None:
    z = np.array([0.2, 0.5, 1.0])
    ds = capture(z, focus=0.7)
    known = [(float(ds["disparity"][k]), float(z[k])) for k in range(count)]
    found = depth(ds, known=known)
    np.testing.assert_allclose(found["depth"], z, rtol=1e-3)
    assert found["depth"].attrs["focus_distance"] == "fitted to known depths"


def test_the_lens_data_may_come_from_the_light_field() -> None:
    whole = capture(np.array([0.2, 0.5]), focus=0.8)
    two = xr.concat([whole, whole], "capture").assign_coords(capture=["a", "b"], focal_length=("capture", [F, 2 * F]))
    bare = two.drop_vars(["focal_length", "pixel_pitch", "lens_pitch", "mla_offset_z"])
    backwards = two.coords.to_dataset().isel(capture=[1, 0])
    found = depth(bare, focus_distance=0.8, camera=backwards)
    np.testing.assert_allclose(found["depth"], depth(two, focus_distance=0.8)["depth"])
    assert not np.allclose(found["depth"][0], found["depth"][1])


def test_points_beyond_infinity_have_no_depth() -> None:
    ds = capture(np.array([0.5, 1.0]), focus=0.8)
    ds["disparity"] = ds["disparity"] - 10
    assert np.isnan(depth(ds, focus_distance=0.8)["depth"]).all()


def test_what_is_missing_is_named() -> None:
    ds = capture(np.array([0.5]), focus=0.8)
    with pytest.raises(LfflowError, match="focus_distance"):
        depth(ds)
    with pytest.raises(LfflowError, match="lens_pitch"):
        depth(ds.assign_coords(lens_pitch=np.nan), focus_distance=0.8)
    with pytest.raises(LfflowError, match="contradict"):
        depth(ds, known=[(0.1, 1.0), (0.2, 2.0)])


@pytest.mark.parametrize(("z", "seed"), [(0.35, 1), (0.62, 2), (1.7, 3)])
def test_a_simulated_plane_lies_where_it_was_put_within_the_stated_deviation(z: float, seed: int) -> None:
    """From the raw frame to metres: a textured plane at z, the camera focused at 0.8 m."""
    size = {"height": 420, "width": 420}
    white, _ = simulate_white(seed=seed, **size)
    names = ("focal_length", "pixel_pitch", "lens_pitch", "mla_offset_z")
    d = float(traced(np.array(z), 0.8, tuple(float(white[name]) for name in names)))
    colours = np.array([(0.5, 0.4, 0.3), (0.2, 0.3, 0.4), (0.6, 0.6, 0.5)])
    texture = natural_texture(np.random.default_rng(seed), 256, colours, roughness=1.0)
    raw, _ = simulate_capture(scene=Scene([Layer(texture, d, angle=0.4)]), seed=seed, **size, views=[0])
    found = depth(disparity(demultiplex(raw, calibrate(white))), focus_distance=0.8).isel(
        t=slice(6, -6), s=slice(6, -6)
    )
    score = ((found["depth"] - z) / found["depth_std"]).values
    assert np.isfinite(score).all()
    assert (np.abs(score) < 1).mean() > 0.6
    assert (np.abs(score) < 2).mean() > 0.95
    assert np.sqrt((score**2).mean()) > 0.25  # what is stated is not too much either
