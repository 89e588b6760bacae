"""The command that lists captures."""

from __future__ import annotations

import sys
from typing import Annotated

from cyclopts import Parameter

from lfflow.cli.options import Json, Stored


def query(
    collection: Stored,
    expression: str = "",
    *,
    sql: Annotated[bool, Parameter(negative="")] = False,
    columns: str = "",
    json_: Json = False,
) -> int:
    """List the captures of a collection for which an expression holds, such as "iso < 200 and focus_step > 500".

    Parameters
    ----------
    expression
        Expression over the catalogue's columns (comparisons, and, or, not, in, column.str.contains("…"),
        column.isna()); none lists all captures.
    sql
        The expression is an SQL query over the table `catalogue` (needs duckdb).
    columns
        Columns to print beside the id, separated by commas; "all" for all.
    """
    from lfflow.collection import open_collection
    from lfflow.collection.query import check_columns

    opened = open_collection(collection)
    table = opened.sql(expression) if sql else opened.table(expression)
    names = [name.strip() for name in columns.split(",") if name.strip()]
    if names != ["all"]:
        check_columns(names, [str(name) for name in table.columns])
    everything = (json_ and not names) or (sql and not names) or names == ["all"]
    shown = table if everything else table[["id", *(name for name in names if name != "id")]]
    if json_:
        sys.stdout.write(shown.to_json(orient="records", date_format="iso", indent=1) + "\n")
    else:
        sys.stdout.write(shown.to_csv(sep="\t", index=False, header=len(shown.columns) > 1))
    return 0
