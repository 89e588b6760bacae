"""The command that checks a collection for damage."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Annotated

from cyclopts import Parameter


def validate(
    collection: str,
    *,
    mark: bool = True,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Check a collection against its ledger, checksums and schema. Exit code 3 when something is damaged.

    Parameters
    ----------
    collection
        Folder or URL of the collection.
    mark
        Call what is damaged no longer finished, so that the next run makes it anew.
    json_
        Print one JSON document.
    """
    from lfflow.collection import open_collection
    from lfflow.collection.validate import validate as check

    found = check(open_collection(collection), mark=mark)
    if json_:
        sys.stdout.write(json.dumps({"damaged": [asdict(finding) for finding in found]}, indent=1) + "\n")
    else:
        lines = [f"{finding.what} {finding.capture}: {finding.reason}" for finding in found]
        sys.stdout.write("\n".join([*lines, f"{len(found)} findings"]) + "\n")
    return 3 if found else 0
