"""How finely each interpolation of images and of costs tells a disparity (METHOD 8.4, 8.5): table and plot.

    python pipelines/subpixel_study.py [--out study.png]

A mosaicked F01 field of one slanted plane of known disparity is matched along its even pairs, with every named image
interpolation (linear, cubic, bandlimited; each also with the views sampled twice as finely, "x2") and every cost
interpolation. Pixel locking is the range of the mean error over the phase of the shift.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.kernels.mosaicked.subpixel import minimum
from lfflow.lattice import Lattice
from lfflow.schema import lattice_variables
from lfflow.stages.costs import pair_costs

LATTICE = Lattice(10.00861, 10.01028, 0.00143, 7.3, 6.1)
PAIR = (2, 0)
BAYER = np.array([[2, 1], [1, 0]], dtype=np.uint8)
IMAGES = ("linear", "cubic", "bandlimited")
COSTS = ("none", "parabola", "equiangular", "spline")


def slanted_field(
    shape: tuple[int, int] = (64, 100), noise: float = 0.01, seed: int = 0
) -> tuple[xr.Dataset, npt.NDArray[np.float64]]:
    """Field of a plane whose disparity rises along the rows, and its disparity (t, s); up to 0.35 cycles a lens."""
    rng = np.random.default_rng(seed)
    t, s = np.arange(shape[0]), np.arange(shape[1])
    x, y = LATTICE.centres(t[:, None], s[None, :])
    px, py = np.floor(x + 0.5).astype(int), np.floor(y + 0.5).astype(int)
    across = s[None, :] + LATTICE.row_offset(t)[:, None]
    down = t[:, None] * LATTICE.row_pitch + 0 * across
    truth = 0.05 + 0.5 * t[:, None] / shape[0] + 0 * across
    views = np.array([-2, 0, 2])
    mosaic, cfa = [], []
    radius, angle, phase = 0.35 * np.sqrt(rng.uniform(0.05, 1, 40)), *rng.uniform(0, 2 * np.pi, (2, 40))
    for u in views:
        moved = across + truth * (u + px - x)
        waves = (np.sin(2 * np.pi * r * (np.cos(a) * moved + np.sin(a) * down) + p)
                 for r, a, p in zip(radius, angle, phase, strict=True))  # fmt: skip
        mosaic.append(0.5 + 0.05 * sum(waves) + noise * rng.standard_normal(shape))
        cfa.append(BAYER[py % 2, (px + u) % 2])
    dims = ("v", "u", "t", "s")
    lf = xr.Dataset(
        {
            "mosaic": (dims, np.stack(mosaic)[None].astype(np.float32)),
            "cfa": (dims, np.stack(cfa)[None]),
            "weight": (dims, np.ones((1, 3, *shape), dtype=np.float32)),
        },
        coords={"v": [0], "u": views, "t": t, "s": s, **lattice_variables(LATTICE)},
    )
    return lf, truth


def measure(lf: xr.Dataset, truth: npt.NDArray[np.float64]) -> list[dict[str, Any]]:
    """One row for each combination: rms, median error and locking in lenses of shift, and CPU seconds."""
    rows = []
    for image in IMAGES:
        for finer in (1, 2):
            labels = np.arange(-0.25, 0.9, 1 / (PAIR[0] * finer))
            start = time.process_time()
            cost = pair_costs(lf, pairs=[PAIR], hypotheses=labels, interpolation=image).isel(pair=0).to_numpy()  # type: ignore[arg-type]
            seconds = time.process_time() - start
            for method in COSTS:
                found, _ = minimum(cost, labels, method)  # type: ignore[arg-type]
                error = (PAIR[0] * (found - truth))[8:-8, 10:-10]
                shift = (PAIR[0] * truth)[8:-8, 10:-10]
                good = np.abs(error) < 0.5
                phase = np.floor(shift[good] % 1 * 10).astype(int)
                bias = [error[good][phase == k].mean() for k in range(10) if (phase == k).any()]
                rows.append({
                    "images": image + (" x2" if finer == 2 else ""), "cost": method,
                    "rms": float(np.sqrt(np.mean(error[good] ** 2))), "median": float(np.median(np.abs(error[good]))),
                    "locking": float(max(bias) - min(bias)), "bias": bias, "seconds": seconds,
                })  # fmt: skip
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Mean error over the phase of the shift, one line for each combination with the parabola."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 5))
    for row in rows:
        if row["cost"] == "parabola":
            axes.plot(np.arange(len(row["bias"])) / 10 + 0.05, row["bias"], label=row["images"])
    axes.set(xlabel="phase of the shift (lenses)", ylabel="mean error (lenses)", title="Pixel locking, parabola")
    axes.legend()
    figure.savefig(path, dpi=100)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> list[dict[str, Any]]:
    """Measure, print the table, draw the plot if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="write the plot here")
    parser.add_argument("--noise", type=float, default=0.01)
    options = parser.parse_args(arguments)
    rows = measure(*slanted_field(noise=options.noise))
    print("| images | cost | rms | median | locking | CPU s |\n|---|---|---|---|---|---|")
    for row in rows:
        numbers = " | ".join(f"{row[name]:.4f}" for name in ("rms", "median", "locking", "seconds"))
        print(f"| {row['images']} | {row['cost']} | {numbers} |")
    if options.out:
        draw(rows, options.out)
    return rows


if __name__ == "__main__":
    main()
