"""The command that lists captures."""

from __future__ import annotations

import sys
from typing import Annotated

from cyclopts import Parameter


def query(
    collection: str,
    expression: str = "",
    *,
    sql: bool = False,
    columns: str = "",
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """List the captures of a collection for which an expression holds, such as "iso < 200 and focus_step > 500".

    Parameters
    ----------
    collection
        Folder or URL of the collection.
    expression
        Expression over the catalogue's columns; none lists all captures.
    sql
        The expression is an SQL query over the table `catalogue` (needs duckdb).
    columns
        Columns to print beside the id, separated by commas; "all" for all.
    json_
        Print one JSON document with a row per capture.
    """
    from lfflow.collection import open_collection
    from lfflow.errors import CollectionError

    opened = open_collection(collection)
    table = opened.sql(expression) if sql else opened.table(expression)
    names = [name for name in columns.split(",") if name]
    unknown = [name for name in names if name not in table.columns and name != "all"]
    if unknown:
        raise CollectionError(f"no column {', '.join(unknown)}; there are {', '.join(map(str, table.columns))}")
    everything = json_ or sql or names == ["all"]
    shown = table if everything else table[["id", *(name for name in names if name != "id")]]
    if json_:
        sys.stdout.write(shown.to_json(orient="records", date_format="iso", indent=1) + "\n")
    else:
        sys.stdout.write(shown.to_csv(sep="\t", index=False, header=len(shown.columns) > 1))
    return 0
