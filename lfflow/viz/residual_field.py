"""A residual field as a picture: arrows, its size against its noise, and what the correction leaves."""

from __future__ import annotations

import os

import numpy as np
import xarray as xr


def draw_residual_field(field: xr.Dataset, path: str | os.PathLike[str], title: str = "") -> None:
    """Write a picture of a field of `lfflow.stages.residual_field`: measured, corrected, and left, as PNG or PDF."""
    from matplotlib.figure import Figure

    parts = {
        "measured − lattice": (field["dx"], field["dy"]),
        "correction": (field["bend_x"], field["bend_y"]),
        "what is left": (field["dx"] - field["bend_x"], field["dy"] - field["bend_y"]),
    }
    figure = Figure(figsize=(15, 5.2), layout="constrained")
    axes = figure.subplots(1, len(parts))
    largest = max(float(np.nanquantile(np.hypot(field["dx"].values, field["dy"].values), 0.98)), 1e-6)
    noise = float(np.sqrt(2) * field["std"].median())
    step = float(field["x"].diff("cell_x").median()) if field.sizes["cell_x"] > 1 else 1.0
    for ax, (name, (right, down)) in zip(axes, parts.items(), strict=True):
        size = np.hypot(right, down)
        spots = ax.scatter(field["x"], field["y"], c=size, s=40, cmap="viridis", vmin=0, vmax=largest, marker="s")
        ax.quiver(field["x"], field["y"], right, down, angles="xy", scale_units="xy", scale=largest / step, color="w",
                  edgecolor="k", linewidth=0.4, width=0.004)  # fmt: skip
        rms = float(np.sqrt((size**2).mean()))
        ax.set(title=f"{name}: rms {rms:.4f} px", aspect="equal", xlabel="x (px)", ylabel="y (px)")
        ax.invert_yaxis()
    figure.colorbar(spots, ax=axes, label="px", shrink=0.8)
    figure.suptitle(
        f"{title}   noise of a cell {noise:.4f} px, χ² per cell of what is left {float(field['excess']):.1f}"
    )
    figure.savefig(path, dpi=90)
