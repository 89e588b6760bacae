"""Options that several commands share: each is described once, here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

Json = Annotated[bool, Parameter(name="--json", negative="", help="Print one JSON document.")]
Stored = Annotated[str, Parameter(help="Folder of the collection, or an fsspec URL such as s3://bucket/collection.")]
Inputs = Annotated[
    str,
    Parameter(
        help="Files, folders, calibration archives (data.C.0, caldata-*.tar) and quoted globs, also with **; without "
        "any, the files that the collection knows already."
    ),
]
Out = Annotated[str, Parameter(help="Folder or fsspec URL of the collection; made when it is not there.")]
Config = Annotated[Path | None, Parameter(help="TOML file with a table of keyword arguments per stage.")]
White = Annotated[
    list[str] | None,
    Parameter(
        consume_multiple=True, negative="", help="Files that are white images, whatever their metadata and content say."
    ),
]
Dark = Annotated[
    list[str] | None,
    Parameter(
        consume_multiple=True, negative="", help="Files that are dark images, whatever their metadata and content say."
    ),
]
Where = Annotated[
    str,
    Parameter(help="Expression over the catalogue that selects captures, such as \"iso < 200 and kind == 'scene'\"."),
]
Stages = Annotated[
    list[str] | None,
    Parameter(
        consume_multiple=True,
        negative="",
        help="Stages to work on: calibration, lightfield, disparity; all by default.",
    ),
]
WorkersOption = Annotated[
    str | None,
    Parameter(
        name="--workers",
        help="threads:N, processes:N, or the address of a dask scheduler (tcp://… or tls://…); a thread per core by "
        "default.",
    ),
]
Memory = Annotated[
    str | None,
    Parameter(help="Memory that the tasks together may use, such as 4GiB; what the machine has free by default."),
]
AcceptDamaged = Annotated[
    bool, Parameter(help="Take files whose checksums are wrong, and record that they are.", negative="")
]
ViewsFolder = Annotated[
    Path, Parameter(help="Folder of view images (input_Cam000.png … of a 9×9 grid, row by row; some may be missing).")
]
Range = Annotated[
    tuple[float, float] | None,
    Parameter(name="--range", help="Smallest and largest disparity; found from the views when not given."),
]
