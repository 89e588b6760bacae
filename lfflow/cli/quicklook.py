"""The command that draws the captures of a collection."""

from __future__ import annotations

import json
import sys
from typing import Annotated

from cyclopts import Parameter

from lfflow.cli.options import Json, Stored, Where


def quicklook(
    collection: Stored,
    *,
    where: Where = "",
    force: Annotated[bool, Parameter(negative="")] = False,
    json_: Json = False,
) -> int:
    """Draw each capture's views, EPI, disparity and error map as a PNG in the collection's folder quicklook.

    Parameters
    ----------
    force
        Draw also what is drawn already.
    """
    from lfflow.collection import open_collection
    from lfflow.run.pictures import draw_missing, picture_name

    opened = open_collection(collection)
    drawn, failed = draw_missing(opened, where=where, force=force)
    paths = [f"{opened.storage.url}/{picture_name(capture)}" for capture in drawn]
    text = "".join(f"{path}\n" for path in paths)
    sys.stdout.write(json.dumps({"pictures": paths, "failed": failed}) + "\n" if json_ else text)
    for capture, reason in failed.items():
        sys.stderr.write(f"lfflow: no picture of {capture}: {reason}\n")
    return 2 if failed else 0
