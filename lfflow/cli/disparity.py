"""`lfflow disparity`: the disparity of the central view of a folder of views."""

from __future__ import annotations

import sys
from pathlib import Path

from lfflow.cli.options import Json, Range, ViewsFolder


def disparity(
    folder: ViewsFolder,
    *,
    out: Path,
    range: Range = None,  # noqa: A002 - the option's name
    json: Json = False,
) -> int:
    """Estimate the disparity of the central view of a folder of views.

    Parameters
    ----------
    out
        PFM file to write, pixels per view step.
    """
    import os
    import time
    from json import dumps

    import numpy as np

    from lfflow.formats.pfm import write_pfm
    from lfflow.formats.views import open_views
    from lfflow.stages.view_matching import disparity_of_views

    views = open_views(folder).chunk(v=1).load()  # decoded on all cores
    start = time.process_time()
    found = disparity_of_views(views, disparity_range=range, threads=os.cpu_count() or 1)
    seconds = time.process_time() - start
    values = found["disparity"].transpose("t", "s").to_numpy()
    write_pfm(out, values)
    result = {
        "out": str(out),
        "rows": values.shape[0],
        "columns": values.shape[1],
        "smallest": float(np.nanmin(values)),
        "largest": float(np.nanmax(values)),
        "seconds": seconds,
    }
    sys.stdout.write(dumps(result) + "\n" if json else "".join(f"{key:10} {value}\n" for key, value in result.items()))
    return 0
