"""A bent lattice through the stages: found on a white image, stored, used by demultiplexing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from white_discs import white_discs

from lfflow.collection.scalars import decode, encode
from lfflow.lattice import Lattice
from lfflow.schema import CALIBRATION, LIGHTFIELD, distortion_of, lattice_of
from lfflow.stages.calibrate import calibrate
from lfflow.stages.demultiplex import demultiplex
from lfflow.stages.samples import residual

SHAPE = (640, 700)
LATTICE = Lattice(9.95, 9.96, 0.003, 3.0, 4.0)


def barrel(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Three pixels outwards in the corners, beside a magnification."""
    corner = np.hypot(*SHAPE) / 2
    across, down = (x - SHAPE[1] / 2) / corner, (y - SHAPE[0] / 2) / corner
    return 3 * across * (across**2 + down**2), 3 * down * (across**2 + down**2)


def raw_of(image: np.ndarray, kind: str) -> xr.Dataset:
    counts = np.clip(168 + 2500 * image, 0, 4095).round().astype(np.uint16)
    levels = {"black_level": ("site", np.full(4, 168.0)), "white_level": ("site", np.full(4, 4095.0))}
    axes = {"y": np.arange(SHAPE[0]), "x": np.arange(SHAPE[1]), "site": ["r", "gr", "gb", "b"]}
    return xr.Dataset(
        {"raw": (("y", "x"), counts)}, coords={**levels, **axes, "kind": kind, "cfa_pattern": "BGGR", "capture": kind}
    )


@pytest.fixture(scope="module")
def bent() -> tuple[xr.Dataset, np.ndarray]:
    image, places = white_discs(LATTICE, SHAPE, barrel)
    return calibrate(raw_of(image, "white")), places


