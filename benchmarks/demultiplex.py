"""CPU seconds of demultiplexing one F01 capture, beside a memcpy of the same traffic in the same run.

python benchmarks/demultiplex.py
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import time
import tracemalloc
from collections.abc import Callable

import numpy as np
import xarray as xr

from lfflow.cameras import F01
from lfflow.lattice import Lattice
from lfflow.schema import lattice_variables
from lfflow.simulate import simulate_capture, simulate_white
from lfflow.stages.demultiplex import demultiplex

PEERS = {"LFToolbox": 57.0, "plenpy": 19.0, "plenopticam": 93.0}
"""CPU seconds for 81 views, from the project's design notes."""


def capture() -> tuple[xr.Dataset, xr.Dataset]:
    rng = np.random.default_rng(0)
    size = (F01.height, F01.width)
    raw = xr.Dataset(
        {"raw": (("y", "x"), rng.integers(168, 4000, size).astype(np.uint16))},
        coords={
            "site": ["r", "gr", "gb", "b"], "black_level": ("site", [168.0] * 4), "camera_model": "F01",
            "white_level": ("site", [4095.0] * 4), "cfa_pattern": "BGGR", "capture": "A", "kind": "scene",
        },
    )  # fmt: skip
    cal = xr.Dataset(
        {
            **lattice_variables(Lattice(10.00861, 10.01028, 0.00143, 5.3, 7.1)),
            "vignetting": (("y", "x"), rng.uniform(0.2, 1, size).astype(np.float32)),
            "pixel_flags": (("y", "x"), np.zeros(size, np.uint8)),
        }
    )
    return raw, cal


def sharpness() -> dict[str, tuple[float, float]]:
    """Rms and mean relative distance of either method's samples from the simulated radiance of the views."""
    raw, truth = simulate_capture(height=700, width=700, noise=False, views=range(-3, 4))
    _, white = simulate_white(height=700, width=700, noise=False)
    inner = {"t": slice(3, -3), "s": slice(3, -3)}
    rgb = truth["rgb"].transpose("v", "u", "t", "s", "channel").isel(inner).values
    found = {}
    for method in ("nearest", "interpolated"):
        lf = demultiplex(raw, white.rename(defects="pixel_flags"), radius=3, method=method).isel(inner)
        cfa = lf["cfa"].values
        truth_of_colour = np.take_along_axis(rgb, np.minimum(cfa, 2)[..., None].astype(int), -1)[..., 0]
        error = ((lf["mosaic"].values - truth_of_colour) / truth_of_colour.mean())[cfa != 255]
        found[method] = float(np.sqrt(np.mean(error**2))), float(error.mean())
    return found


def best(function: Callable[[], object], repeats: int = 7) -> float:
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        seconds.append(time.process_time() - start)
    return min(seconds)


def main() -> None:
    raw, cal = capture()
    for radius in (4, F01.view_radius):
        lf = demultiplex(raw, cal, radius=radius)
        traffic = [a.values for a in (raw.raw, cal.vignetting, cal.pixel_flags, lf.mosaic, lf.cfa, lf.weight)]
        copied = best(lambda arrays=traffic: [array.copy() for array in arrays])
        spent = best(lambda r=radius: demultiplex(raw, cal, radius=r))
        tracemalloc.start()
        demultiplex(raw, cal, radius=radius)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        output = sum(lf[name].nbytes for name in ("mosaic", "cfa", "weight"))
        moved = best(lambda r=radius: demultiplex(raw, cal, radius=r, method="interpolated"), repeats=2)
        views = (2 * radius + 1) ** 2
        print(f"{views:4d} views: {spent:.3f} CPU s, memcpy {copied:.3f} CPU s, ratio {spent / copied:.1f}; "
              f"interpolated {moved / copied:.1f}; peak memory {peak / output:.2f} x the output of "
              f"{output / 1e6:.0f} MB")  # fmt: skip
    for method, (rms, bias) in sharpness().items():
        print(f"{method:12} {100 * rms:.2f} % rms from the radiance at (u, v), views to ±3, mean {100 * bias:+.3f} %")
    for peer, seconds in PEERS.items():
        print(f"{peer:12} {seconds:6.0f} CPU s (81 views)")


if __name__ == "__main__":
    main()
