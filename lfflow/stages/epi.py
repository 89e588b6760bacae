"""Epipolar images, and the lines that the estimated disparity draws in them (seed 4.3)."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from lfflow.errors import LfflowError
from lfflow.stages.grid import grid_of


def epi(
    views: xr.Dataset, *, t: int | None = None, s: int | None = None, v: float = 0, u: float = 0, every: int = 8
) -> xr.Dataset:
    """Epipolar image of row ``t`` (u against s) or of column ``s`` (v against t), with the lines of its disparity.

    Parameters
    ----------
    views
        ``rgb`` or ``mosaic`` (v, u, t, s[, channel]), and ``disparity`` (v, u, t, s) where the lines are wanted.
    t, s
        The row or the column; one of them.
    v, u
        View row that an image of row ``t`` is taken from; view column for one of column ``s``.
    every
        Every how many places a line is drawn.

    Returns
    -------
    Dataset
        ``epi`` (u, s[, channel]) or (v, t[, channel]); with a disparity, ``line`` (u, line) or (v, line): where in
        ``s`` or ``t`` the point that the view nearest to 0 shows at the coordinate ``line`` lies in each view.
    """
    if (t is None) == (s is None):
        raise LfflowError("an epipolar image is of one row (t=…) or of one column (s=…)")
    name = "rgb" if "rgb" in views else "mosaic"
    lens, view = ("s", "u") if s is None else ("t", "v")
    cut = {"t": t, "v": v} if s is None else {"s": s, "u": u}
    if lens == "t" and grid_of(views).offset:
        raise LfflowError("columns of the brick layout are no epipolar lines: reconstruct on the square grid (scale=1)")
    sliced = views.sel(cut)
    out = xr.Dataset({"epi": sliced[name]})
    if "disparity" in views:
        pitch = grid_of(views).column_pitch if lens == "s" else grid_of(views).row_pitch
        nearest = sliced[view][int(np.argmin(np.abs(np.asarray(sliced[view]))))]
        chosen = sliced["disparity"].sel({view: nearest}).isel({lens: slice(None, None, every)}).drop_vars(view)
        start = chosen[lens].rename({lens: "line"})
        slope = chosen.rename({lens: "line"}) / pitch
        out["line"] = start.astype(np.float64).drop_vars("line") - slope * (sliced[view] - nearest.drop_vars(view))
        out["line"].attrs = {"long_name": f"place in {lens} along the estimated disparity", "units": "1"}
    return out


def plot_epi(image: xr.Dataset, axes: Any) -> Any:
    """Draw an epipolar image with its lines on matplotlib axes; returns the axes."""
    view, lens = (str(dim) for dim in image["epi"].dims[:2])
    values = np.clip(np.nan_to_num(np.asarray(image["epi"], dtype=np.float64)), 0, 1)
    low, high = float(image[lens][0]), float(image[lens][-1])
    first, last = float(image[view][0]), float(image[view][-1])
    extent = (low - 0.5, high + 0.5, last + 0.5, first - 0.5)
    axes.imshow(values, extent=extent, aspect="auto", cmap="gray")
    if "line" in image:
        lines = image["line"].transpose(view, "line")
        axes.plot(lines.values, image[view].values, color="tab:red", linewidth=0.8)
    axes.set(xlabel=lens, ylabel=view, xlim=extent[:2], ylim=extent[2:])
    return axes
