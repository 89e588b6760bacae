"""The command that reads captures into the catalogue."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def scan(
    *inputs: str,
    out: str,
    config: Path | None = None,
    white: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    dark: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Read captures into the catalogue of a collection, and nothing more. Exit code 2 when some cannot be read.

    Parameters
    ----------
    inputs
        Files, folders and globs; without any, the files that the collection knows already.
    out
        Folder or fsspec URL of the collection.
    config
        TOML file; its table [whites] governs the choice of white images.
    white
        Files that are white images, whatever their metadata say.
    dark
        Files that are dark images, whatever their metadata say.
    json_
        Print one JSON document.
    """
    from lfflow.run import scan_collection
    from lfflow.run.request import options_from

    table = scan_collection(out, options_from(inputs, config=config, white=white, dark=dark))
    broken = table[table["reason"] != ""]
    failed = {str(row["id"]): str(row["reason"]) for _, row in broken.iterrows()}
    if json_:
        sys.stdout.write(json.dumps({"files": len(table), "failed": failed}, indent=1) + "\n")
    else:
        lines = [f"{name}: {reason}" for name, reason in failed.items()]
        sys.stdout.write("\n".join([*lines, f"{len(table)} files, {len(failed)} cannot be read"]) + "\n")
    return 2 if failed else 0
