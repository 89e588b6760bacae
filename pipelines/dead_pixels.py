"""Map of a camera's hot and dead pixels from many of its pictures, and its plot (seed 5.2, Figure 13).

    python pipelines/dead_pixels.py IMG_*.lfp --out defects.nc --plot defects.png

A pixel that sticks out of its same-colour neighbours in half of the pictures is hot; one that does so in a few is a
highlight. A pixel that is dark wherever its neighbours are bright is dead. Pictures are read one after the other; none
stays in memory.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr

from lfflow.errors import LfflowError
from lfflow.stages.defects import aberrant, defect_counts, defect_map


def count_defects(captures: Iterable[tuple[xr.Dataset, xr.Dataset]], *, least: float = 0.5) -> xr.Dataset:
    """Counts ``hot``, ``dead`` and ``tested``, and ``pixel_flags`` (y, x), from pairs (raw, calibration) in turn."""
    total: xr.Dataset | None = None
    for raw, cal in captures:
        counts = defect_counts(aberrant(raw, cal).expand_dims("capture")).compute()
        number = 1 if total is None else int(total.attrs["captures"]) + 1
        total = (counts if total is None else total + counts).assign_attrs(captures=number)
    if total is None:
        raise LfflowError("no pictures to look for defects in")
    return total.assign(pixel_flags=defect_map(total, least=least))


def plot_defects(found: xr.Dataset, path: Path) -> None:
    """Every pixel that ever stuck out, coloured by how many pictures show it."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    counts = (found.hot + found.dead).values
    y, x = np.nonzero(counts)
    order = np.argsort(counts[y, x])
    figure, axes = plt.subplots(figsize=(8, 7))
    points = axes.scatter(x[order], y[order], c=counts[y, x][order], s=8, cmap="viridis_r", vmin=1)
    axes.set(xlabel="x (pixel)", ylabel="y (pixel)", xlim=(0, counts.shape[1]), ylim=(counts.shape[0], 0), aspect=1)
    axes.set_title(f"{int((found.pixel_flags > 0).sum())} defects in {found.attrs['captures']} pictures")
    figure.colorbar(points, label="pictures that show the pixel aberrant")
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)


def main(*files: Path, out: Path = Path("defects.nc"), plot: Path | None = None, least: float = 0.5) -> None:
    """Write the defects of the camera that took `files`; every picture is calibrated on itself."""
    import lfflow

    raws = [xr.open_dataset(path, engine="lfp", chunks={}) for path in files]
    found = count_defects(((raw, lfflow.calibrate(raw)) for raw in raws), least=least)
    found.to_netcdf(out, engine="scipy")
    if plot is not None:
        plot_defects(found, plot)
    sys.stdout.write(f"{int((found.pixel_flags == 1).sum())} hot, {int((found.pixel_flags == 2).sum())} dead: {out}\n")


if __name__ == "__main__":
    import cyclopts

    cyclopts.run(main)
