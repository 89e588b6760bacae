"""The command that says how far a collection is."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Any

from cyclopts import Parameter


def status(
    collection: str,
    *,
    failed: bool = False,
    why: str = "",
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Say what is done, what failed, and why.

    Parameters
    ----------
    collection
        Folder or URL of the collection.
    failed
        List the captures that failed and the reasons, and nothing else.
    why
        Explain one capture: its stages, the white image chosen for it, and the others that were near.
    json_
        Print one JSON document.
    """
    from lfflow.collection import open_collection

    opened = open_collection(collection)
    if why:
        document: dict[str, Any] = opened.explain(why)
        lines = [f"{name}: {value}" for name, value in document.items() if not isinstance(value, list | dict)]
        lines += [f"white image: {text}" for text in document["candidates"]]
        lines += [f"{name}: {state}" for name, state in document["stages"].items()]
    else:
        document = opened.status()
        lines = [f"{capture}: {reason}" for capture, reason in document["failed"].items()]
        if failed:
            document = {"failed": document["failed"]}
        else:
            counts = ", ".join(f"{number} {kind}" for kind, number in document["kinds"].items())
            lines.insert(0, f"{document['files']} files: {counts}")
            lines[1:1] = [f"{stage}: {_counts(states)}" for stage, states in document["stages"].items()]
    text = json.dumps(document, indent=1) if json_ else "\n".join(lines)
    sys.stdout.write(text + "\n" if text else "")
    return 0


def _counts(states: dict[str, int]) -> str:
    return ", ".join(f"{number} {state}" for state, number in states.items()) or "nothing"
