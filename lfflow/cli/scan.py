"""The command that reads captures into the catalogue."""

from __future__ import annotations

import json
import sys

from lfflow.cli.options import AcceptDamaged, Config, Dark, Inputs, Json, Out, White


def scan(
    *inputs: Inputs,
    out: Out,
    config: Config = None,
    white: White = None,
    dark: Dark = None,
    accept_damaged: AcceptDamaged = False,
    json_: Json = False,
) -> int:
    """Read captures into the catalogue of a collection, and nothing more. Exit code 2 when some cannot be read."""
    from lfflow.cli.table import lines
    from lfflow.run import scan_collection
    from lfflow.run.request import options_from

    options = options_from(inputs, config=config, white=white, dark=dark, accept_damaged=accept_damaged)
    table = scan_collection(out, options)
    broken = table[table["reason"] != ""]
    failed = {str(row["id"]): str(row["reason"]) for _, row in broken.iterrows()}
    kinds = {str(kind) or "unreadable": int(number) for kind, number in table["kind"].value_counts().items()}
    duplicates, missing = int((table["duplicate_of"] != "").sum()), int(table["missing"].sum())
    if json_:
        document = {"files": len(table), "kinds": kinds, "duplicates": duplicates, "missing": missing, "failed": failed}
        sys.stdout.write(json.dumps(document, indent=1) + "\n")
        return 2 if failed else 0
    counts = ", ".join(f"{number} {kind}" for kind, number in kinds.items()) or "nothing"
    text = [*lines(failed.items()), f"{len(table)} files, {len(failed)} cannot be read: {counts}"]
    text += [f"{duplicates} are copies of others"] if duplicates else []
    text += [f"{missing} have results, but are gone or out of reach"] if missing else []
    sys.stdout.write("\n".join(text) + "\n")
    return 2 if failed else 0
