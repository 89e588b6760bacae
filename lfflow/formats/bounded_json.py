"""JSON from strangers: bounded in size and depth, objects only, every fault one `MetadataError`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lfflow.formats.errors import LimitError, MetadataError

MAX_JSON_BYTES = 4 << 20
"""Largest JSON text that is parsed; real ones are below 100 kB. Parsed it takes at most about thirty times as much."""
MAX_JSON_DEPTH = 64

Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Document:
    """A JSON object and the very text it was written as."""

    text: str
    value: Json

    @classmethod
    def of(cls, value: Any) -> Document:
        """Document of an object that is a part of another document; anything else counts as empty."""
        return cls(json.dumps(value), value) if isinstance(value, dict) else EMPTY


EMPTY = Document("{}", {})


def parse_json(data: bytes, path: str, where: str) -> Document:
    """Document written in `data` (UTF-8, zero padding allowed).

    Raises
    ------
    LimitError
        If the text is longer or deeper than any real one.
    MetadataError
        If it is no JSON object.
    """
    check_json_size(len(data), path, where)
    try:
        text = data.rstrip(b"\0 \t\r\n").decode("utf-8-sig")
        value = json.loads(text, parse_constant=_refuse_constant)
    except RecursionError as error:
        raise LimitError(path, where, "JSON nested too deep", f"at most {MAX_JSON_DEPTH} levels") from error
    except ValueError as error:
        raise MetadataError(path, where, f"{error}", "a JSON object") from error
    if not isinstance(value, dict):
        raise MetadataError(path, where, f"a JSON {type(value).__name__}", "a JSON object")
    if _deeper_than(value, MAX_JSON_DEPTH):
        raise LimitError(path, where, "JSON nested too deep", f"at most {MAX_JSON_DEPTH} levels")
    return Document(text, value)


def check_json_size(length: int, path: str, where: str) -> None:
    """Raise `LimitError` if a JSON text of `length` bytes is longer than any real one."""
    if length > MAX_JSON_BYTES:
        raise LimitError(path, where, f"{length} bytes of JSON", f"at most {MAX_JSON_BYTES}")


def write_json(value: Mapping[str, Any]) -> bytes:
    """JSON text as the cameras write it: tabs, and blanks around the colons.

    Raises
    ------
    ValueError, TypeError
        If a value is no JSON.
    """
    return json.dumps(value, indent="\t", separators=(",", " : "), allow_nan=False).encode()


def at(value: Any, *keys: str | int) -> Any:
    """Value found by following keys and indices; None where one is missing or leads through something else."""
    for key in keys:
        if isinstance(key, int):
            if not isinstance(value, list) or not -len(value) <= key < len(value):
                return None
            value = value[key]
        else:
            if not isinstance(value, Mapping):
                return None
            value = value.get(key)
    return value


def finite_number(value: Any) -> float:
    """Value as float64; NaN where it is no number, or none that is finite."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    try:
        number = float(value)
    except OverflowError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")


def _deeper_than(value: Any, depth: int) -> bool:
    level = [value]
    for _ in range(depth):
        level = [
            child
            for item in level
            for child in (item.values() if isinstance(item, dict) else item)
            if isinstance(child, dict | list)
        ]
        if not level:
            return False
    return True
