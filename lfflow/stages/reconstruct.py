"""Full-colour views from a mosaicked light field and its disparity (METHOD 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.conventions import CHANNELS, FIELD_DIMS
from lfflow.distortion import Distortion
from lfflow.errors import SchemaError
from lfflow.kernels.colour.gather import Rule
from lfflow.kernels.colour.surface_colour import surface_shape
from lfflow.kernels.colour.synthesis import Capture, Surface, one_view, prepare, surface_of
from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.schema import DISPARITY, VIEWS, distortion_numbers, lattice_of
from lfflow.stages.grid import Grid, grid_from, grid_of, square_lattice
from lfflow.stages.on_field import LATTICE_NAMES

Array = npt.NDArray[Any]

FILLED = {"red_interpolated": 1, "green_interpolated": 2, "blue_interpolated": 4, "no_data": 8}
"""Bits of ``filled``: colours that no sample of another view could give."""

_FEW = 4
"""So many views are gathered one by one; more share the surfaces of the central view."""
_FIELD = list(FIELD_DIMS)
_CAPTURE_CORES = [_FIELD] * 5 + [[]] * 6 + [[dim] for dim in FIELD_DIMS] + [["axis", "term"]]


def reconstruct_views(
    lf: xr.Dataset,
    disp: xr.Dataset,
    *,
    views: Mapping[str, Sequence[float]] | None = None,
    scale: float | None = None,
    rule: Rule | None = None,
    shared: bool | None = None,
) -> xr.Dataset:
    """Every colour at every place: same-colour samples of all views gathered along the disparity.

    A sample counts by its distance from the place, its vignetting weight, the agreement of its own disparity with that
    of the place, and the standard deviation of the disparity times the baseline. Colours are shrunk towards the line on
    which those around them lie, by the share of their scatter that is noise of the samples. The places in the aperture
    are the true ones (view offset + rounding of the lens centre), so the views come out rectified. What no sample
    reaches is interpolated in the view, guided by its other colours, and flagged.

    Parameters
    ----------
    lf
        `lfflow.schema.LIGHTFIELD`: ``mosaic``, ``cfa``, ``weight`` (v, u, t, s), with or without ``capture``.
    disp
        `lfflow.schema.DISPARITY` of the same views (`lfflow.transpose_disparity`).
    views
        Offsets "v" and "u" of the views wanted, sensor pixels; fractions are viewpoints between the views. All of `lf`
        by default.
    scale
        None: on the lenses, in the brick layout. A number: on the square grid with so many places per lens pitch.
    rule
        How samples are weighed.
    shared
        True: the samples of all views are gathered once, on the surfaces that the central view sees; each view reads
        them there, and gathers only what the centre does not see or where a doubtful disparity would show. False:
        every view gathers for itself, which costs four times as much for all views. By default True for more than
        four views.

    Returns
    -------
    Dataset
        ``rgb`` (v, u, t, s, channel) float32, linear radiance in camera colours; ``filled`` (v, u, t, s) uint8;
        ``disparity`` and ``disparity_std`` (v, u, t, s) float32 at the same places; the latter is raised at jumps.

    Raises
    ------
    SchemaError
        When a variable is missing, or the two datasets are not of the same views and lenses.
    """
    _check(lf, disp)
    wanted = {dim: np.asarray((views or {}).get(dim, lf[dim]), dtype=np.float64) for dim in ("v", "u")}
    geometry = _output_grid(lf, scale)
    fields = [_whole(lf[name]) for name in ("mosaic", "cfa", "weight")]
    fields += [_whole(disp[name]) for name in ("disparity", "disparity_std")]
    rule = rule or Rule()
    inputs = [*fields, *(_plain(lf[name]) for name in LATTICE_NAMES)]
    inputs += [xr.DataArray(np.asarray(lf[dim]), dims=dim) for dim in FIELD_DIMS]
    inputs.append(distortion_numbers(lf))
    if shared is None:
        shared = wanted["v"].size * wanted["u"].size > _FEW
    parts = xr.apply_ufunc(
        partial(_views, rule=rule, on_lenses=scale is None),
        _ready(inputs, scale, rule, shared=shared),
        *_view_tasks(wanted, fields),
        output_core_dims=[["t_out", "s_out", "channel"], *([["t_out", "s_out"]] * 3)],
        dask="parallelized",
        output_dtypes=["float32", "uint8", "float32", "float32"],
        dask_gufunc_kwargs={"output_sizes": {**_sizes(geometry), "channel": 3}},
    )
    out = xr.Dataset(dict(zip(("rgb", "filled", "disparity", "disparity_std"), parts, strict=True)))
    out = out.rename({f"{dim}_out": dim for dim in FIELD_DIMS})
    out = out.assign_coords(_coords(lf, wanted, geometry, scale))
    for name in ("disparity", "disparity_std"):
        out[name].attrs = dict(DISPARITY[name].attrs)
    out["filled"].attrs = {
        "long_name": "colours that were interpolated within the view",
        "units": "1",
        "flag_masks": np.array(list(FILLED.values()), dtype=np.uint8),
        "flag_meanings": " ".join(FILLED),
    }
    lead = [dim for dim in ("capture",) if dim in out.dims]
    return VIEWS.annotate(out.transpose(*lead, *FIELD_DIMS, "channel", ...))


@dataclass(frozen=True)
class _Ready:
    """What the views of one capture share, and the places (I, J) that they are wanted at."""

    capture: Capture
    surface: Surface | None
    x: Array
    y: Array


def _ready(inputs: Sequence[xr.DataArray], scale: float | None, rule: Rule, *, shared: bool) -> xr.DataArray:
    """A `_Ready` for each capture, one task each.

    Views take it whole: as core dims of theirs the fields would be copied for every view.
    """

    def work(*blocks: Array) -> Array:
        lead = np.broadcast_shapes(
            *(block.shape[: block.ndim - len(core)] for block, core in zip(blocks, _CAPTURE_CORES, strict=True))
        )
        out = np.empty(lead, dtype=object)
        for index in np.ndindex(*lead):
            capture, grid, t, s = _capture(_at(blocks, _CAPTURE_CORES, index))
            surface = None
            if shared:
                shape = surface_shape(float(len(s)), float(t[-1] - t[0]) * grid.row_pitch)
                surface = surface_of(capture, shape, rule)
            out[index] = _Ready(capture, surface, *_places(grid, t, s, scale))
        return out

    ready: xr.DataArray = xr.apply_ufunc(
        work, *inputs, input_core_dims=_CAPTURE_CORES, dask="parallelized", output_dtypes=[object]
    )
    return ready


def _views(ready: Array, v: Array, u: Array, *, rule: Rule, on_lenses: bool) -> tuple[Array, ...]:
    """Views of a block of captures and viewpoints."""
    captures, at_v, at_u = np.broadcast_arrays(ready, v, u)
    out: list[Array] = []
    for index in np.ndindex(*captures.shape):
        this = cast("_Ready", captures[index])
        view = float(at_v[index]), float(at_u[index])
        found = one_view(this.capture, this.surface, this.x, this.y, view, rule, on_lenses=on_lenses)
        if not out:
            out = [np.empty((*captures.shape, *part.shape), dtype=part.dtype) for part in found]
        for whole, part in zip(out, found, strict=True):
            whole[index] = part
    return tuple(out)


def _at(blocks: Sequence[Array], cores: Sequence[Sequence[str]], index: tuple[int, ...]) -> list[Array]:
    """Core arrays at an index of the loop dims, which broadcast."""
    found = []
    for block, core in zip(blocks, cores, strict=True):
        lead = block.shape[: block.ndim - len(core)]
        own = index[len(index) - len(lead) :] if lead else ()
        found.append(block[tuple(k if size > 1 else 0 for k, size in zip(own, lead, strict=True))])
    return found


def _capture(arrays: Sequence[Array]) -> tuple[Capture, Grid, Array, Array]:
    """One capture from the inputs in the order of `_CAPTURE_CORES`; its grid; its axes t and s."""
    dh, dv, theta, cx, cy = (float(value) for value in arrays[5:10])
    lattice = Lattice(dh, dv, theta, cx, cy, ARRANGEMENTS[int(arrays[10])])
    axes = arrays[11:15]
    capture = prepare(arrays[:5], axes, lattice, Distortion(arrays[15]))
    return capture, grid_from(dh, dv, int(arrays[10])), axes[2], axes[3]


def _check(lf: xr.Dataset, disp: xr.Dataset) -> None:
    for ds, names, what in (
        (lf, ("mosaic", "cfa", "weight", *LATTICE_NAMES), "light field"),
        (disp, ("disparity", "disparity_std"), "disparity"),
    ):
        missing = [name for name in names if name not in ds.variables]
        if missing:
            raise SchemaError(f"dataset is no {what}: it has no {', '.join(missing)}")
    for dim in FIELD_DIMS:
        if dim not in disp["disparity"].dims:
            raise SchemaError(f"the disparity has no dim {dim}: transpose_disparity gives that of every view")
        if not np.array_equal(lf[dim], disp[dim]):
            raise SchemaError(f"light field and disparity differ in {dim}")


def _whole(array: xr.DataArray) -> xr.DataArray:
    """Without coordinates, the field of one capture in one chunk."""
    variable = array.variable
    return xr.DataArray(variable.chunk(dict.fromkeys(FIELD_DIMS, -1)) if variable.chunks else variable)


def _plain(array: xr.DataArray) -> xr.DataArray:
    return xr.DataArray(array.variable)


def _view_tasks(wanted: Mapping[str, Array], arrays: Sequence[xr.DataArray]) -> tuple[xr.DataArray, xr.DataArray]:
    """Offsets v and u of each view wanted, (v_out, u_out); of lazy fields one view of one capture a chunk."""
    v, u = np.meshgrid(wanted["v"], wanted["u"], indexing="ij")
    both = xr.DataArray(v, dims=("v_out", "u_out")), xr.DataArray(u, dims=("v_out", "u_out"))
    if not any(array.chunks for array in arrays):
        return both
    lead = next((array for array in arrays if "capture" in array.dims), None)
    chunks: dict[str, Any] = {"v_out": 1, "u_out": 1}
    if lead is not None:
        both = both[0].expand_dims(capture=lead.sizes["capture"]), both[1].expand_dims(capture=lead.sizes["capture"])
        chunks["capture"] = lead.chunksizes.get("capture", lead.sizes["capture"])
    return both[0].chunk(chunks), both[1].chunk(chunks)


def _output_grid(lf: xr.Dataset, scale: float | None) -> tuple[Array, Array]:
    """Indices t and s of the output; of the first capture where there are several (one camera has one shape)."""
    t, s = np.asarray(lf["t"]), np.asarray(lf["s"])
    if scale is None:
        return t, s
    if not scale > 0:
        raise ValueError(f"scale must be positive, found {scale}")
    row_pitch = grid_of(lf).row_pitch * scale
    return (
        np.arange(np.ceil(t[0] * row_pitch), np.floor(t[-1] * row_pitch) + 1).astype(np.int64),
        np.arange(np.ceil(s[0] * scale), np.floor(s[-1] * scale) + 1).astype(np.int64),
    )


def _sizes(geometry: tuple[Array, Array]) -> dict[str, int]:
    return {"t_out": len(geometry[0]), "s_out": len(geometry[1])}


def _coords(
    lf: xr.Dataset, wanted: Mapping[str, Array], geometry: tuple[Array, Array], scale: float | None
) -> dict[str, Any]:
    own = {"v", "u", "t", "s", "axis", "term"}
    kept = {name: coord.variable for name, coord in lf.coords.items() if not own & set(coord.dims)}
    axes = {dim: (dim, values.astype(np.int64) if np.all(values == np.rint(values)) else values)
            for dim, values in wanted.items()}  # fmt: skip
    out: dict[str, Any] = {
        **{str(name): kept[name] for name in kept},
        **{name: lf[name].variable for name in LATTICE_NAMES},
        **axes,
    }
    out |= {"t": ("t", geometry[0]), "s": ("s", geometry[1]), "channel": ("channel", list(CHANNELS))}
    if scale is None:
        return out
    if any(lf[name].ndim for name in LATTICE_NAMES):
        per_pixel = lf["dh"].variable / scale
        return out | {"dh": per_pixel, "dv": per_pixel, "arrangement": np.uint8(1), "scale": np.float64(scale)}
    return out | square_lattice(lattice_of(lf), scale)


def _places(grid: Grid, t: Array, s: Array, scale: float | None) -> tuple[Array, Array]:
    """X and Y of the output relative to the first lens of the first row, lens pitches."""
    if scale is None:
        x, y = grid.places(t, s)
    else:
        rows = np.arange(np.ceil(t[0] * grid.row_pitch * scale), np.floor(t[-1] * grid.row_pitch * scale) + 1)
        columns = np.arange(np.ceil(s[0] * scale), np.floor(s[-1] * scale) + 1)
        x, y = Grid(1 / scale, 1 / scale, 0.0).places(rows, columns)
    return x - np.float32(s[0]), y - np.float32(t[0] * grid.row_pitch)
