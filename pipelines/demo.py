"""The whole chain on simulated captures, scored against the truth; or on a person's own files, without a score.

``python -m pipelines.demo FOLDER [--input DIR]``
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import cyclopts
import numpy as np
import xarray as xr

from lfflow.cli.report import report
from lfflow.collection import open_collection
from lfflow.collection.collection import Collection
from lfflow.conventions import CFA_NONE
from lfflow.run import Options, run_collection
from lfflow.schema import lattice_of
from lfflow.simulate.collection import TRUTH, open_truth, simulate_collection

NEAR = 0.1
"""Disparity error, lens pitches per view step, that counts as right."""


def demo(
    folder: Path,
    *,
    input: Path | None = None,  # noqa: A002 - the name of the option
    captures: int = 3,
    seed: int = 0,
    size: int | None = None,
) -> int:
    """Simulate a collection, or take one; run the chain; say what was made and how good it is.

    Parameters
    ----------
    folder
        Takes the simulated files (input) and the collection.
    input
        Captures of one's own, instead of simulated ones.
    captures, seed
        Of the simulation.
    size
        Side of the simulated sensor, pixels; that of the F01 by default.
    """
    started = time.perf_counter()
    files = input or folder / "input"
    if input is None:
        made = simulate_collection(files, captures, seed, height=size, width=size)
        print(f"simulated {len(made)} files in {time.perf_counter() - started:.1f} s: {files}")
    where = folder / "collection"
    started = time.perf_counter()
    outcome = run_collection(where, Options(inputs=[str(files)]))
    done, kept = outcome.counts.get("done", 0), outcome.counts.get("kept", 0)
    print(
        f"ran the chain in {time.perf_counter() - started:.1f} s: {done} results made, {kept} kept, "
        f"peak memory {peak_memory():.2f} GiB"
    )
    for capture, reason in outcome.failed.items():
        print(f"  failed: {capture}: {reason}")
    collection = open_collection(where)
    if (files / TRUTH).is_dir():
        print_lattices(collection, files)
        print_disparities(collection, files)
    print("pictures and page:")
    report(where)
    for picture in sorted((where / "quicklook").glob("*.png")):
        print(picture)
    print(f"collection: {where}")
    return outcome.exit_code


def peak_memory() -> float:
    """Largest memory that this process has held so far, GiB."""
    unit = 1 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / (1 << 30)


def print_lattices(collection: Collection, files: Path) -> None:
    """Distance of every measured lattice from the true one."""
    print("lattice error, rms over all lenses:")
    for group in collection.store("calibration").groups():
        found = collection.open("calibration", camera=group)
        height, width = found.sizes["y"], found.sizes["x"]
        for name in found["capture"].values:
            truth = lattice_of(open_truth(files, str(name)))
            error = truth.distance_to(lattice_of(found.sel(capture=name)), height, width)
            print(f"  {name}: {error:.5f} px")


def print_disparities(collection: Collection, files: Path) -> None:
    """Agreement of the central views' disparity with the truth, over all lenses that lie on the sensor."""
    print(f"disparity of the central view (all lenses on the sensor; none found counts as wrong at {NEAR}):")
    for group in collection.store("disparity").groups():
        disparity = collection.open("disparity", camera=group).sel(u=0, v=0)
        lightfield = collection.open("lightfield", camera=group).sel(u=0, v=0)
        for name in disparity["capture"].values:
            error, known = disparity_error(
                disparity.sel(capture=name), lightfield.sel(capture=name), open_truth(files, str(name))
            )
            right = np.mean(known & (np.abs(np.nan_to_num(error)) <= NEAR))
            print(
                f"  {name}: {100 * right:.1f} % within {NEAR}, "
                f"median error {np.median(np.abs(error[known])):.4f}, found at {100 * known.mean():.1f} %"
            )


def disparity_error(disparity: xr.Dataset, lightfield: xr.Dataset, truth: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Error of the central disparity at the lenses on the sensor, and where there is an estimate; both 1-D.

    Every lens is compared with the true lens nearest to it, whatever the two grids' numbering.
    """
    found, true = lattice_of(lightfield), lattice_of(truth)
    t, s = np.meshgrid(disparity["t"].values, disparity["s"].values, indexing="ij")
    true_t, true_s = true.nearest(*found.centres(t, s))
    rows, columns = truth.sizes["t"], truth.sizes["s"]
    on_sensor = lightfield["cfa"].transpose("t", "s").values != CFA_NONE
    on_sensor &= (true_t >= 0) & (true_t < rows) & (true_s >= 0) & (true_s < columns)
    values = disparity["disparity"].transpose("t", "s").values[on_sensor]
    expected = truth["disparity"].sel(v=0, u=0).transpose("t", "s").values[true_t[on_sensor], true_s[on_sensor]]
    error = values - expected
    return error, np.isfinite(error)


if __name__ == "__main__":
    app = cyclopts.App(name="demo", help=__doc__, result_action="return_value")
    app.default(demo)
    sys.exit(app())
