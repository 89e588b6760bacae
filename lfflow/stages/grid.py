"""The places of a dataset's lenses or pixels in lens pitches, whatever its layout."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.schema import lattice_variables

Array = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Grid:
    """Rows and columns of places; all lengths in lens pitches of the light field (pixels for folders of views).

    Parameters
    ----------
    row_pitch, column_pitch
        Distance of two rows, of two places in a row.
    offset
        X of the first place in the odd rows: ½ in the brick layout, else 0.
    """

    row_pitch: float = 1.0
    column_pitch: float = 1.0
    offset: float = 0.0

    def places(self, t: npt.ArrayLike, s: npt.ArrayLike) -> tuple[Array, Array]:
        """X and Y of all rows `t` × columns `s`, float32 (t, s)."""
        rows, columns = np.meshgrid(np.asarray(t, dtype=float), np.asarray(s, dtype=float), indexing="ij")
        x = columns * self.column_pitch + self.offset * (rows % 2)
        return x.astype(np.float32), (rows * self.row_pitch).astype(np.float32)


def grid_from(dh: float, dv: float, arrangement: int, scale: float = 1.0) -> Grid:
    """Grid of a lattice; a square one is counted in `scale`-ths of a lens pitch."""
    lattice = Lattice(float(dh), float(dv), 0.0, 0.0, 0.0, ARRANGEMENTS[int(arrangement)])
    half = 0.5 if lattice.arrangement == "hexagonal" else 0.0
    return Grid(lattice.row_pitch / scale, 1.0 / scale, half)


def grid_of(ds: xr.Dataset | xr.DataArray) -> Grid:
    """Grid of `ds`: of its lattice coordinates, else square with one place a pixel."""
    if "dh" not in ds.coords:
        return Grid()
    scale = float(np.ravel(ds["scale"])[0]) if "scale" in ds.coords else 1.0
    dh, dv, arrangement = (np.ravel(ds[name])[0] for name in ("dh", "dv", "arrangement"))
    return grid_from(dh, dv, int(arrangement), scale)


def square_lattice(lattice: Lattice, scale: float) -> dict[str, Any]:
    """Scalar coordinates of the square grid with `scale` places per lens pitch on the same sensor."""
    square = replace(lattice, dh=lattice.dh / scale, dv=lattice.dh / scale, arrangement="square")
    return {**lattice_variables(square), "scale": np.float64(scale)}
