"""Calibration (seed chapter 6): where the lenses are, and how they shade, from a white image or any picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.cameras import KNOWN_CAMERAS
from lfflow.distortion import STRAIGHT
from lfflow.kernels.lattice.centres import flatten_scene, measure_centres
from lfflow.kernels.lattice.fit import Fit, fit
from lfflow.kernels.lattice.likelihood import refine
from lfflow.kernels.lattice.residual_field import judge, unjudged
from lfflow.kernels.lattice.scene_push import unpushed
from lfflow.kernels.lattice.shade import shade
from lfflow.kernels.lattice.spectrum import start
from lfflow.kernels.lattice.white import white_vignetting
from lfflow.kernels.sensor.defects import HOT, SATURATED, STEPS, aberrant_pixels
from lfflow.kernels.sensor.equalise import equalise, weighted
from lfflow.kernels.sensor.radiometry import normalise_levels
from lfflow.lattice import ARRANGEMENTS
from lfflow.schema import CALIBRATION, PARAMETERS
from lfflow.schema.declarations import METHOD_FLAGS
from lfflow.stages.defects import with_defects

Method = Literal["white", "self"]
Image = npt.NDArray[np.float32]

_SENSOR = ["y", "x"]
_TILE = ["tile_y", "tile_x"]
_OUTPUTS: tuple[tuple[list[str], type], ...] = (
    (["parameter"], np.float64),
    (["parameter", "parameter_b"], np.float64),
    ([], np.uint8),
    ([], np.float64),
    ([], np.int64),
    (["axis", "term"], np.float64),
    ([], np.float64),
    ([], np.float64),
    (_SENSOR, np.float32),
    (_SENSOR, np.uint8),
)
_SMALL_SIZES = {"parameter": 5, "parameter_b": 5, "axis": 2, "term": STRAIGHT.numbers.shape[1]}


def calibrate(
    raw: xr.Dataset,
    method: Method | None = None,
    *,
    precise: bool = True,
    alpha: Sequence[float] = (1.0, 1.0, 1.0),
    defects: xr.DataArray | None = None,
) -> xr.Dataset:
    """Lattice, vignetting and defects of a raw frame; nothing in its metadata is trusted.

    Parameters
    ----------
    raw
        `lfflow.schema.RAW`: ``raw(y, x)`` in counts, with or without a ``capture`` dim, numpy or dask.
    method
        "white": the frame shows an even light. "self": it is a picture; the scene is divided out first.
        By default what ``raw.kind`` says.
    precise
        Maximum likelihood on all lenses; else on one of twelve.
    alpha
        Weights of R, G and B (of equal gain) in the local method's quality Q, from whose peaks the refinement starts.
    defects
        Flags (y, x) of sensor pixels known to be bad, of dark frames or many pictures (`lfflow.stages.defects`); they
        are added to those that the frame itself shows.

    Returns
    -------
    calibration
        `lfflow.schema.CALIBRATION`, lazy where `raw` is: lattice in sensor pixels and radians (seed equation 6.1),
        its covariance, its bend where a white image shows one (`lfflow.distortion`), ``vignetting(y, x)`` relative to
        its peak, ``pixel_flags(y, x)``. A picture never gets a bend of its own: its scene displaces the measured
        centres by more than any lens array does, and as smoothly. The lattice is numbered for the grid of the camera
        model where that is known, else for its own (`Lattice.anchored`).

    Raises
    ------
    LatticeNotFoundError
        The picture is too dark or too flat to carry a lattice (when computed).
    """
    outputs = xr.apply_ufunc(
        _calibrate_frame,
        raw["raw"],
        _tile(raw, "black_level"),
        _tile(raw, "white_level"),
        _method(raw, method),
        _grid(raw),
        _tile(raw, _site_weights(alpha)),
        input_core_dims=[_SENSOR, _TILE, _TILE, [], ["grid"], _TILE],
        output_core_dims=[dims for dims, _ in _OUTPUTS],
        output_dtypes=[dtype for _, dtype in _OUTPUTS],
        vectorize=True,
        dask="parallelized",
        dask_gufunc_kwargs={"allow_rechunk": True, "output_sizes": _SMALL_SIZES},
        keep_attrs=False,
        kwargs={"precise": precise},
    )
    numbers, covariance, arrangement, rms, count, distortion, bend_rms, bend_chance, vignetting, flags = outputs
    variables = {name: numbers.isel(parameter=index, drop=True) for index, name in enumerate(PARAMETERS)}
    variables |= {"arrangement": arrangement, "covariance": covariance, "residual_rms": rms, "lens_count": count}
    variables |= {"distortion": distortion, "distortion_rms": bend_rms, "distortion_chance": bend_chance}
    variables |= {"method": _method(raw, method), "vignetting": vignetting, "pixel_flags": flags}
    axes = {dim: raw[dim] if dim in raw.coords else np.arange(raw.sizes[dim]) for dim in _SENSOR}
    cal = xr.Dataset({name: value.reset_coords(drop=True) for name, value in variables.items()})
    if "capture" in raw.coords:
        axes["capture"] = raw["capture"]
    cal = cal.assign_coords({**axes, "parameter": list(PARAMETERS), "axis": ["x", "y"]})
    return CALIBRATION.annotate(with_defects(cal, defects))


def _calibrate_frame(
    raw: npt.NDArray[np.uint16],
    black: npt.NDArray[np.float64],
    white: npt.NDArray[np.float64],
    method: np.uint8,
    grid: npt.NDArray[np.int64],
    weights: npt.NDArray[np.float64],
    *,
    precise: bool,
) -> tuple[Any, ...]:
    raw = np.ascontiguousarray(raw)
    gray, _ = equalise(raw, black)
    scene = bool(method == METHOD_FLAGS["self"])
    found, flat = locate(gray, scene=scene, grid=(int(grid[0]), int(grid[1])), weights=weights)
    clipped = _clipped(raw, white)
    found, state = refine(gray, found, clipped, scene=flat if scene else None, precise=precise)
    bend = unjudged(found.lattice)
    if scene:
        vignetting = shade(state.aperture, found.lattice, flat)
    else:
        if precise:
            bend = judge(gray, clipped, replace(state, lattice=found.lattice))
        found = replace(found, lattice=bend.lattice)
        vignetting = white_vignetting(gray, found.lattice)
    numbers = np.array([getattr(found.lattice, name) for name in PARAMETERS])
    arrangement = np.uint8(ARRANGEMENTS.index(found.lattice.arrangement))
    flags = _pixel_flags(raw, black, white, vignetting, scene=scene)
    count = np.int64(found.count)
    bent = bend.distortion.numbers, bend.rms, bend.chance
    return numbers, found.covariance, arrangement, found.rms, count, *bent, vignetting, flags


def _pixel_flags(
    raw: npt.NDArray[np.uint16],
    black: npt.NDArray[np.float64],
    white: npt.NDArray[np.float64],
    vignetting: Image,
    *,
    scene: bool,
) -> npt.NDArray[np.uint8]:
    """Hot pixels (y, x); on a white image also dead and clipped ones, for those of a scene are its own."""
    radiance = normalise_levels(raw, black.astype(np.float32), (1 / (white - black)).astype(np.float32))
    flags, _ = aberrant_pixels(radiance, vignetting, step=STEPS["scene" if scene else "white"])
    if scene:
        return flags & np.uint8(HOT)
    return flags | (radiance >= 1).astype(np.uint8) * np.uint8(SATURATED)


def _clipped(raw: npt.NDArray[np.uint16], white: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """1 where a sample (y, x) is at its site's white level, shape (2, 2)."""
    out = np.zeros(raw.shape, np.uint8)
    for row in range(2):
        for column in range(2):
            out[row::2, column::2] = raw[row::2, column::2] >= white[row, column]
    return out


