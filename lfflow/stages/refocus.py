"""Pictures from full-colour views: focused on planes, on a surface, with a chosen aperture (seed 4.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.conventions import FIELD_DIMS
from lfflow.errors import LfflowError, SchemaError
from lfflow.kernels.colour.focus import add_on_surface, add_shifted
from lfflow.stages.grid import Grid, grid_of

Array = npt.NDArray[Any]

_PRESENT = 0.5
_RGB_DIMS = [*FIELD_DIMS, "channel"]


def aperture(ds: xr.Dataset, shape: str = "full", *, radius: float | None = None) -> xr.DataArray:
    """Aperture function P(v, u) over the views of `ds`.

    Parameters
    ----------
    shape
        "full": all views; "disc": those within `radius`; "ring": the outer half pixel pitch of that disc; "single":
        the view nearest to (0, 0).
    radius
        Sensor pixels; the largest offset by default.
    """
    distance: xr.DataArray = ((ds["u"] ** 2.0 + ds["v"] ** 2.0) ** 0.5).transpose("v", "u")
    largest = float(max(abs(ds["u"]).max(), abs(ds["v"]).max())) if radius is None else radius
    shapes: dict[str, xr.DataArray] = {
        "full": xr.ones_like(distance),
        "disc": distance <= largest + 0.25,
        "ring": (distance <= largest + 0.5) & (distance > largest - 0.5),
        "single": distance == distance.min(),
    }
    if shape not in shapes:
        raise LfflowError(f"no aperture {shape!r}: there are {', '.join(shapes)}, and arrays (v, u)")
    return shapes[shape].astype(np.float32)


def refocus(
    views: xr.Dataset, d: float | Sequence[float] = 0.0, *, aperture_function: str | xr.DataArray = "full"
) -> xr.DataArray:
    """Picture focused on the plane of disparity d: Σ P(q)·L(X − d·q, q) / Σ P (seed eq. 4.6).

    The shift is a windowed sinc of eight taps, in the true geometry of the grid.

    Parameters
    ----------
    views
        ``rgb`` (v, u, t, s, channel), brick or square, with or without ``capture``.
    d
        Disparity, lens pitches per view step (pixels for folders of views); several make a focal stack.
    aperture_function
        Name of a shape (`aperture`), or an array (v, u).

    Returns
    -------
    rgb ([capture,] [d,] t, s, channel) float32.
    """
    weights = _weights(views, aperture_function)
    planes = xr.DataArray(np.asarray(d, dtype=np.float64), dims="d" if np.ndim(d) else ())

    def one(rgb: Array, gains: Array, plane: Array, v: Array, u: Array) -> Array:
        total, layers = _start(rgb)
        for i, j in zip(*np.nonzero(gains), strict=True):
            add_shifted(total, layers(i, j), -float(plane) * u[j], -float(plane) * v[i], gains[i, j], geometry)
        return _finish(total)

    geometry = _geometry(views)
    picture = _over_captures(one, views, [views["rgb"]], [_RGB_DIMS], weights, planes)
    out = picture.assign_coords(d=planes)
    out["d"].attrs = {"long_name": "disparity in focus", "units": "1"}
    return out


def all_in_focus(
    views: xr.Dataset, *, u: float = 0, v: float = 0, aperture_function: str | xr.DataArray = "full",
    tolerance: float = 0.06,
) -> xr.DataArray:  # fmt: skip
    """View (u, v) with every point in focus: the views averaged along its own disparity, occlusions left out.

    ``views`` hold ``rgb`` and ``disparity`` (v, u, t, s[, channel]) as `lfflow.reconstruct_views` gives them.
    `tolerance` is the disparity difference at which a view's sample counts a quarter. Returns rgb (t, s, channel).
    """
    return _on_surface(views, (u, v), (-np.inf, np.inf), aperture_function, tolerance)


def depth_of_field(
    views: xr.Dataset, d0: float, width: float, *, u: float = 0, v: float = 0,
    aperture_function: str | xr.DataArray = "full",
) -> xr.DataArray:  # fmt: skip
    """Picture in which disparities within ``d0 ± width/2`` are sharp and the rest is blurred by its distance from them.

    The surface in focus is the scene's own disparity, clipped to that range (seed 4.3, end). Arguments as in
    `all_in_focus`. Returns rgb (t, s, channel).
    """
    return _on_surface(views, (u, v), (d0 - width / 2, d0 + width / 2), aperture_function, 0.0)


def _on_surface(
    views: xr.Dataset,
    viewpoint: tuple[float, float],
    limits: tuple[float, float],
    aperture_function: str | xr.DataArray,
    tolerance: float,
) -> xr.DataArray:
    if "disparity" not in views:
        raise SchemaError("the views carry no disparity: reconstruct_views leaves it beside rgb")
    geometry, grid = _geometry(views), grid_of(views)
    t, s = np.asarray(views["t"]), np.asarray(views["s"])
    places = np.stack(_relative(grid, t, s))

    def one(rgb: Array, disparity: Array, gains: Array, v: Array, u: Array) -> Array:
        total, layers = _start(rgb)
        near = int(np.argmin(np.abs(v - viewpoint[1]))), int(np.argmin(np.abs(u - viewpoint[0])))
        surface = np.clip(disparity[near], *limits).astype(np.float32)
        for i, j in zip(*np.nonzero(gains), strict=True):
            layer, own, gain = layers(i, j), np.ascontiguousarray(disparity[i, j]), float(gains[i, j])
            a, b = float(u[j] - u[near[1]]), float(v[i] - v[near[0]])
            add_on_surface(total, layer, own, surface, places, a, b, gain, tolerance, geometry)
        return _finish(total)

    arrays = [views["rgb"], views["disparity"]]
    return _over_captures(one, views, arrays, [_RGB_DIMS, list(FIELD_DIMS)], _weights(views, aperture_function))


def _over_captures(
    one: Callable[..., Array],
    views: xr.Dataset,
    arrays: Sequence[xr.DataArray],
    core: Sequence[Sequence[str]],
    weights: xr.DataArray,
    *loops: xr.DataArray,
) -> xr.DataArray:
    """Apply `one` to the whole field of each capture, lazily."""
    whole = []
    for array, dims in zip(arrays, core, strict=True):
        variable = array.variable
        whole.append(xr.DataArray(variable.chunk(dict.fromkeys(dims, -1)) if variable.chunks else variable))
    axes = [xr.DataArray(np.asarray(views[dim], dtype=np.float64), dims=dim) for dim in ("v", "u")]
    out: xr.DataArray = xr.apply_ufunc(
        one,
        *whole,
        xr.DataArray(weights.variable),
        *loops,
        *axes,
        input_core_dims=[*core, ["v", "u"], *([[]] * len(loops)), ["v"], ["u"]],
        output_core_dims=[["t", "s", "channel"]],
        vectorize=True,
        dask="parallelized",
        output_dtypes=["float32"],
    )
    kept = {str(n): c.variable for n, c in views.coords.items() if set(c.dims) <= set(out.dims) and n not in ("v", "u")}
    out = out.assign_coords(kept).rename("rgb")
    out.attrs = {"long_name": "linear radiance of each channel", "units": "1"}
    return out


def _weights(views: xr.Dataset, function: str | xr.DataArray) -> xr.DataArray:
    if isinstance(function, str):
        return aperture(views, function)
    if set(function.dims) != {"v", "u"}:
        raise LfflowError(f"an aperture function has the dims v and u, found {function.dims}")
    aligned = function.reindex(v=views["v"], u=views["u"], fill_value=0) if "v" in function.coords else function
    return aligned.transpose("v", "u").astype(np.float32)


def _geometry(views: xr.Dataset) -> Array:
    grid = grid_of(views)
    odd = int(views["t"][0]) % 2 if grid.offset else 0
    return np.array([grid.row_pitch, grid.column_pitch, grid.offset, odd], dtype=np.float64)


def _relative(grid: Grid, t: Array, s: Array) -> tuple[Array, Array]:
    """Places relative to the first place of the first row, less its brick offset."""
    x, y = grid.places(t, s)
    return x - np.float32(s[0] * grid.column_pitch), y - np.float32(t[0] * grid.row_pitch)


def _start(rgb: Array) -> tuple[Array, Callable[[int, int], Array]]:
    """An empty sum (t, s, 4), and each view as colour × presence, presence."""

    def layers(i: int, j: int) -> Array:
        view = np.ascontiguousarray(rgb[i, j])
        present = np.isfinite(view).all(axis=-1, keepdims=True)
        return np.concatenate([np.where(present, view, 0), present], axis=-1).astype(np.float32)

    return np.zeros((*rgb.shape[2:4], 4), dtype=np.float32), layers


def _finish(total: Array) -> Array:
    """Colours divided by the presence they rest on; NaN where nothing is seen."""
    presence = total[..., 3:]
    known = presence > _PRESENT * 1e-3 * max(float(presence.max()), 1e-6)
    return np.where(known, total[..., :3] / np.where(known, presence, 1), np.float32(np.nan)).astype(np.float32)
