"""The command that brings the stores of a collection to the present schema."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

from lfflow.cli.options import Json, Stored


def migrate(collection: Stored, *, json_: Json = False) -> int:
    """Bring the stores of a collection to the schema that this lfflow writes; what is finished stays so."""
    from lfflow.cli.table import lines
    from lfflow.collection import open_collection
    from lfflow.collection.leases import run_lease
    from lfflow.collection.migrate import migrate as migrate_stores

    opened = open_collection(collection)
    with run_lease(opened.storage):
        done = migrate_stores(opened)
    if json_:
        sys.stdout.write(json.dumps({"migrated": [asdict(each) for each in done]}, indent=1) + "\n")
        return 0
    rows = [[m.store, m.group, f"{m.before} → {m.after}", f"{m.captures} captures", "; ".join(m.what)] for m in done]
    sys.stdout.write("\n".join(lines(rows) or ["every store has the present schema"]) + "\n")
    return 0
