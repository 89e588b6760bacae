"""Estimated lattice against metadata (METHOD 6.2.3): ``python pipelines/rotation_study.py OUT FILE.lfp...``.

The projection from the exit pupil scales both pitches by 1 + f/Z and leaves θ and dv/dh alone: over zoom and focus θ
and dv/dh should stay constant, and dh follow the prediction.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from pathlib import Path

import pandas as pd
import xarray as xr

from lfflow.schema import lattice_of
from lfflow.stages.calibrate import calibrate

SENTINEL = 1000.0
"""Early firmware writes 10000 m for an exit pupil that it does not know: no magnification."""


def study(raws: Iterable[xr.Dataset]) -> pd.DataFrame:
    """One row a capture: estimate, prediction from `mla` and lens data, and their difference."""
    rows = []
    for raw in raws:
        cal = calibrate(raw)
        lattice = lattice_of(cal)
        given = {name: float(raw[name]) for name in raw.coords if raw[name].ndim == 0 and raw[name].dtype.kind == "f"}
        pupil = given.get("exit_pupil_offset", math.nan)
        magnification = 1 + given["mla_offset_z"] / pupil if abs(pupil) < SENTINEL else 1.0
        pitch = given["lens_pitch"] / given["pixel_pitch"] * magnification
        rows.append(
            {
                "capture": str(raw["capture"].item()) if "capture" in raw.coords else "",
                "zoom_step": given.get("zoom_step", math.nan),
                "focus_step": given.get("focus_step", math.nan),
                "dh": lattice.dh,
                "dv": lattice.dv,
                "ratio": lattice.dv / lattice.dh - 1,
                "theta": lattice.theta,
                "theta_std": float(cal["covariance"][2, 2]) ** 0.5,
                "dh_difference": lattice.dh - pitch * given["mla_scale_x"],
                "dv_difference": lattice.dv - pitch * given["mla_scale_y"],
                "theta_difference": lattice.theta - given["mla_rotation"],
            }
        )
    return pd.DataFrame(rows)


def systematic(table: pd.DataFrame) -> str:
    """What is constant over the captures and differs from the metadata by more than its spread."""
    lines = []
    for name in ("theta_difference", "dh_difference", "dv_difference"):
        mean, spread = table[name].mean(), table[name].std(ddof=0)
        verdict = "systematic" if abs(mean) > 3 * spread / math.sqrt(len(table)) + 1e-7 else "within the spread"
        lines.append(f"{name}: mean {mean:+.3e}, spread {spread:.1e}: {verdict}")
    return "\n".join(lines)


def plot(table: pd.DataFrame, path: Path) -> None:
    """Rotation and pitch of every capture against its zoom step."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.5))
    axes = figure.subplots(1, 3)
    for ax, name in zip(axes, ("theta", "dh", "ratio"), strict=True):
        ax.plot(table["zoom_step"], table[name], "o")
        ax.set(xlabel="zoom step", title=name)
    figure.tight_layout()
    figure.savefig(path)


def main(out: Path, files: list[Path]) -> str:
    """Table ``rotation.csv``, plot ``rotation.png`` and the verdict."""
    out.mkdir(parents=True, exist_ok=True)
    table = study(xr.open_dataset(file, engine="lfp") for file in files)
    table.to_csv(out / "rotation.csv", index=False)
    plot(table, out / "rotation.png")
    return f"{table.to_string(index=False)}\n{systematic(table)}\n"


if __name__ == "__main__":
    print(main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]]))
