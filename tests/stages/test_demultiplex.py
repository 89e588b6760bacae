"""Demultiplexing: every usable pixel exactly once, at the place that the lattice says."""

from __future__ import annotations

from typing import Any

import dask
import dask.array
import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from lfflow.errors import LfflowError
from lfflow.kernels.sensor.demultiplex import MIN_VIGNETTING, SATURATED_WEIGHT, round_to_pixel
from lfflow.lattice import Lattice
from lfflow.schema import LIGHTFIELD, lattice_of, lattice_variables
from lfflow.simulate import simulate_white
from lfflow.stages.demultiplex import demultiplex

SEED_LATTICE = Lattice(10.00861, 10.01028, 0.00143, 5.3, 7.1)
BLACK = np.array([168.0, 160.0, 170.0, 150.0])
WHITE = np.array([4095.0, 4000.0, 4010.0, 4080.0])


def frame(height: int, width: int, *, seed: int = 0, pattern: str = "BGGR", capture: str = "A") -> xr.Dataset:
    counts = np.random.default_rng(seed).integers(0, 3990, (height, width)).astype(np.uint16)
    return xr.Dataset(
        {"raw": (("y", "x"), counts)},
        coords={
            "y": np.arange(height), "x": np.arange(width), "site": ["r", "gr", "gb", "b"],
            "black_level": ("site", BLACK), "white_level": ("site", WHITE), "cfa_pattern": pattern, "kind": "scene",
            "capture": capture, "camera_model": "none of the known", "iso": 200.0,
        },
    )  # fmt: skip


def calibration(lattice: Lattice, height: int, width: int, *, seed: int = 1) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    return xr.Dataset(
        {
            **lattice_variables(lattice),
            "vignetting": (("y", "x"), rng.uniform(0.02, 1, (height, width)).astype(np.float32)),
            "pixel_flags": (("y", "x"), rng.choice([0, 0, 0, 0, 1, 2, 4], (height, width)).astype(np.uint8)),
        },
        coords={"y": np.arange(height), "x": np.arange(width)},
    )


def sensor_of(lf: xr.Dataset) -> tuple[Any, ...]:
    """Sensor column and row of every sample, by the definition V(u, v)[lens] = raw(round(centre) + (u, v))."""
    x, y = lattice_of(lf).centres(lf.t.values[:, None], lf.s.values)
    present = (lf.cfa != 255).transpose("v", "u", "t", "s").values
    v, u, t, s = np.nonzero(present)
    columns = round_to_pixel(x)[t, s] + lf.u.values[u]
    rows = round_to_pixel(y)[t, s] + lf.v.values[v]
    return columns, rows, (v, u, t, s)


def on_border_of_cells(lattice: Lattice, x: Any, y: Any) -> Any:
    """Points that are equally far from two lenses, to rounding."""
    own = lattice.nearest(x, y)
    aside = [lattice.nearest(x + dx, y + dy) for dx in (-1e-9, 1e-9) for dy in (-1e-9, 1e-9)]
    return np.any([(t != own[0]) | (s != own[1]) for t, s in aside], axis=0)


lattices = st.builds(
    Lattice,
    dh=st.floats(6.0, 15.0), dv=st.floats(6.0, 15.0), theta=st.floats(-0.05, 0.05), cx=st.floats(-40, 40),
    cy=st.floats(-40, 40), arrangement=st.sampled_from(["hexagonal", "square"]),
)  # fmt: skip


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(lattice=lattices, radius=st.integers(2, 8), pattern=st.sampled_from(["BGGR", "GRBG", "RGGB", "GBRG"]))
@example(lattice=Lattice(6.805920290018286, 7.0, 0.0, 0.0, 4.0, "hexagonal"), radius=3, pattern="BGGR")
def test_every_usable_pixel_is_used_exactly_once(lattice: Lattice, radius: int, pattern: str) -> None:
    height, width = 61, 74
    raw, cal = frame(height, width, pattern=pattern), calibration(lattice, height, width)
    lf = demultiplex(raw, cal, radius=radius)
    columns, rows, index = sensor_of(lf)

    y, x = np.mgrid[:height, :width]
    mine = lattice_of(lf)
    t, s = mine.nearest(x, y)
    centre_x, centre_y = mine.centres(t, s)
    offset = np.maximum(abs(x - round_to_pixel(centre_x)), abs(y - round_to_pixel(centre_y)))
    on_grid = (t >= 0) & (t < lf.sizes["t"]) & (s >= 0) & (s < lf.sizes["s"])
    usable = on_grid & (cal.pixel_flags.values == 0) & (cal.vignetting.values >= MIN_VIGNETTING) & (offset <= radius)

    used = np.zeros((height, width), int)
    np.add.at(used, (rows, columns), 1)
    between = on_border_of_cells(mine, x, y)  # either lens may have these, and one of them does at most
    assert used.max() <= 1
    np.testing.assert_array_equal(used[~between], usable[~between])
    clear = ~between[rows, columns]
    np.testing.assert_array_equal(t[rows, columns][clear], index[2][clear])
    np.testing.assert_array_equal(s[rows, columns][clear], index[3][clear])

    site = np.array([["RGB".index(c) for c in pattern[:2]], ["RGB".index(c) for c in pattern[2:]]])
    np.testing.assert_array_equal(lf.cfa.values[index], site[rows % 2, columns % 2])
    np.testing.assert_array_equal(lf.weight.values[index], cal.vignetting.values[rows, columns])


