"""The catalogue: one row per input file, also for those that cannot be read, as a checksummed Parquet file."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from lfflow.collection.storage import Storage
from lfflow.errors import CollectionError

FILE = "catalogue.parquet"
_SEAL = "catalogue.sha256.json"

Row = dict[str, Any]

TEXT = ("id", "path", "sha256", "kind", "judged_by", "camera_model", "camera_serial", "group", "white",
        "duplicate_of", "reason", "told_kind", "damaged")  # fmt: skip
WHOLE = ("size", "mtime_ns", "height", "width")
NUMBERS = ("iso", "exposure_time", "f_number", "focal_length", "zoom_step", "focus_step", "infinity_lambda",
           "temperature", "pixel_pitch", "lens_pitch", "white_distance")  # fmt: skip
FLAGS = ("missing",)
COLUMNS = (*TEXT, *WHOLE, *FLAGS, "time", *NUMBERS)


class DamagedCatalogueError(CollectionError):
    """The catalogue does not match its checksum."""


def frame(rows: Iterable[Row]) -> pd.DataFrame:
    """Catalogue with its columns and dtypes, sorted by id; what a row lacks is "", 0, False, NaN or NaT."""
    rows = sorted(rows, key=lambda row: str(row["id"]))
    columns: dict[str, Any] = {name: pd.array([str(_or(row, name, "")) for row in rows], dtype="str") for name in TEXT}
    columns |= {name: np.array([int(_or(row, name, 0)) for row in rows], dtype="int64") for name in WHOLE}
    columns |= {name: np.array([bool(_or(row, name, 0)) for row in rows], dtype="bool") for name in FLAGS}
    columns |= {name: np.array([float(_or(row, name, math.nan)) for row in rows], dtype="float64") for name in NUMBERS}
    times = pd.to_datetime(pd.Series([row.get("time") for row in rows], dtype="object"))
    columns["time"] = times.astype("datetime64[ns]")
    return pd.DataFrame({name: columns[name] for name in COLUMNS})


def _or(row: Row, name: str, default: Any) -> Any:
    value = row.get(name)
    return default if value is None or value is pd.NA or value != value else value


def rows_of(table: pd.DataFrame) -> list[Row]:
    """Rows of a catalogue as `frame` takes them."""
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]


def load(storage: Storage) -> pd.DataFrame:
    """Catalogue of a collection, empty when there is none; raises DamagedCatalogueError."""
    try:
        data = storage.read(FILE)
    except FileNotFoundError:
        return frame([])
    if hashlib.sha256(data).hexdigest() not in _sealed(storage):
        raise DamagedCatalogueError(f"{FILE} of {storage.url} does not match its checksum")
    table = pd.read_parquet(io.BytesIO(data))
    return table if tuple(table.columns) == COLUMNS else frame(rows_of(table))


def save(storage: Storage, table: pd.DataFrame) -> None:
    """Write the catalogue in one step.

    The seal names the old and the new content while the file is exchanged, so that a crash in between leaves a pair
    that fits together.
    """
    buffer = io.BytesIO()
    table.to_parquet(buffer, index=False)
    data = buffer.getvalue()
    new = hashlib.sha256(data).hexdigest()
    try:
        old = hashlib.sha256(storage.read(FILE)).hexdigest()
    except FileNotFoundError:
        old = ""
    if old == new and _sealed(storage) == [new]:
        return
    storage.write(_SEAL, json.dumps([old, new]).encode())
    storage.write(FILE, data)
    storage.write(_SEAL, json.dumps([new]).encode())


def _sealed(storage: Storage) -> list[str]:
    try:
        digests = json.loads(storage.read(_SEAL))
    except (FileNotFoundError, ValueError):
        return []
    return digests if isinstance(digests, list) else []
