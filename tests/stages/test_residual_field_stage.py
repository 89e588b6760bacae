"""The residual field of a picture: it holds the bend that was drawn, and says what its correction leaves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from white_discs import white_discs

from lfflow.errors import LfflowError
from lfflow.lattice import Lattice
from lfflow.stages.calibrate import calibrate
from lfflow.stages.residual_field import residual_field
from pipelines.residual_fields import verdict

SHAPE = (500, 560)


def cushion(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A displacement across that grows with the square of the place: an even bend of the array."""
    return 0.5 * ((x - SHAPE[1] / 2) / SHAPE[1] * 2) ** 2, 0 * y


def picture(bent: bool, kind: str = "white") -> xr.Dataset:
    image, _ = white_discs(Lattice(10.03, 10.02, -0.002, 3, 4), SHAPE, cushion if bent else lambda x, y: (0 * x, 0 * y))
    levels = {"black_level": ("site", np.full(4, 168.0)), "white_level": ("site", np.full(4, 4095.0))}
    counts = np.clip(168 + 2500 * image, 0, 4095).round().astype(np.uint16)
    return xr.Dataset({"raw": (("y", "x"), counts)}, coords={**levels, "kind": kind, "cfa_pattern": "BGGR"})


def rms(right: xr.DataArray, down: xr.DataArray) -> float:
    return float(np.sqrt((right**2 + down**2).mean()))


def test_field_of_a_bent_array(tmp_path: Path) -> None:
    from lfflow.viz.residual_field import draw_residual_field

    raw = picture(bent=True)
    cal = calibrate(raw)
    field = residual_field(raw, cal)
    middle, edge = field["dx"].isel(cell_x=field.sizes["cell_x"] // 2).mean(), field["dx"].isel(cell_x=0).mean()
    assert float(edge - middle) == pytest.approx(0.4, abs=0.12)
    assert rms(field["dx"], field["dy"]) > 0.1
    assert rms(field["dx"] - field["bend_x"], field["dy"] - field["bend_y"]) < 0.02
    assert "corrected" in verdict(cal, field)
    draw_residual_field(field, tmp_path / "field.png", "bent")
    assert (tmp_path / "field.png").stat().st_size > 10_000


def test_field_of_a_straight_array_is_noise() -> None:
    raw = picture(bent=False)
    cal = calibrate(raw)
    field = residual_field(raw, cal)
    assert rms(field["dx"], field["dy"]) < 0.02
    assert float(field["excess"]) < 3
    assert "no correction" in verdict(cal, field)


def test_field_of_a_scene_is_shown_but_not_judged() -> None:
    raw = picture(bent=True, kind="scene")
    cal = calibrate(raw)
    field = residual_field(raw, cal)
    assert rms(field["dx"], field["dy"]) > 0.1
    assert float(np.abs(field["bend_x"]).max()) == 0
    assert "not judged" in verdict(cal, field)


def test_several_captures_are_refused() -> None:
    raw = picture(bent=False)
    with pytest.raises(LfflowError, match="one capture"):
        residual_field(raw.expand_dims(capture=["a"]), xr.Dataset())
