"""Expressions over the catalogue: pandas' own language, of which only what compares columns is let through.

An expression may come from a web form or a colleague's script, so nothing in it can call, import or reach further than
the columns: names are columns, attributes are the string, date and comparison methods listed here.
"""

from __future__ import annotations

import ast
import difflib

import pandas as pd

from lfflow.errors import CollectionError

_METHODS = frozenset({"isin", "between", "isna", "notna", "abs", "round", "clip"})
_STRING_METHODS = frozenset(
    {"contains", "startswith", "endswith", "match", "fullmatch", "lower", "upper", "len", "strip"}
)
_DATE_PARTS = frozenset({"year", "month", "day", "hour", "minute", "second", "dayofyear", "dayofweek", "date"})
_NODES = (
    ast.Expression, ast.BoolOp, ast.BinOp, ast.UnaryOp, ast.Compare, ast.Name, ast.Load, ast.Constant, ast.List,
    ast.Tuple, ast.Call, ast.keyword, ast.Attribute, ast.boolop, ast.unaryop, ast.cmpop, ast.Add, ast.Sub, ast.Mult,
    ast.Div, ast.FloorDiv, ast.Mod, ast.BitAnd, ast.BitOr, ast.BitXor,
)  # fmt: skip
_ACCESSORS = {"str": _STRING_METHODS, "dt": _DATE_PARTS}
_LONGEST = 10_000


def select(table: pd.DataFrame, expression: str) -> pd.DataFrame:
    """Rows for which a pandas expression holds, such as ``iso < 200 and kind == 'scene'``; all for an empty one.

    Raises
    ------
    CollectionError
        For an expression that is none, that names what is no column (near names are suggested), that does more than
        compare columns, or that says neither yes nor no.
    """
    if not expression.strip():
        return table
    _check(expression, [str(name) for name in table.columns])
    try:
        chosen = table.eval(expression.strip(), engine="python", local_dict={}, global_dict={})
    except Exception as error:
        raise CollectionError(f"cannot evaluate {expression!r}: {error}") from error
    if not isinstance(chosen, pd.Series) or chosen.dtype != bool:
        raise CollectionError(f"{expression!r} is no condition; write it like \"iso < 200 and kind == 'scene'\"")
    return table[chosen].reset_index(drop=True)


def check_columns(names: list[str], columns: list[str]) -> None:
    """Raise CollectionError that suggests near names where a name is no column."""
    unknown = [name for name in names if name not in columns]
    if unknown:
        near = [match for name in unknown for match in difflib.get_close_matches(name, columns, 3, 0.5)]
        meant = f"did you mean {' or '.join(dict.fromkeys(near))}?" if near else f"there are {', '.join(columns)}"
        raise CollectionError(f"no column {', '.join(unknown)}; {meant}")


def _check(expression: str, columns: list[str]) -> None:
    if len(expression) > _LONGEST:
        raise CollectionError(f"an expression of {len(expression)} letters; expected at most {_LONGEST}")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        hint = " (write == to compare)" if "==" not in expression and "=" in expression else ""
        raise CollectionError(f"cannot read {expression!r}: {getattr(error, 'msg', error)}{hint}") from error
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    names = []
    for node in ast.walk(tree):
        if not isinstance(node, _NODES):
            raise CollectionError(f"{expression!r}: found {type(node).__name__}, expected comparisons of columns")
        if isinstance(node, ast.Call) and not isinstance(node.func, ast.Attribute):
            raise CollectionError(f"{expression!r}: functions are not called here")
        if isinstance(node, ast.Attribute):
            _check_attribute(expression, node, called)
        if isinstance(node, ast.Name):
            names.append(node.id)
    check_columns(names, columns)


def _check_attribute(expression: str, node: ast.Attribute, called: set[int]) -> None:
    """Allow ``column.isin(…)``, ``column.str.contains(…)``, ``column.dt.year``, and nothing else."""
    inner = node.value
    if isinstance(inner, ast.Attribute) and inner.attr in _ACCESSORS:
        allowed = node.attr in _ACCESSORS[inner.attr]
    else:
        allowed = node.attr in _METHODS if id(node) in called else node.attr in _ACCESSORS
    if not allowed:
        listed = ", ".join(sorted(_METHODS | {f"str.{name}" for name in _STRING_METHODS} | {"dt.year", "…"}))
        raise CollectionError(f"{expression!r}: .{node.attr} is not used here; there are {listed}")
