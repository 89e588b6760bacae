"""The command that writes captures for other programs and for people."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from lfflow.cli.options import Json, Stored, Where

Format = Literal["views", "eslf", "toolbox", "pfm", "png16", "focal-stack", "gif", "webp", "ply"]


def export(
    collection: Stored,
    *,
    format_: Annotated[Format, Parameter(name="--format")],
    out: Path,
    where: Where = "",
    camera: str | None = None,
    scale: float = 1.0,
    bits: Literal[8, 16] = 8,
    planes: int = 9,
    linear: bool = False,
    focus_distance: float | None = None,
    json_: Json = False,
) -> int:
    """Write views, disparities and pictures in formats of other programs.

    Exit code 2 when some captures failed.

    Parameters
    ----------
    format_
        views: a PNG folder as HCI names it; eslf: a lenslet picture; toolbox: LFToolbox's .mat; pfm, png16: disparity
        of the central view; focal-stack: TIFF; gif, webp: a looping parallax; ply: coloured points.
    out
        Folder to write to.
    camera
        Camera model, when the collection holds several.
    scale
        Places of the square grid per lens pitch; more than 1 is super-resolution.
    bits
        Bits of the pictures.
    planes
        Planes of a focal stack, spread over the disparities of the capture.
    linear
        Linear camera colours in views, eslf and toolbox, instead of colours for people.
    focus_distance
        Metres at which the camera was focused: ply gets metres. Metadata hold motor steps only.
    """
    from lfflow.collection import open_collection
    from lfflow.errors import LfflowError
    from lfflow.viz.export import Options, export_capture

    col = open_collection(collection)
    wanted = set(col.query(where))
    lf, disp = col.open("lightfield", camera=camera), col.open("disparity", camera=camera)
    done = [str(name) for name in disp["capture"].values if str(name) in wanted and name in lf["capture"].values]
    options = Options(scale, bits, planes, not linear, focus_distance)
    written: dict[str, str] = {}
    failed: dict[str, str] = {}
    for name in done:
        try:
            one = lf.sel(capture=name), disp.sel(capture=name)
            written[name] = str(export_capture(*one, format_, out, name, options))
        except (LfflowError, OSError, ValueError) as error:
            failed[name] = str(error)
            sys.stderr.write(f"lfflow: {name}: {error}\n")
    text = "".join(f"{path}\n" for path in written.values())
    sys.stdout.write(json.dumps({"written": written, "failed": failed}) + "\n" if json_ else text)
    if not done:
        sys.stderr.write("lfflow: no finished capture to export\n")
    return 2 if failed else 0
