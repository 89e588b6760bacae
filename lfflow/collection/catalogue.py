"""The catalogue: one row per input file, also for those that cannot be read, as a checksummed Parquet file."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable
from typing import Any

import pandas as pd

from lfflow.collection.storage import Storage
from lfflow.errors import CollectionError

FILE = "catalogue.parquet"
_SEAL = "catalogue.sha256.json"

Row = dict[str, Any]

TEXT = ("id", "path", "sha256", "kind", "judged_by", "camera_model", "camera_serial", "group", "white",
        "duplicate_of", "reason", "told_kind")  # fmt: skip
WHOLE = ("size", "mtime_ns", "height", "width")
NUMBERS = ("iso", "exposure_time", "f_number", "focal_length", "zoom_step", "focus_step", "infinity_lambda",
           "temperature", "pixel_pitch", "lens_pitch", "white_distance")  # fmt: skip
FLAGS = ("missing",)
COLUMNS = (*TEXT, *WHOLE, *FLAGS, "time", *NUMBERS)


class DamagedCatalogueError(CollectionError):
    """The catalogue does not match its checksum."""


def frame(rows: Iterable[Row] | pd.DataFrame) -> pd.DataFrame:
    """Catalogue with its columns and dtypes, sorted by id; what a row lacks is "", 0, False, NaN or NaT."""
    known = rows.reindex(columns=list(COLUMNS)) if isinstance(rows, pd.DataFrame) else None
    table = pd.DataFrame(list(rows), columns=list(COLUMNS)) if known is None else known
    for name in TEXT:
        table[name] = table[name].astype("object").where(table[name].notna(), "").astype("str")
    for name in WHOLE:
        table[name] = pd.to_numeric(table[name].astype("object").fillna(0)).astype("int64")
    for name in FLAGS:
        table[name] = pd.to_numeric(table[name].astype("object").fillna(0)).astype("bool")
    for name in NUMBERS:
        table[name] = pd.to_numeric(table[name]).astype("float64")
    table["time"] = pd.to_datetime(table["time"]).astype("datetime64[ns]")
    return table.sort_values("id", kind="stable", ignore_index=True)


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
    return frame(pd.read_parquet(io.BytesIO(data)))


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
