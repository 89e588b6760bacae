"""Full-colour views from a mosaicked light field and its disparity (METHOD 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.ndimage import maximum_filter, minimum_filter

from lfflow.conventions import CFA_NONE, CHANNELS, FIELD_DIMS
from lfflow.distortion import Distortion
from lfflow.errors import SchemaError
from lfflow.kernels.demultiplex import residuals
from lfflow.kernels.gather import Rule, Samples, Targets, gather
from lfflow.kernels.guided import fill_colours
from lfflow.kernels.warp import read_disparity
from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.schema import DISPARITY, VIEWS, distortion_numbers, lattice_of
from lfflow.stages.grid import Grid, grid_from, grid_of, square_lattice
from lfflow.stages.on_field import LATTICE_NAMES

Array = npt.NDArray[Any]

FILLED = {"red_interpolated": 1, "green_interpolated": 2, "blue_interpolated": 4, "no_data": 8}
"""Bits of ``filled``: colours that no sample of another view could give."""

_UNKNOWN_STD = 0.1


def reconstruct_views(
    lf: xr.Dataset,
    disp: xr.Dataset,
    *,
    views: Mapping[str, Sequence[float]] | None = None,
    scale: float | None = None,
    rule: Rule | None = None,
) -> xr.Dataset:
    """Every colour at every place: same-colour samples of all views gathered along the disparity.

    A sample counts by its distance from the place, its vignetting weight, the agreement of its own disparity with that
    of the place, and the standard deviation of the disparity times the baseline. The places in the aperture are the
    true ones (view offset + rounding of the lens centre), so the views come out rectified. What no sample reaches is
    interpolated in the view, guided by its other colours, and flagged.

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
    arrays = [_whole(lf[name]) for name in ("mosaic", "cfa", "weight")]
    arrays += [_whole(disp[name]) for name in ("disparity", "disparity_std")]
    rule = rule or Rule(neighbours=1 if scale is None else 2)

    def one(*args: Any) -> tuple[Array, Array, Array, Array]:
        return _one_view(args[:5], args[5:12], args[12:14], args[14:], scale=scale, rule=rule)

    parts = xr.apply_ufunc(
        one,
        *arrays,
        *(_plain(lf[name]) for name in LATTICE_NAMES),
        distortion_numbers(lf),
        *_view_tasks(wanted, arrays),
        *(xr.DataArray(np.asarray(lf[dim]), dims=dim) for dim in FIELD_DIMS),
        input_core_dims=[list(FIELD_DIMS)] * 5 + [[]] * 6 + [["axis", "term"], [], []] + [[dim] for dim in FIELD_DIMS],
        output_core_dims=[["t_out", "s_out", "channel"], *([["t_out", "s_out"]] * 3)],
        vectorize=True,
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


def _one_view(
    arrays: Sequence[Array],
    lattice: Sequence[Array],
    view: Sequence[Array],
    axes: Sequence[Array],
    *,
    scale: float | None,
    rule: Rule,
) -> tuple[Array, Array, Array, Array]:
    mosaic, cfa, weight, disparity, std = (np.ascontiguousarray(array) for array in arrays)
    v, u, t, s = axes
    target_v, target_u = float(view[0]), float(view[1])
    dh, dv, theta, cx, cy = (float(value) for value in lattice[:5])
    numbers = Lattice(dh, dv, theta, cx, cy, ARRANGEMENTS[int(lattice[5])])
    grid = grid_from(numbers.dh, numbers.dv, int(lattice[5]))
    near = int(np.argmin(np.abs(v - target_v))), int(np.argmin(np.abs(u - target_u)))
    rho = np.stack(residuals(numbers, t, s, Distortion(lattice[6]))).astype(np.float32)
    samples = _samples(rho, grid, (mosaic, cfa, weight, disparity), (v, u, t, s), reach=rule.reach, view=view)
    x, y = _places(grid, t, s, scale)
    doubt = _doubt(disparity[near], std[near])
    off_grid = (target_u - u[near[1]], target_v - v[near[0]])
    if scale is None and off_grid == (0.0, 0.0):
        there, spread = disparity[near], doubt
    else:
        there = read_disparity(disparity[near], x, y, *off_grid, samples.geometry)
        spread = read_disparity(doubt, x, y, 0.0, 0.0, samples.geometry)
    targets = Targets(x, y, np.full_like(x, target_u), np.full_like(x, target_v), there, spread)
    rgb, _ = gather(samples, targets, rule)
    rgb, filled = fill_colours(rgb, x, y, there, rule.tolerance)
    return rgb, filled, there, spread


def _doubt(disparity: Array, std: Array) -> Array:
    """Standard deviation (t, s), raised at jumps of the disparity: a lens on an edge mixes two surfaces.

    There, only views near the wanted one show the same mixture.
    """
    known = np.isfinite(disparity)
    level = float(np.median(disparity[known])) if known.any() else 0.0
    filled = np.where(known, disparity, level)
    jump = maximum_filter(filled, 3) - minimum_filter(filled, 3)
    return np.asarray(np.hypot(np.where(np.isfinite(std), std, _UNKNOWN_STD), jump), dtype=np.float32)


def _samples(
    residual: Array,
    grid: Grid,
    fields: Sequence[Array],
    axes: Sequence[Array],
    *,
    reach: float,
    view: Sequence[Array],
) -> Samples:
    """Views that hold samples and lie within reach, as the kernel wants them."""
    mosaic, cfa, weight, disparity = fields
    v, u, t, _ = axes
    at_v, at_u = np.meshgrid(v, u, indexing="ij")
    near = (np.abs(at_v - float(view[0])) <= reach) & (np.abs(at_u - float(view[1])) <= reach)
    keep = near & (cfa != CFA_NONE).any(axis=(2, 3))
    return Samples(
        mosaic[keep],
        weight[keep],
        disparity[keep],
        cfa[keep],
        residual,
        np.stack([at_u[keep], at_v[keep]], axis=1).astype(np.float32),
        np.array([grid.row_pitch, grid.offset, t[0] % 2], dtype=np.float32),
    )


def _places(grid: Grid, t: Array, s: Array, scale: float | None) -> tuple[Array, Array]:
    """X and Y of the output relative to the first lens of the first row, lens pitches."""
    if scale is None:
        x, y = grid.places(t, s)
    else:
        rows = np.arange(np.ceil(t[0] * grid.row_pitch * scale), np.floor(t[-1] * grid.row_pitch * scale) + 1)
        columns = np.arange(np.ceil(s[0] * scale), np.floor(s[-1] * scale) + 1)
        x, y = Grid(1 / scale, 1 / scale, 0.0).places(rows, columns)
    return x - np.float32(s[0]), y - np.float32(t[0] * grid.row_pitch)