def test_radiance_is_that_of_each_bayer_site() -> None:
    lattice = SEED_LATTICE
    raw, cal = frame(80, 90, pattern="GRBG"), calibration(lattice, 80, 90)
    lf = demultiplex(raw, cal)
    columns, rows, index = sensor_of(lf)
    tile = np.array([[1, 0], [3, 2]])  # GRBG: gr r / b gb
    site = tile[rows % 2, columns % 2]
    expected = (raw.raw.values[rows, columns] - BLACK[site]) / (WHITE - BLACK)[site]
    np.testing.assert_allclose(lf.mosaic.values[index] * lf.weight.values[index], expected, rtol=1e-5, atol=1e-6)


def test_where_there_is_no_sample_all_three_say_so() -> None:
    lf = demultiplex(frame(80, 90), calibration(SEED_LATTICE, 80, 90))
    missing = lf.cfa.values == 255
    assert missing.any()
    np.testing.assert_array_equal(np.isnan(lf.mosaic.values), missing)
    np.testing.assert_array_equal(lf.weight.values == 0, missing)


def test_a_clipped_sample_keeps_its_value_and_loses_its_weight() -> None:
    raw, cal = frame(80, 90), calibration(SEED_LATTICE, 80, 90)
    raw["raw"][40, 45] = 4095
    cal["pixel_flags"][40, 45], cal["vignetting"][40, 45] = 0, 0.5
    lf = demultiplex(raw, cal)
    clipped = (lf.weight.values > 0) & (lf.weight.values < MIN_VIGNETTING)
    assert clipped.sum() == 1
    assert lf.weight.values[clipped] == pytest.approx(0.5 * SATURATED_WEIGHT)
    assert lf.mosaic.values[clipped] >= 2.0


def test_the_lattice_is_the_same_renumbered() -> None:
    lf = demultiplex(frame(80, 90), calibration(SEED_LATTICE, 80, 90), shape=(21, 17))
    assert dict(lf.sizes) == {"v": 11, "u": 11, "t": 21, "s": 17}
    assert lattice_of(lf).distance_to(SEED_LATTICE, 80, 90) < 1e-9
    assert LIGHTFIELD.issues(lf) == []
    assert lf.attrs["schema"] == "lightfield"
    assert float(lf.iso) == 200.0


def test_lazy_and_eager_agree_with_any_order_and_captures(no_compute: None) -> None:
    lattices = [SEED_LATTICE, Lattice(9.8, 10.1, -0.01, 2, 3)]
    frames = [frame(60, 70, seed=k, capture=f"IMG_{k}") for k in range(2)]
    cals = [calibration(lattice, 60, 70, seed=9 + k) for k, lattice in enumerate(lattices)]
    singles = [demultiplex(a, b, shape=(9, 9), radius=5) for a, b in zip(frames, cals, strict=True)]

    raw = xr.concat(frames, "capture", coords="different", compat="equals", join="exact")
    cal = xr.concat(cals, xr.DataArray(["IMG_0", "IMG_1"], dims="capture", name="capture"))
    raw["raw"] = raw.raw.transpose("x", "capture", "y").chunk(x=13, capture=1)
    before = raw.copy(deep=False)
    lazy = demultiplex(raw, cal.chunk(capture=1, y=20), shape=(9, 9), radius=5)
    assert lazy.mosaic.dims == ("capture", "v", "u", "t", "s")
    assert all(lazy[name].chunks is not None for name in ("mosaic", "cfa", "weight", "cx"))
    xr.testing.assert_identical(raw, before)

    with dask.config.set(scheduler="threads"):
        done = lazy.compute()
    for k, single in enumerate(singles):
        for name in ("mosaic", "cfa", "weight", "cx", "cy", "dh"):
            np.testing.assert_array_equal(done[name].isel(capture=k).values, single[name].values)


def test_an_unknown_camera_with_a_lazy_calibration_asks_for_the_shape(no_compute: None) -> None:
    cal = calibration(SEED_LATTICE, 40, 40).chunk()
    cal["dh"] = ((), dask.array.asarray(cal.dh.values))
    with pytest.raises(LfflowError, match="shape="):
        demultiplex(frame(40, 40), cal)


