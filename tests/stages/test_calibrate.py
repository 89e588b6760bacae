"""`calibrate` on closed-form white images and pictures, lazily, with captures, and on the real F01 pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr
from scipy.stats import chi2

from lfflow.errors import LatticeNotFoundError
from lfflow.lattice import Lattice
from lfflow.schema import CALIBRATION, lattice_of
from lfflow.stages.calibrate import calibrate, site_indices

TRUTH = Lattice(dh=9.9346, dv=9.9395, theta=-0.0048, cx=3.3, cy=4.4)
SIZE = (480, 520)


def subimages(lattice: Lattice, shape: tuple[int, int]) -> np.ndarray:
    """A soft disc of radius 0.45 pitches about every lens: written from the lattice's definition alone."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    centre_x, centre_y = lattice.centres(*lattice.nearest(x, y))
    distance = np.hypot(x - centre_x, y - centre_y)
    return 1 / (1 + np.exp((distance - 0.45 * lattice.dh) / 0.5))


def frame(light: np.ndarray, kind: str, *, pattern: str = "BGGR", seed: int = 1) -> xr.Dataset:
    gains = {"R": 0.7, "G": 1.0, "B": 0.5}
    colours = np.array([gains[colour] for colour in pattern]).reshape(2, 2)
    level = light * np.tile(colours, (light.shape[0] // 2, light.shape[1] // 2)) * 2500
    noisy = np.random.default_rng(seed).normal(level + 168, np.sqrt(level + 25))
    return xr.Dataset(
        {"raw": (("y", "x"), np.clip(np.rint(noisy), 0, 4095).astype(np.uint16))},
        coords={
            "y": np.arange(light.shape[0]),
            "x": np.arange(light.shape[1]),
            "site": ["r", "gr", "gb", "b"],
            "kind": kind,
            "capture": f"{kind}_{seed}",
            "cfa_pattern": pattern,
            "black_level": ("site", np.full(4, 168.0)),
            "white_level": ("site", np.full(4, 4095.0)),
            "mla_rotation": 0.5,
        },
    )


def scene(shape: tuple[int, int]) -> np.ndarray:
    """A texture with edges, darker to the right."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    blocks = np.random.default_rng(3).uniform(0.2, 1, (9, 9))[(y // 60).astype(int) % 9, (x // 61).astype(int) % 9]
    return blocks * (1 + 0.3 * np.sin(x / 7.3 + y / 11.1)) * (1.2 - x / shape[1])


@pytest.fixture(scope="module")
def white() -> xr.Dataset:
    return frame(subimages(TRUTH, SIZE), "white")


@pytest.fixture(scope="module")
def picture() -> xr.Dataset:
    return frame(subimages(TRUTH, SIZE) * scene(SIZE), "scene")


def test_white_image(white: xr.Dataset) -> None:
    cal = calibrate(white)
    CALIBRATION.check(cal)
    assert lattice_of(cal).distance_to(TRUTH, *SIZE) < 0.005
    assert int(cal["method"]) == 0
    assert float(cal["vignetting"].max()) == 1
    anchored = lattice_of(cal).anchored(*SIZE)
    assert (anchored.cx, anchored.cy) == pytest.approx((float(cal["cx"]), float(cal["cy"])), abs=1e-9)


def test_picture_without_white_image(picture: xr.Dataset) -> None:
    cal = calibrate(picture)
    assert lattice_of(cal).distance_to(TRUTH, *SIZE) < 0.1
    assert int(cal["method"]) == 1
    light = subimages(TRUTH, SIZE)
    assert float(np.abs(cal["vignetting"].values - light)[20:-20, 20:-20].mean()) < 0.08


def clipped(shape: tuple[int, int]) -> np.ndarray:
    """Subimages that a second disc clips towards the corners."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    centre_x, centre_y = TRUTH.centres(*TRUTH.nearest(x, y))
    dx, dy = x - centre_x, y - centre_y
    u, v = centre_x / shape[1] - 0.5, centre_y / shape[0] - 0.5
    radius = 0.45 * TRUTH.dh
    inner, outer = np.hypot(dx, dy) - radius, np.hypot(dx + 0.8 * radius * u, dy + 0.8 * radius * v) - 1.06 * radius
    return 1 / (1 + np.exp(inner / 0.35)) / (1 + np.exp(outer / 0.35))


def test_vignetting_of_a_picture_follows_the_clipping_over_the_field() -> None:
    light = clipped(SIZE)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    cal = calibrate(frame(light * (0.6 + 0.2 * np.sin(x / 40 + y / 25)), "scene"))
    assert lattice_of(cal).distance_to(TRUTH, *SIZE) < 0.05
    shade = cal["vignetting"].values
    # How bright the light is as a whole is the scene's: the shape is compared.
    error = (shade - light * float((shade * light).sum() / (light**2).sum()))[20:-20, 20:-20]
    assert np.sqrt(np.mean(error**2)) < 0.02
    for half in (slice(None, 220), slice(220, None)):
        assert abs(error[:, half].mean()) < 0.01


def test_colour_weights_count_in_the_peaks(white: xr.Dataset) -> None:
    quick, green = calibrate(white, precise=False), calibrate(white, precise=False, alpha=(0, 1, 0))
    assert lattice_of(quick) != lattice_of(green)
    assert lattice_of(green).distance_to(TRUTH, *SIZE) < 0.005


def test_method_can_be_forced(white: xr.Dataset) -> None:
    cal = calibrate(white, method="self")
    assert int(cal["method"]) == 1
    assert lattice_of(cal).distance_to(TRUTH, *SIZE) < 0.02


def test_lazy_captures_give_the_same_numbers(white: xr.Dataset, picture: xr.Dataset, no_compute: None) -> None:
    both = xr.concat([white, picture], "capture", coords="different", compat="equals", join="outer", data_vars="all")
    lazy = calibrate(both.transpose("x", "capture", "y", "site").chunk(y=100, x=130, capture=1))
    import dask

    with dask.config.set(scheduler="synchronous"):
        lazy = lazy.compute()
    for index, single in enumerate((white, picture)):
        expected = calibrate(single)
        for name in expected.data_vars:
            np.testing.assert_array_equal(
                lazy[name].isel(capture=index).transpose(*expected[name].dims), expected[name], str(name)
            )
    assert list(lazy["capture"].values) == ["white_1", "scene_1"]


def test_defects_are_flagged(white: xr.Dataset) -> None:
    raw = white["raw"].values.copy()
    t, s = TRUTH.nearest(260, 240)
    x, y = (int(np.rint(value)) for value in TRUTH.centres(t, s))
    raw[y, x] = 170
    raw[y, x + 5], raw[y + 30, x] = 4000, 4095
    flags = calibrate(white.assign(raw=(("y", "x"), raw)))["pixel_flags"].values
    assert flags[y, x] & 2
    assert flags[y, x + 5] & 1
    assert flags[y + 30, x] & 4
    assert (flags != 0).sum() < 10


@pytest.mark.parametrize(("level", "reason"), [(0.0, "dark"), (0.5, "flat")])
def test_refusal_names_the_reason(level: float, reason: str) -> None:
    with pytest.raises(LatticeNotFoundError, match=reason):
        calibrate(frame(np.full(SIZE, level), "scene"))


def shot(light: np.ndarray, counts: float, seed: int = 1) -> xr.Dataset:
    """A picture whose brightest pixels are `counts` photons above the black level, read with a noise of 3."""
    rng = np.random.default_rng(seed)
    level = rng.poisson(light * counts) + rng.normal(168, 3, light.shape)
    return frame(light, "scene").assign(raw=(("y", "x"), np.rint(level).clip(0, 4095).astype(np.uint16)))


def covered(cal: xr.Dataset) -> float:
    """Error of the lattice, which must not be far beyond what is stated of its offset."""
    error = lattice_of(cal).distance_to(TRUTH, *SIZE)
    assert error < 4 * np.sqrt(cal["covariance"].values[3, 3])
    return error


@pytest.mark.parametrize("counts", [300, 60, 30])
def test_a_dark_picture_has_its_lattice(counts: float) -> None:
    assert covered(calibrate(shot(subimages(TRUTH, SIZE) * scene(SIZE), counts))) < 0.03


@pytest.mark.parametrize("counts", [5, 1, 0.1])
def test_a_picture_too_dark_is_refused(counts: float) -> None:
    with pytest.raises(LatticeNotFoundError, match="dark"):
        calibrate(shot(subimages(TRUTH, SIZE) * scene(SIZE), counts))


@pytest.mark.parametrize("blur", [1.0, 2.0])
def test_a_defocused_picture_has_its_lattice(blur: float) -> None:
    light = cv2.GaussianBlur(subimages(TRUTH, SIZE), (0, 0), blur) * scene(SIZE)
    assert covered(calibrate(shot(light, 1500))) < 0.15


@pytest.mark.parametrize("blur", [3.0, 5.0])
def test_a_picture_too_flat_is_refused(blur: float) -> None:
    """Blurred subimages are an even light at last, and the scene is all there is."""
    light = cv2.GaussianBlur(subimages(TRUTH, SIZE), (0, 0), blur) * scene(SIZE)
    with pytest.raises(LatticeNotFoundError, match="flat"):
        calibrate(shot(light, 1500))


@pytest.mark.parametrize("seed", range(3))
def test_a_picture_without_lenses_is_refused(seed: int) -> None:
    with pytest.raises(LatticeNotFoundError):
        calibrate(shot(np.roll(scene(SIZE), 37 * seed, axis=(0, 1)), 1500, seed))


def test_sites_follow_the_pattern() -> None:
    assert site_indices("BGGR") == [3, 2, 1, 0]
    assert site_indices("GRBG") == [1, 0, 3, 2]


def test_real_pictures_share_one_lattice(shared_data: Path) -> None:
    found, covariance = [], []
    for name in ("IMG_1.lfp", "IMG_2.lfp"):
        with xr.open_dataset(shared_data / "f01" / name, engine="lfp") as raw:
            cal = calibrate(raw)
        found.append(lattice_of(cal))
        covariance.append(cal["covariance"].values)
    assert found[0].distance_to(found[1], 3280, 3280) < 0.08
    for lattice in found:
        assert lattice.dh == pytest.approx(9.93, abs=0.01)
        assert np.degrees(lattice.theta) == pytest.approx(-0.28, abs=0.01)
    one, other = found
    x, y = other.centres(*other.nearest(one.cx, one.cy))
    apart = [one.dh - other.dh, one.dv - other.dv, one.theta - other.theta, one.cx - float(x), one.cy - float(y)]
    assert apart @ np.linalg.solve(covariance[0] + covariance[1], apart) < chi2.ppf(0.999, 5)
