"""Bring the catalogue of a collection up to date with its pictures; rebuild it when it is damaged or gone.

What was asked for (inputs, and files told to be white or dark) is kept beside the catalogue. With it and the ledger,
which knows the capture, path and sha256 of everything finished, a catalogue is made anew with the ids it had.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Collection as Names
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from lfflow.collection import catalogue
from lfflow.collection.catalogue import NUMBERS, Row
from lfflow.collection.collection import KINDS, Collection
from lfflow.collection.inputs import absolute, find_files
from lfflow.collection.records import DamagedRecordError, Record, sealed, unsealed
from lfflow.collection.scan import OpenRaw, scan
from lfflow.errors import CollectionError
from lfflow.schema.declarations import METHOD_FLAGS

FILE = "inputs.json"
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Asked:
    """What scans were asked for: absolute paths and patterns."""

    inputs: tuple[str, ...] = ()
    white: tuple[str, ...] = ()
    dark: tuple[str, ...] = ()

    def with_more(self, more: Asked) -> Asked:
        """What was asked for then and now; a file told to be white is dark no longer, and the other way round."""
        white = {*self.white, *more.white} - set(more.dark)
        dark = {*self.dark, *more.dark} - set(more.white)
        return Asked(tuple(sorted({*self.inputs, *more.inputs})), tuple(sorted(white)), tuple(sorted(dark)))


def update(
    collection: Collection,
    open_raw: OpenRaw,
    inputs: Sequence[str | Path] = (),
    *,
    white: Sequence[str | Path] = (),
    dark: Sequence[str | Path] = (),
    again: bool = False,
) -> pd.DataFrame:
    """Catalogue with the pictures of `inputs` and all that were known, as they are now; not saved yet.

    Raises
    ------
    CollectionError
        For an input that is not there.
    """
    now = Asked(*(tuple(absolute(item) for item in items) for items in (inputs, white, dark)))
    files, told = find_files(now.inputs), {"white": find_files(now.white), "dark": find_files(now.dark)}
    earlier = _load(collection)
    known = _known(collection)
    if known is None:
        known = from_ledger(collection)
        files += _still_there(earlier.inputs)
        told = {"white": [*told["white"], *_still_there(earlier.white)],
                "dark": [*told["dark"], *_still_there(earlier.dark)]}  # fmt: skip
        if len(known) or earlier != Asked():
            _log.warning("the catalogue of %s is damaged or gone: it is made anew", collection.storage.url)
    document = earlier.with_more(now)
    if document != earlier:
        collection.storage.write(FILE, sealed({name: list(getattr(document, name)) for name in Asked.__slots__}))
    return scan(files, known, open_raw, again=again, finished=finished(collection), **told)


def finished(collection: Collection) -> Names[str]:
    """Captures of which any stage is done."""
    return {capture for kind in KINDS for capture in collection.ledger.captures(kind)}


def from_ledger(collection: Collection) -> pd.DataFrame:
    """Catalogue of what the ledger knows: enough to give every picture its id again, and its results their metadata."""
    rows: dict[str, Row] = {}
    for kind in KINDS:
        for capture, record in collection.ledger.records(kind).items():
            rows[capture] = {**rows.get(capture, {}), **_row(collection, record)}
    return catalogue.frame(rows.values())


def _row(collection: Collection, record: Record) -> Row:
    scalars = record.scalars
    row: Row = {name: scalars[name] for name in NUMBERS if name in scalars}
    row |= {name: scalars[name] for name in ("camera_model", "camera_serial") if name in scalars}
    row["time"] = np.datetime64(scalars.get("time") or "NaT", "ns")
    row |= {"id": record.capture, "path": record.source["path"], "sha256": record.source["sha256"]}
    row["damaged"] = record.damaged.get(record.source["path"], "")
    on_white = record.stage == "calibration" and scalars.get("method") == METHOD_FLAGS["white"]
    row |= {"group": record.group, "kind": "white" if on_white else "scene"}
    sensor = collection.store("calibration").manifest(record.group)
    return row | {"height": sensor.sizes["y"], "width": sensor.sizes["x"]} if sensor else row


def _known(collection: Collection) -> pd.DataFrame | None:
    """Return the catalogue as it is; None where it is damaged or was never there."""
    try:
        return collection.catalogue_rows() if collection.exists() else None
    except catalogue.DamagedCatalogueError:
        return None


def _load(collection: Collection) -> Asked:
    try:
        document: Mapping[str, Any] = unsealed(collection.storage.read(FILE), FILE)
        return Asked(**{name: tuple(document.get(name, ())) for name in Asked.__slots__})
    except FileNotFoundError:
        return Asked()
    except (DamagedRecordError, json.JSONDecodeError, TypeError, AttributeError) as error:
        _log.warning("what was scanned before is not known: %s", error)
        return Asked()


def _still_there(inputs: Sequence[str]) -> list[str]:
    files: list[str] = []
    for item in inputs:
        try:
            files += find_files([item])
        except CollectionError as error:
            _log.warning("%s; it was scanned before", error)
    return files
