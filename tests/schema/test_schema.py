"""Declarations: what they demand of a dataset, and that the documentation says the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from lfflow.errors import SchemaError
from lfflow.lattice import Lattice
from lfflow.schema import CALIBRATION, DISPARITY, LIGHTFIELD, SCHEMAS, lattice_of, lattice_variables


def small_lightfield() -> xr.Dataset:
    shape = (3, 3, 4, 5)
    dims = ("v", "u", "t", "s")
    ds = xr.Dataset(
        {
            "mosaic": (dims, np.linspace(0, 1, 180, dtype=np.float32).reshape(shape)),
            "cfa": (dims, np.ones(shape, np.uint8)),
            "weight": (dims, np.full(shape, 0.5, np.float32)),
            **lattice_variables(Lattice(10.0, 10.0, 0.0, 0.0, 0.0)),
        },
        coords={"v": [-1, 0, 1], "u": [-1, 0, 1], "t": range(4), "s": range(5)},
    )
    return LIGHTFIELD.annotate(ds)


def test_a_right_dataset_passes_and_carries_its_units() -> None:
    ds = LIGHTFIELD.check(small_lightfield())
    assert ds.attrs["schema"] == "lightfield"
    assert ds.mosaic.attrs["long_name"] == "radiance, 0 black level, 1 white level"
    assert ds.dh.attrs["units"] == "pixel"
    assert "dh" in ds.mosaic.coords


def test_dim_order_does_not_matter() -> None:
    LIGHTFIELD.check(small_lightfield().transpose("s", "u", "v", "t"))


def test_every_difference_is_listed() -> None:
    broken = small_lightfield().drop_vars("cfa").assign(weight=lambda ds: ds.weight.astype("float64").isel(u=0))
    with pytest.raises(SchemaError) as caught:
        LIGHTFIELD.check(broken, "lf.zarr")
    message = str(caught.value)
    assert "lf.zarr" in message
    assert "cfa: found no such variable" in message
    assert "weight: found dims" in message
    assert "weight: found dtype float64, expected dtype float32" in message


def test_lattice_survives_a_dataset() -> None:
    lattice = Lattice(9.93, 9.94, -0.0049, 1.5, 2.5, "square")
    assert lattice_of(xr.Dataset(lattice_variables(lattice))) == lattice


def test_flags_follow_cf() -> None:
    flags = DISPARITY["flags"].attrs
    assert list(flags["flag_masks"]) == [1, 2, 4, 8, 16]
    assert flags["flag_meanings"].split() == ["no_data", "low_texture", "saturated", "occluded", "filled"]
    assert CALIBRATION["method"].attrs["flag_values"].dtype == np.uint8


@pytest.mark.parametrize("name", SCHEMAS)
def test_documentation_shows_the_declaration(name: str) -> None:
    text = (Path(__file__).parents[2] / "data" / "README.md").read_text()
    assert SCHEMAS[name].table() in text


def test_a_time_is_written_by_xarray(tmp_path: Path) -> None:
    ds = LIGHTFIELD.annotate(small_lightfield().assign_coords(time=np.datetime64("2012-08-15T04:47:08", "ns")))
    ds.to_zarr(tmp_path / "lf.zarr", zarr_format=3, consolidated=False)
    xr.testing.assert_identical(xr.open_zarr(tmp_path / "lf.zarr", consolidated=False).load(), ds)
