"""`lfflow benchmark`: the disparity of a folder of views against ground truth."""

from __future__ import annotations

import sys
from pathlib import Path

from lfflow.cli.options import Json, Range, ViewsFolder
from lfflow.errors import LfflowError

_TRUTHS = ("gt_disp_lowres.pfm", "gt_disp.pfm")


class NoTruthError(LfflowError):
    """No ground truth was given or found, or it does not fit the views."""


def benchmark(
    folder: ViewsFolder,
    *,
    gt: Path | None = None,
    range: Range = None,  # noqa: A002 - the option's name
    json: Json = False,
) -> int:
    """Score the disparity of a folder of views: BadPix 0.07/0.03/0.01 (%), MSE × 100, Q25, CPU seconds.

    Parameters
    ----------
    gt
        Ground truth of the central view, PFM; gt_disp_lowres.pfm in the folder when not given.
    """
    import os
    import time
    from json import dumps

    import xarray as xr

    from lfflow.formats.pfm import read_pfm
    from lfflow.formats.views import open_views
    from lfflow.stages.scores import scores
    from lfflow.stages.view_matching import disparity_of_views

    truth = read_pfm(gt or _truth_in(folder))
    views = open_views(folder).chunk(v=1).load()  # decoded on all cores
    expected = (views.sizes["t"], views.sizes["s"])
    if truth.shape != expected:
        raise NoTruthError(
            f"{gt or folder}: ground truth of shape {truth.shape}, expected that of the views {expected}"
        )
    start = time.process_time()
    found = disparity_of_views(views, disparity_range=range, threads=os.cpu_count() or 1)
    seconds = time.process_time() - start
    result = {**scores(found["disparity"], xr.DataArray(truth, dims=("t", "s"))), "seconds": seconds}
    sys.stdout.write(
        dumps(result) + "\n" if json else "".join(f"{key:12} {value:9.3f}\n" for key, value in result.items())
    )
    return 0


def _truth_in(folder: Path) -> Path:
    for name in _TRUTHS:
        if (folder / name).is_file():
            return folder / name
    raise NoTruthError(f"{folder}: found no {' or '.join(_TRUTHS)}; give --gt")
