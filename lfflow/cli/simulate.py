"""`lfflow simulate`."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def simulate(
    out: Path,
    *,
    captures: int = 3,
    seed: int = 0,
    camera: Literal["f01", "illum"] = "f01",
    zooms: int = 1,
    focuses: int = 1,
    scene: Literal["natural", "hard"] = "natural",
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Make a white image and captures of a simulated camera, with the truth beside them.

    Parameters
    ----------
    out
        Folder for WHITE_0001.lfp, IMG_0001.lfp and on, and truth.zarr.
    captures
        Number of captures.
    seed
        Same seed, same bytes.
    camera
        Camera model.
    zooms
        Number of zoom settings that the captures take in turn, each with a white image.
    focuses
        Number of focus settings at each zoom that have a white image of their own.
    scene
        natural: detail everywhere; hard: plain surfaces, thin things before them, slanted planes.
    json_
        Print one JSON document.
    """
    from lfflow.simulate.collection import TRUTH, simulate_collection

    if captures < 0 or zooms < 1 or focuses < 1:
        sys.stderr.write("lfflow: --captures must be 0 or more, --zooms and --focuses 1 or more\n")
        return 1
    started = time.perf_counter()
    files = simulate_collection(out, captures, seed, camera, zooms=zooms, focuses=focuses, scene=scene)
    seconds = time.perf_counter() - started
    if json_:
        document = {"files": [str(file) for file in files], "truth": str(out / TRUTH), "seconds": round(seconds, 3)}
        sys.stdout.write(json.dumps(document) + "\n")
    else:
        sys.stdout.writelines(f"{path}\n" for path in [*files, out / TRUTH])
        sys.stderr.write(f"{len(files)} files in {seconds:.1f} s\n")
    return 0
