"""The command that says how far a collection is."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Any

from cyclopts import Parameter

from lfflow.cli.options import Json, Stored
from lfflow.cli.table import lines

_STATES = ("done", "pending", "failed", "unreadable", "duplicate")


def status(
    collection: Stored,
    *,
    failed: Annotated[bool, Parameter(negative="")] = False,
    why: str = "",
    json_: Json = False,
) -> int:
    """Say what is done, what failed, and why.

    Parameters
    ----------
    failed
        List the captures that failed and the reasons, and nothing else.
    why
        Explain one capture: its file, its kind, its stages, the white image chosen for it, and the others that were
        near.
    """
    from lfflow.collection import open_collection

    opened = open_collection(collection)
    if why:
        document: dict[str, Any] = opened.explain(why)
        text = _explained(document)
    else:
        document = opened.status()
        if failed:
            document = {"failed": document["failed"]}
            text = lines(document["failed"].items())
        else:
            text = [*_counted(document), *_listed("failed", document["failed"])]
            text += _listed("taken although damaged", document["damaged"])
    output = [json.dumps(document, indent=1)] if json_ else text
    sys.stdout.write("".join(f"{line}\n" for line in output))
    return 0


def _counted(document: dict[str, Any]) -> list[str]:
    counts = ", ".join(f"{number} {kind}" for kind, number in document["kinds"].items())
    first = f"{document['collection']}: {document['files']} files" + (f" ({counts})" if counts else "")
    states = [state for state in _STATES if any(state in found for found in document["stages"].values())]
    rows = [[stage, *(found.get(state, "") for state in states)] for stage, found in document["stages"].items()]
    return [first, "", *lines(rows, header=["stage", *states])] if states else [first]


def _listed(title: str, reasons: dict[str, str]) -> list[str]:
    return ["", title, *(f"  {line}" for line in lines(reasons.items()))] if reasons else []


def _explained(document: dict[str, Any]) -> list[str]:
    facts = {name: value for name, value in document.items() if not isinstance(value, list | dict) and value != ""}
    text = lines((name.replace("_", " "), value) for name, value in facts.items())
    text += ["", *lines(document["stages"].items(), header=["stage", "state"])] if document["stages"] else []
    text += _listed("made of damaged files", document["damaged"])
    if document["candidates"]:
        text += ["", "white images of this camera, nearest first", *(f"  {each}" for each in document["candidates"])]
    return text
