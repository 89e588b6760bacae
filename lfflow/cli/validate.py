"""The command that checks a collection for damage."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

from lfflow.cli.options import Json, Stored


def validate(collection: Stored, *, mark: bool = True, json_: Json = False) -> int:
    """Check a collection against its ledger, checksums and schema. Exit code 3 when something is damaged.

    Parameters
    ----------
    mark
        Call what is damaged no longer finished, so that the next run makes it anew.
    """
    from lfflow.cli.table import lines
    from lfflow.collection import open_collection
    from lfflow.collection.validate import validate as check

    found = check(open_collection(collection), mark=mark)
    if json_:
        sys.stdout.write(json.dumps({"damaged": [asdict(finding) for finding in found]}, indent=1) + "\n")
    else:
        text = lines((finding.what, finding.capture or "-", finding.reason) for finding in found)
        repair = "; the next run makes it anew" if mark else ""
        text.append(f"{len(found)} findings{repair}" if found else "everything is whole")
        sys.stdout.write("\n".join(text) + "\n")
    return 3 if found else 0
