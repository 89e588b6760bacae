"""Disparity of the central view of a full-colour light field (METHOD 8.2 with all colours at every place).

First the cheapest smooth surface through the share of views that show something else along the lines of each
hypothesis; then all views are asked which side of a jump a place belongs to, each only about what it would see, and
jumps settle on the picture's edges; at last all views that see a place decide together what lies below the step of the
hypotheses, joined by a surface of little curvature. All of it measures the fine detail of the views: gloss and shading,
which move with the viewpoint, are left in what remains of them. Limits are in units of the noise, which the views tell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.kernels.full_colour.field import ViewField, view_field
from lfflow.kernels.full_colour.lines import lines_of
from lfflow.kernels.full_colour.refine import Refined, around, refine
from lfflow.kernels.full_colour.search import Found, search
from lfflow.kernels.full_colour.settle import settle_edges
from lfflow.kernels.full_colour.sides import choose_sides
from lfflow.schema import DISPARITY
from lfflow.schema.declarations import DISPARITY_FLAGS

FloatArray = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Settings:
    """Numbers of the matching, one set for all scenes.

    Parameters
    ----------
    step
        Distance of two hypotheses, pixels per view step.
    small, large
        Penalties of the aggregation (`lfflow.kernels.aggregate.regularise`).
    stiffness
        Information of a straight surface against that of the views (`lfflow.kernels.surface.fit_surface`).
    rounds
        Steps of the refinement; up to twice as many where there is much noise, in which every step is shorter.
    widest
        Largest |disparity| that the search for the range tries.
    """

    step: float = 0.1
    small: float = 0.3
    large: float = 5.0
    stiffness: float = 5e4
    rounds: int = 4
    widest: float = 6.0


def disparity_of_views(
    views: xr.Dataset,
    *,
    disparity_range: tuple[float, float] | None = None,
    settings: Settings | None = None,
    threads: int = 1,
) -> xr.Dataset:
    """Disparity, its standard deviation and flags (t, s) of the central view.

    Parameters
    ----------
    views
        ``rgb (v, u, t, s, channel)`` in any order, numpy or dask; views that are missing hold NaN.
    disparity_range
        Smallest and largest disparity, pixels per view step; found from the views when not given.
    threads
        Cores to use; the result does not depend on it.

    Returns
    -------
    Dataset ``disparity``, ``disparity_std`` (same unit), ``flags``; scalar coordinates u = v = 0.

    Raises
    ------
    ValueError
        Without the central view, or without any other.
    """
    dims = [["v", "u", "t", "s", "channel"]]
    disparity, std, flags = xr.apply_ufunc(
        _disparity,
        views["rgb"],
        views["u"],
        views["v"],
        input_core_dims=[*dims, ["u"], ["v"]],
        output_core_dims=[["t", "s"]] * 3,
        vectorize=True,
        dask="parallelized",
        dask_gufunc_kwargs={"allow_rechunk": True},
        output_dtypes=[np.float32, np.float32, np.uint8],
        kwargs={"disparity_range": disparity_range, "settings": settings or Settings(), "threads": threads},
    )
    found = xr.Dataset({"disparity": disparity, "disparity_std": std, "flags": flags})
    kept = {name: views[name] for name in ("t", "s", "capture") if name in views.coords}
    return DISPARITY.annotate(found.assign_coords(kept).assign_coords(u=0, v=0))


def _disparity(
    rgb: FloatArray,
    u: npt.NDArray[Any],
    v: npt.NDArray[Any],
    *,
    disparity_range: tuple[float, float] | None,
    settings: Settings,
    threads: int = 1,
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.uint8]]:
    field = view_field(np.asarray(rgb, dtype=np.float32), np.asarray(u), np.asarray(v), threads)
    low, high = disparity_range or _range(field, settings, threads)
    hypotheses = np.arange(low, high + settings.step, settings.step).astype(np.float32)
    first = search(field, hypotheses, settings.small, settings.large, threads)
    lines = lines_of(field, first.scale, max(abs(low), abs(high)), threads)
    sided = settle_edges(
        choose_sides(lines, field, first.disparity, first.edge), field.guide, rounds=3, threads=threads
    )
    rounds = round(settings.rounds * (1 + first.noisy))
    refined = refine(lines, field.guide, sided, stiffness=settings.stiffness, rounds=rounds)
    std = _deviation(refined, high - low)
    return refined.disparity, std, _flags(first, refined)


def _range(field: ViewField, settings: Settings, threads: int) -> tuple[float, float]:
    """Range of the disparities, from the views at half the size, where they are half as large."""
    small = field.cross().halved()
    hypotheses = np.arange(-settings.widest / 2, settings.widest / 2 + 0.05, 0.1).astype(np.float32)
    found = search(small, hypotheses, settings.small, settings.large, threads)
    values = found.disparity[found.sure] if found.sure.any() else found.disparity.ravel()
    margin = 0.3
    low, high = np.percentile(values, [0.1, 99.9])
    return 2 * float(low) - margin, 2 * float(high) + margin


def _deviation(refined: Refined, width: float) -> FloatArray:
    """Standard deviation: of the data around a place, of the surface from them, and of its bends, which it rounds off.

    Without any data it is the width of the range. The errors of HCI antinous and of rendered scenes with slanted planes
    lie within it for 60 to 80 %.
    """
    told = around(refined.information)
    apart = around(refined.information * (refined.own - refined.disparity) ** 2) / np.maximum(told, 1e-9)
    bend = cv2.Laplacian(cv2.blur(refined.disparity, (3, 3)), cv2.CV_32F)
    variance = 1 / (5 * told + 1 / width**2) + apart + (2 * bend) ** 2
    return np.asarray(np.minimum(1.1 * np.sqrt(variance), width), dtype=np.float32)


def _flags(first: Found, refined: Refined) -> npt.NDArray[np.uint8]:
    """Low texture: the cost hardly depends on the disparity, so the place was filled; occluded: no views agree."""
    flags = np.zeros(first.disparity.shape, dtype=np.uint8)
    flags[~first.sure] |= DISPARITY_FLAGS["low_texture"] | DISPARITY_FLAGS["filled"]
    flags[refined.residual > 30 * refined.noise] |= DISPARITY_FLAGS["occluded"]
    return flags