def test_a_calibration_of_another_sensor_is_refused() -> None:
    with pytest.raises(LfflowError, match="another sensor"):
        demultiplex(frame(40, 40), calibration(SEED_LATTICE, 40, 48))
    two = xr.concat([frame(40, 40, capture=c) for c in "AB"], "capture", coords="different", compat="equals")
    other = xr.concat([calibration(SEED_LATTICE, 40, 40)] * 2, xr.DataArray(["A", "C"], dims="capture", name="capture"))
    with pytest.raises(LfflowError, match="same captures"):
        demultiplex(two, other)


def test_captures_of_a_known_model_share_one_shape() -> None:
    raw, cal = frame(3280, 3280), calibration(SEED_LATTICE, 3280, 3280)
    lf = demultiplex(raw.assign_coords(camera_model="F01").chunk(), cal.chunk())
    assert (lf.sizes["u"], lf.mosaic.chunks is not None) == (11, True)
    other = calibration(Lattice(10.05, 9.95, -0.009, 3, 3), 3280, 3280).chunk()
    assert demultiplex(raw.assign_coords(camera_model="F01").chunk(), other).sizes == lf.sizes


@pytest.mark.parametrize("arrangement", ["hexagonal", "square"])
def test_interpolated_samples_lie_at_their_views(arrangement: Any) -> None:
    """Light that is linear in the aperture, with other slopes in every colour and lens: exact at (u, v), not at ρ."""
    lattice = Lattice(10.0086, 9.97, 0.013, 3.3, 4.7, arrangement)
    height, width = 130, 150
    y, x = np.mgrid[:height, :width]
    t, s = lattice.nearest(x, y)
    cx, cy = lattice.centres(t, s)
    colour = np.array([[2, 1], [1, 0]])[y % 2, x % 2]
    slopes = np.array([[70.0, -40.0], [20.0, 90.0], [-60.0, 30.0]])

    def light(a: np.ndarray, b: np.ndarray, t: np.ndarray, s: np.ndarray, colour: np.ndarray) -> np.ndarray:
        tilt = 1 + 0.5 * np.sin(0.3 * t + 0.2 * s)
        return 2000 + 200 * colour + tilt * (slopes[colour, 0] * a + slopes[colour, 1] * b)

    raw, cal = frame(height, width), calibration(lattice, height, width)
    raw = raw.assign_coords(black_level=("site", np.zeros(4)), white_level=("site", np.full(4, 4096.0)))
    raw["raw"] = (("y", "x"), np.rint(light(x - cx, y - cy, t, s, colour)).astype(np.uint16))
    cal["vignetting"], cal["pixel_flags"] = cal["vignetting"] * 0 + 1, cal["pixel_flags"] * 0
    nearest, moved = demultiplex(raw, cal, radius=2), demultiplex(raw, cal, radius=2, method="interpolated")
    np.testing.assert_array_equal(nearest["cfa"], moved["cfa"])
    np.testing.assert_array_equal(nearest["weight"], moved["weight"])
    mine = lattice_of(moved)
    v, u, rows, columns = np.nonzero(moved["cfa"].values != 255)
    own_t, own_s = lattice.nearest(*mine.centres(rows, columns))
    seen = moved["cfa"].values[v, u, rows, columns].astype(int)
    expected = light(moved["u"].values[u], moved["v"].values[v], own_t, own_s, seen)
    inner = (rows > 1) & (columns > 1) & (rows < moved.sizes["t"] - 2) & (columns < moved.sizes["s"] - 2)
    for field, low, high in ((moved, 0.0, 1.1), (nearest, 20.0, 200.0)):
        error = np.abs(field["mosaic"].values[v, u, rows, columns] * 4096 - expected)[inner].max()
        assert low <= error <= high


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(LfflowError, match="nearest, interpolated"):
        demultiplex(frame(40, 40), calibration(SEED_LATTICE, 40, 40), method="cubic")  # type: ignore[arg-type]


@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_usable_views_are_those_with_light_in_the_median(camera: str) -> None:
    raw, truth = simulate_white(height=330, width=350, camera=camera)
    lf = demultiplex(raw, truth.rename(defects="pixel_flags"))
    x, y = lattice_of(lf).centres(lf["t"].values[:, None], lf["s"].values)
    x, y = round_to_pixel(x), round_to_pixel(y)
    on_sensor = (x >= 0) & (x < 350) & (y >= 0) & (y < 330)
    median = np.median(lf["weight"].values[..., on_sensor], axis=-1)
    np.testing.assert_array_equal(lf["view_usable"], median >= MIN_VIGNETTING)
    middle = lf["view_usable"].sel(v=0)
    radius = {"f01": 4, "illum": 6}[camera]
    assert middle.sel(u=slice(-radius, radius)).all()
    assert not lf["view_usable"].isel(v=0, u=0)
    assert lf["mosaic"].sel(v=0, u=1)["view_usable"].item() is True
