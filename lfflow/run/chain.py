"""The stages of the batch in one table: what each needs, makes and is called."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import xarray as xr

from lfflow.cameras import KNOWN_CAMERAS, CameraModel, view_radius
from lfflow.run.memory import Extent, calibration_work, disparity_work, lightfield_work
from lfflow.schema import CALIBRATION, DISPARITY, LIGHTFIELD, Schema

Parameters = Mapping[str, Mapping[str, Any]]
MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Grid:
    """Shape that all captures of one group share: lens rows and columns, and the largest view offset."""

    rows: int
    columns: int
    radius: int


@dataclass(frozen=True, slots=True)
class StageInput:
    """What a stage may use: the raw frame, the results of the stages before it, the group's grid, the cores it has, and
    the dark images of the camera, which are read one by one as they are asked for.
    """  # noqa: D205

    raw: xr.Dataset | None
    results: Mapping[str, xr.Dataset]
    grid: Grid | None
    parameters: Parameters
    threads: int = 1
    darks: Iterable[xr.Dataset] = ()

    @property
    def frame(self) -> xr.Dataset:
        """The raw frame of a stage that reads it."""
        if self.raw is None:
            raise TypeError("this stage has not been declared to read the raw frame")
        return self.raw


@dataclass(frozen=True, slots=True)
class Stage:
    """One step of the batch.

    Parameters
    ----------
    name, version
        Name in the ledger; a new version redoes all that was done with the old one.
    schema
        Declaration of the result.
    upstream
        Stages whose results it needs.
    function
        From its input to its result, a dataset of one capture.
    reads_raw
        Whether it uses the raw frame.
    uses_darks
        Whether it uses the dark images of the camera.
    tables
        Tables of the configuration and the function whose keyword arguments each sets.
    work
        Peak bytes that the function needs beside its input, for the plan (`lfflow.run.memory`).
    stored_per_pixel
        Bytes on the disk per sensor pixel, for the plan.
    seconds_per_megapixel
        For the plan's estimate before anything has been measured.
    """

    name: str
    version: int
    schema: Schema
    upstream: tuple[str, ...]
    function: Callable[[StageInput], xr.Dataset]
    tables: Mapping[str, str] = field(default_factory=dict)
    work: Callable[[Extent, Parameters], int] | None = None
    stored_per_pixel: float = 0.0
    seconds_per_megapixel: float = 0.0
    reads_raw: bool = True
    uses_darks: bool = False

    def keywords(self, table: str) -> tuple[str, ...]:
        """Keyword arguments that a table of the configuration may set."""
        module, _, name = self.tables[table].partition(":")
        function = getattr(importlib.import_module(module), name)
        own = [
            p.name for p in inspect.signature(function).parameters.values() if p.default is not inspect.Parameter.empty
        ]
        return tuple(name for name in own if name not in ("shape", "radius", "threads", "defects"))


@dataclass(frozen=True, slots=True)
class Chain:
    """How raw files are opened, the stages in their order, and how a finished capture is drawn."""

    open_raw: Callable[[str], xr.Dataset]
    stages: tuple[Stage, ...]
    draw: Callable[[xr.Dataset, xr.Dataset, str, int], None] | None = None
    open_damaged: Callable[[str], xr.Dataset] | None = None

    def accepting_damage(self) -> Chain:
        """Return the chain that also takes files whose checksums are wrong."""
        return self if self.open_damaged is None else replace(self, open_raw=self.open_damaged)

    def __getitem__(self, name: str) -> Stage:
        """Stage of a name."""
        return next(stage for stage in self.stages if stage.name == name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the stages, in order."""
        return tuple(stage.name for stage in self.stages)


def camera_grid(model: str, height: int, width: int, pitch: float) -> Grid | None:
    """Grid of a camera: the model's own, or that of the pitch in its metadata (sensor pixels; NaN: not known)."""
    camera = KNOWN_CAMERAS.get(model)
    if camera is None or (camera.height, camera.width) != (height, width):
        if not pitch > 0:
            return None
        nominal = camera.pitch if camera is not None else pitch * 0.99
        camera = CameraModel(model, height, width, nominal)
    rows, columns = camera.grid_shape
    return Grid(rows, columns, camera.view_radius)


def lattice_grid(calibration: xr.Dataset, height: int, width: int) -> Grid:
    """Grid of a camera that no metadata describe, from one calibration."""
    from lfflow.schema import lattice_of

    lattice = lattice_of(calibration)
    rows, columns = lattice.grid_shape(height, width)
    return Grid(rows + 2, columns + 2, view_radius(max(lattice.dh, lattice.dv)))


def open_lfp(path: str) -> xr.Dataset:
    """Raw frame of a file, lazily; one whose checksums are wrong is refused."""
    from lfflow.formats.opening import open_picture

    return open_picture(path)


def open_damaged_lfp(path: str) -> xr.Dataset:
    """Raw frame of a file, lazily, whatever its checksums say."""
    from lfflow.formats.opening import open_picture

    return open_picture(path, accept_damaged=True)


def _calibration(given: StageInput) -> xr.Dataset:
    from lfflow.stages.calibrate import calibrate

    return calibrate(given.frame, defects=_defects(given.darks), **given.parameters.get("calibration", {}))


def _defects(darks: Iterable[xr.Dataset]) -> xr.DataArray | None:
    """Pixels that the dark images agree on."""
    from lfflow.stages.defects import dark_defects, defect_counts, defect_map

    flags = [dark_defects(dark).compute().reset_coords(drop=True) for dark in darks]
    return defect_map(defect_counts(xr.concat(flags, "capture"))) if flags else None


def _lightfield(given: StageInput) -> xr.Dataset:
    from lfflow.stages.demultiplex import demultiplex

    grid = given.grid
    place: dict[str, Any] = {} if grid is None else {"shape": (grid.rows, grid.columns), "radius": grid.radius}
    return demultiplex(given.frame, given.results["calibration"], **place, **given.parameters.get("lightfield", {}))


def _disparity(given: StageInput) -> xr.Dataset:
    from lfflow.stages.disparity import disparity
    from lfflow.stages.transpose import transpose_disparity

    lightfield = given.results["lightfield"]
    central = disparity(lightfield, threads=given.threads, **given.parameters.get("disparity", {}))
    return transpose_disparity(central, lightfield, **given.parameters.get("transpose", {}))


def _draw(lightfield: xr.Dataset, disparity: xr.Dataset, path: str, threads: int) -> None:
    from lfflow.viz.quicklook import draw_quicklook

    draw_quicklook(lightfield, disparity, path, threads=threads)


CHAIN = Chain(
    open_lfp,
    (
        Stage("calibration", 3, CALIBRATION, (), _calibration,
              {"calibration": "lfflow.stages.calibrate:calibrate"}, calibration_work, 1.0, 0.2, uses_darks=True),
        Stage("lightfield", 1, LIGHTFIELD, ("calibration",), _lightfield,
              {"lightfield": "lfflow.stages.demultiplex:demultiplex"}, lightfield_work, 4.0, 0.2),
        Stage("disparity", 8, DISPARITY, ("lightfield",), _disparity,
              {"disparity": "lfflow.stages.disparity:disparity",
               "transpose": "lfflow.stages.transpose:transpose_disparity"}, disparity_work, 6.0, 0.5, reads_raw=False),
    ),
    _draw,
    open_damaged_lfp,
)  # fmt: skip
"""The chain that `lfflow run` works through."""
