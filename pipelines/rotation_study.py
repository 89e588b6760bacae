"""Estimated lattices against metadata (METHOD 6.2.3): ``python -m pipelines.rotation_study COLLECTION_OR_FILES OUT``.

Takes a collection (its calibrations as they are stored) or files and folders (which it calibrates). The projection from
the exit pupil scales both pitches by 1 + f/Z and leaves θ and dv/dh alone: over zoom and focus θ and dv/dh should be
constant, and dh, dv and C follow the prediction. Writes ``lattices.csv``, ``lattices.png`` and ``systematic.txt``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pandas as pd
import xarray as xr

from lfflow.collection import open_collection
from lfflow.collection.catalogue import FILE
from lfflow.lattice import Lattice
from lfflow.run.chain import CHAIN
from lfflow.schema import lattice_of
from lfflow.schema.declarations import METHOD_FLAGS
from lfflow.stages.calibrate import calibrate
from pipelines import lattice_systematics
from pipelines.lattice_prediction import Prediction, implied_pupil, off_centre, predict

Pair = tuple[xr.Dataset, xr.Dataset]


def pairs(inputs: Iterable[str]) -> Iterator[Pair]:
    """Raw frame (for its metadata) and calibration of everything named."""
    for item in inputs:
        if (Path(item) / FILE).exists():
            yield from stored(item)
            continue
        path = Path(item)
        files = sorted(p for p in path.rglob("*") if p.suffix.lower() in (".lfp", ".lfr")) if path.is_dir() else [path]
        for file in files:
            with CHAIN.open_raw(str(file)) as raw:
                yield raw, calibrate(raw)


def stored(where: str) -> Iterator[Pair]:
    """Pairs of a collection: every calibration that it holds."""
    collection = open_collection(where)
    paths = collection.catalogue_rows().set_index("id")["path"]
    for group in collection.store("calibration").groups():
        calibrations = collection.open("calibration", camera=group, chunks=None)
        for name in calibrations["capture"].values:
            with CHAIN.open_raw(paths[name]) as raw:
                yield raw, calibrations.sel(capture=name)


def study(found: Iterable[Pair]) -> pd.DataFrame:
    """One row a lattice: measured, predicted from `mla` and lens data, and their difference."""
    return pd.DataFrame([row(raw, cal) for raw, cal in found])


def row(raw: xr.Dataset, cal: xr.Dataset) -> dict[str, float | str]:
    """Numbers of one lattice."""
    lattice, told = lattice_of(cal), predict(raw)
    expected = told.lattice
    deviation = dict(zip(("dh", "dv", "theta"), (float(cal["covariance"][i, i]) ** 0.5 for i in range(3)), strict=True))
    ratio, off = lattice.dv / lattice.dh - 1, off_centre(lattice, expected)
    return {
        "capture": str(cal["capture"].item()) if "capture" in cal.coords else "",
        "method": next(name for name, flag in METHOD_FLAGS.items() if flag == int(cal["method"])),
        "width": raw.sizes["x"],
        **{name: _given(raw, name) for name in ("zoom_step", "focus_step", "focal_length", "temperature")},
        "exit_pupil_offset": told.pupil,
        "gap": told.gap,
        "bare_pitch": expected.dh / told.magnification,
        "dh": lattice.dh,
        "dv": lattice.dv,
        "ratio": ratio,
        "theta": lattice.theta,
        **{f"{name}_std": value for name, value in deviation.items()},
        "ratio_std": math.hypot(deviation["dh"], deviation["dv"]) / lattice.dh,
        "predicted_dh": expected.dh,
        "predicted_dv": expected.dv,
        "predicted_ratio": expected.dv / expected.dh - 1,
        "predicted_theta": expected.theta,
        "dh_difference": lattice.dh - expected.dh,
        "dv_difference": lattice.dv - expected.dv,
        "ratio_difference": ratio - (expected.dv / expected.dh - 1),
        "theta_difference": lattice.theta - expected.theta,
        "cx_difference": off[0],
        "cy_difference": off[1],
        "implied_pupil": implied_pupil(lattice.dh, told.gap, told.magnification, expected.dh),
        **_signs(lattice, told, raw),
    }


def _given(raw: xr.Dataset, name: str) -> float:
    return float(raw[name]) if name in raw.coords else math.nan


def _signs(lattice: Lattice, told: Prediction, raw: xr.Dataset) -> dict[str, float]:
    """Distance from the nearest lens of the array's middle under each sign of its offset."""
    middle = (raw.sizes["x"] - 1) / 2, (raw.sizes["y"] - 1) / 2
    offset = told.lattice.cx - middle[0], told.lattice.cy - middle[1]
    found = {}
    for signs, (x, y) in {"++": (1, 1), "+-": (1, -1), "-+": (-1, 1), "--": (-1, -1)}.items():
        place = replace(told.lattice, cx=middle[0] + x * offset[0], cy=middle[1] + y * offset[1])
        found[f"off{signs}"] = math.hypot(*off_centre(lattice, place))
    return found


def main(inputs: list[str], out: Path) -> str:
    """Study everything named; returns the table and what is systematic, which are also written to `out`."""
    table = study(pairs(inputs)).sort_values(["zoom_step", "focus_step", "capture"], ignore_index=True)
    lines = [*lattice_systematics.statements(table), lattice_systematics.convention(table)]
    out.mkdir(parents=True, exist_ok=True)
    table.to_csv(out / "lattices.csv", index=False)
    (out / "systematic.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lattice_systematics.plot(table, str(out / "lattices.png"))
    shown = ["capture", "zoom_step", "focus_step", "dh", "dh_difference", "dv_difference", "ratio_difference", "theta",
             "theta_difference", "cx_difference", "cy_difference"]  # fmt: skip
    return table[shown].to_string(index=False) + "\n\n" + "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(main(sys.argv[1:-1], Path(sys.argv[-1])))