def locate(
    gray: Image, *, scene: bool, grid: tuple[int, int], weights: npt.NDArray[np.float64] | None = None
) -> tuple[Fit, Image]:
    """Lattice of the subimages' peaks in a gray image, and the image with its scene, if it has one, divided out.

    `grid` (0, 0) is the lattice's own. `weights` (2, 2) of the Bayer tile's sites count in the peaks (the seed's α).
    """
    first = start(gray)
    flat = flatten_scene(gray, first.dh) if scene else gray
    centres = measure_centres(flat if weights is None else weighted(flat, weights), first)
    found = fit(centres, first, (gray.shape[0], gray.shape[1]), grid if all(grid) else None)
    return unpushed(gray, centres, found) if scene else found, flat


def _method(raw: xr.Dataset, method: Method | None) -> xr.DataArray:
    if method is not None:
        code = np.uint8(METHOD_FLAGS[method])
        like = raw["kind"] if "kind" in raw.variables else xr.DataArray("")
        return xr.full_like(like.reset_coords(drop=True), code, dtype=np.uint8)
    codes: xr.DataArray = xr.apply_ufunc(
        lambda kind: np.uint8(METHOD_FLAGS["white" if str(kind) == "white" else "self"]),
        raw["kind"].reset_coords(drop=True),
        output_dtypes=[np.uint8],
        vectorize=True,
        dask="parallelized",
    )
    return codes


