"""Small variables of a capture: into a ledger record as JSON and back, without losing a bit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from lfflow.schema import Schema, Variable

LARGE_DIMS = frozenset({"y", "x", "v", "u", "t", "s"})


def is_region(variable: Variable) -> bool:
    """Whether the variable is written as a region of an array, not kept in the record."""
    return not variable.axis and bool(LARGE_DIMS & set(variable.dims))


def small_variables(schema: Schema) -> list[Variable]:
    """Variables that have one small value per capture."""
    return [variable for variable in schema.variables if not variable.axis and not is_region(variable)]


def encode(ds: xr.Dataset, schema: Schema) -> dict[str, Any]:
    """Small variables of one capture as JSON values; NaN and NaT become null."""
    values = {}
    for variable in small_variables(schema):
        if variable.name in ds.variables:
            array = ds[variable.name].transpose(*variable.dims).values
            values[variable.name] = _to_json(array)
    return values


def decode(values: Mapping[str, Any], variable: Variable) -> np.ndarray[Any, Any]:
    """Value of one variable from a record; its fill value where the record has none."""
    return _from_json(values[variable.name], variable) if variable.name in values else _missing(variable)


def _to_json(array: np.ndarray[Any, Any]) -> Any:
    if array.dtype.kind == "M":
        text = np.datetime_as_string(array.astype("datetime64[ns]"))
        return None if np.isnat(array).all() else text.tolist()
    value = array.tolist()
    return _without_nan(value)


def _without_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def _from_json(value: Any, variable: Variable) -> np.ndarray[Any, Any]:
    if value is None:
        return _missing(variable)
    if variable.dtype == "string":
        return np.asarray(value, dtype=object)
    if variable.dtype.startswith("datetime"):
        return np.asarray(value, dtype=variable.dtype)
    return np.asarray(_with_nan(value), dtype=variable.dtype)


def _with_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [_with_nan(item) for item in value]
    return math.nan if value is None else value


SMALL_SIZES = {"channel": 3, "channel_in": 3, "parameter": 5, "parameter_b": 5, "site": 4, "axis": 2, "term": 21}


def _missing(variable: Variable) -> np.ndarray[Any, Any]:
    shape = tuple(SMALL_SIZES[dim] for dim in variable.dims)
    if variable.dtype == "string":
        return np.full(shape, "", dtype=object)
    if variable.dtype.startswith("datetime"):
        return np.full(shape, np.datetime64("NaT", "ns"))
    return np.full(shape, variable.fill_value, dtype=variable.dtype)
