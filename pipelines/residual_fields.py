"""Is the lens array bent? The residual field of every file named: ``python -m pipelines.residual_fields FILES... OUT``.

For each file a picture of the measured centres against their lattice, and a line that says whether a smooth bend of the
lattice is significant and what its correction leaves.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import xarray as xr

from lfflow.run.chain import CHAIN
from lfflow.schema.declarations import METHOD_FLAGS
from lfflow.stages.calibrate import calibrate
from lfflow.stages.residual_field import residual_field
from lfflow.viz.residual_field import draw_residual_field


def verdict(cal: xr.Dataset, field: xr.Dataset) -> str:
    """One sentence on a field and its correction."""
    size = float(np.sqrt((field["dx"] ** 2 + field["dy"] ** 2).mean()))
    noise = float(np.sqrt(2) * field["std"].median())
    measured = f"cells are {size:.4f} px rms off the lattice, with a noise of {noise:.4f} px"
    if int(cal["method"]) == METHOD_FLAGS["self"]:
        return f"{measured}; a scene, which moves its centres itself: not judged, no correction"
    rms, chance = float(cal["distortion_rms"]), float(cal["distortion_chance"])
    bend = f"smooth bend {rms:.4f} px rms, probability by chance {chance:.1e}"
    if not np.any(cal["distortion"]):
        return f"{measured}; {bend}: no correction"
    left = float(np.sqrt(((field["dx"] - field["bend_x"]) ** 2 + (field["dy"] - field["bend_y"]) ** 2).mean()))
    return f"{measured}; {bend}: corrected, {left:.4f} px rms left"


def main(files: list[Path], out: Path) -> list[str]:
    """Draw the field of each file into `out` and say what it shows."""
    out.mkdir(parents=True, exist_ok=True)
    lines = []
    for file in files:
        with CHAIN.open_raw(str(file)) as raw:
            cal = calibrate(raw)
            field = residual_field(raw, cal)
        draw_residual_field(field, out / f"{file.stem}.png", file.stem)
        lines.append(f"{file.stem}: {verdict(cal, field)}")
    (out / "residual_fields.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return lines


if __name__ == "__main__":
    print("\n".join(main([Path(name) for name in sys.argv[1:-1]], Path(sys.argv[-1]))))
