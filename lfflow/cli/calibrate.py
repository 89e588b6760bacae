"""``lfflow calibrate FILE``: the lattice of one picture."""

from __future__ import annotations

import json as jsonlib
import sys
from pathlib import Path


def calibrate(file: Path, *, json: bool = False) -> int:
    """Find the microlens lattice of one picture.

    Parameters
    ----------
    file
        A raw capture (.lfp, .lfr): a white image, or any picture.
    json
        Print one JSON document.
    """
    import xarray as xr

    from lfflow.schema.declarations import METHOD_FLAGS
    from lfflow.stages.calibrate import calibrate as calibrate_stage

    with xr.open_dataset(file, engine="lfp") as raw:
        found = calibrate_stage(raw)
        names = {code: name for name, code in METHOD_FLAGS.items()}
        numbers = {name: float(found[name]) for name in ("dh", "dv", "theta", "cx", "cy")}
        result: dict[str, float | int | str] = {
            **numbers,
            "lenses": int(found["lens_count"]),
            "rms_px": float(found["residual_rms"]),
            "method": names[int(found["method"])],
        }
    if json:
        sys.stdout.write(jsonlib.dumps(result) + "\n")
    else:
        units = {"theta": " rad", "lenses": "", "method": ""}
        for name, value in result.items():
            shown = f"{value:.6f}" if isinstance(value, float) else str(value)
            sys.stdout.write(f"{name:<7} {shown}{units.get(name, ' px')}\n")
    return 0