def _site_weights(alpha: Sequence[float]) -> xr.DataArray:
    """Weights of R, G, B as those of the sites; their mean over a tile is 1."""
    red, green, blue = alpha
    sites = np.array([red, green, green, blue], dtype=float)
    return xr.DataArray(sites / sites.mean(), dims="site")


def _tile(raw: xr.Dataset, of_sites: str | xr.DataArray) -> xr.DataArray:
    """Level of each site of the 2×2 tile, dims (tile_y, tile_x) and those of the pattern."""
    pattern, levels = raw["cfa_pattern"], raw[of_sites] if isinstance(of_sites, str) else of_sites

    def place(text: object, level: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.array([level[index] for index in site_indices(str(text))], dtype=float).reshape(2, 2)

    tile: xr.DataArray = xr.apply_ufunc(
        place,
        pattern.reset_coords(drop=True),
        levels.reset_coords(drop=True).drop_vars("site", errors="ignore"),
        input_core_dims=[[], ["site"]],
        output_core_dims=[_TILE],
        output_dtypes=[np.float64],
        vectorize=True,
        dask="parallelized",
        dask_gufunc_kwargs={"output_sizes": {"tile_y": 2, "tile_x": 2}, "allow_rechunk": True},
    )
    return tile


def site_indices(pattern: str) -> list[int]:
    """Index into (r, gr, gb, b) of each of the four pixels of a tile such as "BGGR"."""
    indices = []
    for place, colour in enumerate(pattern):
        row = pattern[place // 2 * 2 : place // 2 * 2 + 2]
        indices.append({"R": 0, "B": 3, "G": 1 if "R" in row else 2}[colour])
    return indices


def _grid(raw: xr.Dataset) -> xr.DataArray:
    """Rows and columns (t, s) of the camera model of each capture, (0, 0) where it is not known."""
    size = (raw.sizes["y"], raw.sizes["x"])

    def shape_of(model: object) -> npt.NDArray[np.int64]:
        camera = KNOWN_CAMERAS.get(str(model))
        known = camera is not None and (camera.height, camera.width) == size
        return np.array(camera.grid_shape if camera is not None and known else (0, 0), dtype=np.int64)

    model = raw["camera_model"] if "camera_model" in raw.variables else xr.DataArray("")
    grid: xr.DataArray = xr.apply_ufunc(
        shape_of,
        model.reset_coords(drop=True),
        output_core_dims=[["grid"]],
        output_dtypes=[np.int64],
        vectorize=True,
        dask="parallelized",
        dask_gufunc_kwargs={"output_sizes": {"grid": 2}},
    )
    return grid
