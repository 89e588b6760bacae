"""`lfflow quicklook`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def quicklook(
    collection: Path,
    *,
    where: str = "",
    force: bool = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Draw each capture's views, EPI, disparity and error map as a PNG.

    Parameters
    ----------
    collection
        Folder of the collection; the pictures go to its folder quicklook.
    where
        Expression over the catalogue that selects captures.
    force
        Draw also what is drawn already.
    json_
        Print one JSON document.
    """
    from lfflow.cli.pictures import draw_collection

    drawn, failed = draw_collection(collection, where=where, force=force)
    if json_:
        sys.stdout.write(json.dumps({"pictures": [str(path) for path in drawn], "failed": failed}) + "\n")
    else:
        sys.stdout.writelines(f"{path}\n" for path in drawn)
    for capture, reason in failed.items():
        sys.stderr.write(f"lfflow: no picture of {capture}: {reason}\n")
    return 2 if failed else 0