def nearest_place(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from scipy.spatial import KDTree

    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    _, index = KDTree(places).query(np.stack([x.ravel(), y.ravel()], axis=1))
    centre_x, centre_y = np.floor(places[index].T + 0.5).reshape(2, *SHAPE)
    return x - centre_x, y - centre_y


def wrong_views(lf: xr.Dataset) -> float:
    """Share of the samples that lie at another view than the offset that their radiance tells."""
    told = lf["mosaic"] * (4095 - 168) / 100
    off_x = np.abs(np.round(told % 20) - 10 - lf["u"])
    off_y = np.abs(np.floor(told / 20) - 8 - lf["v"])
    inner = (np.abs(lf["u"]) <= 3) & (np.abs(lf["v"]) <= 3) & lf["mosaic"].notnull()
    return float(((off_x > 0.1) | (off_y > 0.1)).where(inner).mean())


def test_calibration_holds_the_bend(bent: tuple[xr.Dataset, np.ndarray]) -> None:
    cal, places = bent
    CALIBRATION.check(cal)
    assert float(cal["distortion_rms"]) > 0.1
    assert float(cal["distortion_chance"]) < 1e-20
    lattice, inside = lattice_of(cal), (places > 6).all(axis=1) & (places < (SHAPE[1] - 7, SHAPE[0] - 7)).all(axis=1)
    x, y = places[inside].T
    found = distortion_of(cal).moved(lattice.centres(*lattice.nearest(x, y)))
    away = np.hypot(found[0] - x, found[1] - y)
    assert np.sqrt((away**2).mean()) < 0.02
    assert lattice.distance_to(LATTICE, *SHAPE) > 0.5, "the mean magnification is the lattice's own"


def test_demultiplexing_follows_the_bend(bent: tuple[xr.Dataset, np.ndarray]) -> None:
    cal, places = bent
    off_x, off_y = nearest_place(places)
    told = (off_y + 8) * 20 + off_x + 10
    raw = raw_of(np.zeros(SHAPE), "scene").assign(raw=(("y", "x"), (168 + 100 * told / 10).round().astype(np.uint16)))
    cal = cal.assign(vignetting=xr.ones_like(cal["vignetting"]), pixel_flags=xr.zeros_like(cal["pixel_flags"]))
    lf = demultiplex(raw, cal)
    LIGHTFIELD.check(lf)
    scaled = lf.assign(mosaic=lf["mosaic"] * 10)
    straight = demultiplex(raw, cal.drop_vars("distortion"))
    assert wrong_views(scaled) < 0.03
    assert wrong_views(straight.assign(mosaic=straight["mosaic"] * 10)) > 0.2


def test_residuals_of_the_light_field_are_those_of_the_bent_centres(bent: tuple[xr.Dataset, np.ndarray]) -> None:
    cal, places = bent
    lf = demultiplex(raw_of(np.zeros(SHAPE), "scene"), cal)
    rho = residual(lf)
    x, _ = distortion_of(cal).moved(lattice_of(lf).centres(lf["t"].values[:, None], lf["s"].values))
    np.testing.assert_allclose(rho["rho_x"], np.floor(x + 0.5) - x, atol=1e-12)
    part = residual(lf.isel(t=slice(5, 20), s=slice(3, 9)))
    np.testing.assert_allclose(part["rho_y"], rho["rho_y"].isel(t=slice(5, 20), s=slice(3, 9)))
    assert places.size


def test_captures_and_chunks_give_the_same_field(bent: tuple[xr.Dataset, np.ndarray]) -> None:
    cal, _ = bent
    image, _ = white_discs(LATTICE, SHAPE, lambda x, y: (0 * x, 0 * y), seed=3)
    other = calibrate(raw_of(image, "white")).assign_coords(capture="flat")
    both = xr.concat([cal, other], "capture", coords="different", compat="equals", join="outer", data_vars="all")
    raws = [raw_of(image, "scene").assign_coords(capture=str(name)) for name in both["capture"].values]
    raw = xr.concat(raws, "capture", coords="different", compat="equals", join="outer", data_vars="all")
    lattices = both.chunk(capture=1, y=100)
    lazy = demultiplex(raw.chunk(capture=1, x=300), lattices, shape=(80, 75), radius=4)
    for index, one in enumerate((cal, other)):
        alone = demultiplex(raws[index], one, shape=(80, 75), radius=4)
        np.testing.assert_array_equal(lazy["mosaic"].isel(capture=index), alone["mosaic"])
        np.testing.assert_array_equal(lazy["distortion"].isel(capture=index), alone["distortion"])
    assert float(np.abs(both["distortion"].isel(capture=1)).max()) == 0


def test_the_bend_survives_the_ledger(bent: tuple[xr.Dataset, np.ndarray]) -> None:
    cal, _ = bent
    values = encode(cal, CALIBRATION)
    np.testing.assert_array_equal(decode(values, CALIBRATION["distortion"]), cal["distortion"])
    del values["distortion"]
    assert distortion_of(cal.assign(distortion=(("axis", "term"), decode(values, CALIBRATION["distortion"])))).straight


def test_pictures_are_never_bent() -> None:
    image, _ = white_discs(LATTICE, SHAPE, barrel)
    cal = calibrate(raw_of(image, "scene"))
    assert distortion_of(cal).straight
    assert np.isnan(float(cal["distortion_chance"]))


@pytest.mark.parametrize("name", ["IMG_1.lfp", "IMG_2.lfp"])
def test_real_pictures_get_no_correction(shared_data: Path, name: str) -> None:
    with xr.open_dataset(shared_data / "f01" / name, engine="lfp") as raw:
        assert distortion_of(calibrate(raw)).straight


def test_reconstruction_reads_samples_where_the_bent_lenses_lie(bent: tuple[xr.Dataset, np.ndarray]) -> None:
    from lfflow.kernels.colour.synthesis import prepare

    cal, _ = bent
    lf = demultiplex(raw_of(np.zeros(SHAPE), "scene"), cal)
    fields = [lf[name].values for name in ("mosaic", "cfa", "weight")] + [np.zeros(lf["mosaic"].shape, np.float32)] * 2
    prepared = prepare(fields, [lf[dim].values for dim in "vuts"], lattice_of(lf), distortion_of(lf))
    rho = residual(lf)
    found = next(part for part in prepared.samples if np.shape(part) == (2, *rho["rho_x"].shape))
    np.testing.assert_allclose(found, np.stack([rho["rho_x"], rho["rho_y"]]), atol=1e-6)
