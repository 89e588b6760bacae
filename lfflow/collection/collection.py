"""A collection as its readers see it: what is finished, lazily, and what became of the rest."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from lfflow.collection import catalogue
from lfflow.collection.query import select
from lfflow.collection.records import FAILED, Ledger
from lfflow.collection.scalars import LARGE_DIMS, decode, small_variables
from lfflow.collection.storage import open_storage
from lfflow.collection.stores import Store
from lfflow.collection.whites import SELF, candidates, reason
from lfflow.errors import CollectionError
from lfflow.schema import SCHEMAS

KINDS = ("calibration", "lightfield", "disparity")
_CARRIED = ("camera_model", "camera_serial", "time", "iso", "exposure_time", "f_number", "focal_length", "zoom_step",
            "focus_step", "infinity_lambda", "path", "white")  # fmt: skip


def open_collection(where: str | os.PathLike[str]) -> Collection:
    """Open the collection at a folder or an fsspec URL; raises CollectionError when there is none."""
    collection = Collection(where)
    if not collection.exists():
        raise CollectionError(f"no collection at {where}: there is no {catalogue.FILE}")
    return collection


class Collection:
    """Catalogue, stores and ledger of one folder or URL."""

    def __init__(self, where: str | os.PathLike[str]) -> None:
        self.storage = open_storage(where)
        self.ledger = Ledger(self.storage)

    def __repr__(self) -> str:
        return f"<lfflow collection at {self.storage.url}>"

    def exists(self) -> bool:
        """Whether a catalogue is there."""
        return self.storage.has(catalogue.FILE)

    def store(self, kind: str) -> Store:
        """Store of "calibration", "lightfield" or "disparity"."""
        if kind not in KINDS:
            raise CollectionError(f"no such store: {kind!r}; there are {', '.join(KINDS)}")
        return Store(self.storage, SCHEMAS[kind])

    def catalogue_rows(self) -> pd.DataFrame:
        """One row per input file, as the last scan left it."""
        return catalogue.load(self.storage)

    def catalogue(self) -> pd.DataFrame:
        """One row per input file, with the state of every stage as the ledger has it now."""
        return self.with_states(catalogue.load(self.storage))

    def with_states(self, table: pd.DataFrame) -> pd.DataFrame:
        """Table with the columns `calibration_state` … `disparity_state` and the `failure` of those that failed."""
        table = table.copy()
        names = [str(name) for name in table["id"]]
        failures = dict.fromkeys(names, "")
        facts = list(zip(names, *(table[column] for column in _FACTS), strict=True))
        for kind in KINDS:
            done = set(self.ledger.captures(kind))
            failed = self.ledger.records(kind, FAILED)
            states = [_state(kind, name in done, name in failed, *map(str, row)) for name, *row in facts]
            table[f"{kind}_state"] = pd.Series(states, dtype="str", index=table.index)
            failures |= {
                name: f"{kind}: {failed[name].reason}" for name in names if name in failed and name not in done
            }
        reasons = [failures[name] or str(reason) for name, reason in zip(names, table["reason"], strict=True)]
        table["failure"] = pd.Series(reasons, dtype="str", index=table.index)
        return table

    def query(self, expression: str = "") -> list[str]:
        """Captures for which a pandas expression over the catalogue's columns holds.

        The list goes into ``col.open("disparity").sel(capture=...)``; `table` returns the rows, and
        `lfflow.collection.query` says what an expression may contain.
        """
        return [str(name) for name in self.table(expression)["id"]]

    def table(self, expression: str = "") -> pd.DataFrame:
        """Rows of the catalogue for which a pandas expression holds; raises CollectionError for a wrong one."""
        return select(self.catalogue(), expression)

    def sql(self, query: str) -> pd.DataFrame:
        """Result of an SQL query over the table `catalogue`; needs duckdb (``pip install lfflow[sql]``)."""
        try:
            import duckdb
        except ImportError as error:
            raise CollectionError("SQL needs duckdb: pip install 'lfflow[sql]'") from error
        with duckdb.connect(":memory:", config={"enable_external_access": "false"}) as connection:
            connection.register("catalogue", self.catalogue())
            try:
                return pd.DataFrame(connection.sql(query).df())
            except duckdb.Error as error:
                raise CollectionError(f"cannot evaluate {query!r}: {error}") from error

    def explain(self, capture: str) -> dict[str, Any]:
        """Why a capture is what it is: its file, its stages, its white image and the other candidates."""
        table = self.catalogue().set_index("id", drop=False)
        if capture not in table.index:
            raise CollectionError(f"no capture {capture!r} in {self.storage.url}")
        row = pd.Series(table.loc[capture])
        found = candidates(row, table) if row["kind"] == "scene" else []
        made = [record for kind in KINDS if (record := self.ledger.find(kind, capture)) is not None]
        return {
            "capture": capture,
            "path": str(row["path"]),
            "kind": str(row["kind"]),
            "judged_by": str(row["judged_by"]),
            "white": str(row["white"]),
            "white_reason": reason(row, found) if row["kind"] == "scene" else "",
            "failure": str(row["failure"]),
            "damaged": {file: words for record in made for file, words in record.damaged.items()},
            "candidates": [str(candidate) for candidate in found],
            "stages": {kind: str(row[f"{kind}_state"]) for kind in KINDS if row[f"{kind}_state"]},
        }

    def status(self) -> dict[str, Any]:
        """Counts of captures by kind and of stages by state, the reason of every failure, what damage was accepted."""
        table = self.catalogue()
        stages = {kind: {str(k): int(v) for k, v in table[f"{kind}_state"].value_counts().items() if k}
                  for kind in KINDS}  # fmt: skip
        kinds = {str(k) or "unreadable": int(v) for k, v in table["kind"].value_counts().items()}
        return {
            "collection": self.storage.url,
            "files": len(table),
            "kinds": kinds,
            "stages": stages,
            "failed": _said(table, "failure"),
            "damaged": _said(table, "damaged"),
        }

    def open(
        self, kind: str, *, camera: str | None = None, chunks: Mapping[Any, int] | str | None = "capture"
    ) -> xr.Dataset:
        """All finished captures of one kind, lazily; metadata of the catalogue come as coordinates.

        Parameters
        ----------
        kind
            "calibration", "lightfield" or "disparity".
        camera
            Group of the store (camera model); may be left out when there is only one.
        chunks
            "capture": a dask block per capture; a mapping: as `xarray.Dataset.chunk` takes it; None: no dask.
        """
        store = self.store(kind)
        group = self._group(store, camera)
        everything = store.open(group)
        records = {r.slot: r for r in self.ledger.records(kind).values() if r.group == group}
        slots = sorted(slot for slot in records if slot < everything.sizes["capture"])
        finished = [records[slot] for slot in slots]
        ds = everything.isel(capture=np.array(slots, dtype=int))
        names = np.array([record.capture for record in finished], dtype=object)
        ds = ds.assign_coords(capture=("capture", names))
        for variable in small_variables(store.schema):
            values = [decode(record.scalars, variable) for record in finished]
            if values and any(variable.name in record.scalars for record in finished):
                ds[variable.name] = (("capture", *variable.dims), np.stack(values))
        ds = store.schema.annotate(self._with_metadata(ds))
        return ds if chunks is None else _chunked(ds, {"capture": 1} if isinstance(chunks, str) else dict(chunks))

    def _with_metadata(self, ds: xr.Dataset) -> xr.Dataset:
        table = catalogue.load(self.storage).set_index("id").reindex(list(ds["capture"].values))
        for name in _CARRIED:
            if name not in ds.variables:
                column = table[name]
                values = column.to_numpy(dtype=object) if column.dtype.kind not in "fM" else column.to_numpy()
                ds = ds.assign_coords({name: ("capture", values)})
        return ds

    def _group(self, store: Store, camera: str | None) -> str:
        groups = store.groups()
        if camera is not None and camera in groups:
            return camera
        if camera is None and len(groups) == 1:
            return groups[0]
        if not groups:
            raise CollectionError(f"nothing in {store.folder} of {self.storage.url} yet")
        raise CollectionError(f"which camera? {store.folder} holds {', '.join(groups)}")


def needed_stages(kind: str, white: str) -> tuple[str, ...]:
    """Stages that a picture of a kind goes through; a scene with a white image has no calibration of its own."""
    if kind == "scene":
        return KINDS if white == SELF else KINDS[1:]
    return KINDS[:1] if kind == "white" else ()


def _chunked(ds: xr.Dataset, chunks: Mapping[Any, int]) -> xr.Dataset:
    """Dataset whose large variables are dask arrays; metadata are there at once, to be looked at and selected by."""
    for name, variable in ds.variables.items():
        if LARGE_DIMS & set(variable.dims) and variable.ndim > 1:
            ds[name] = ds[name].chunk({dim: size for dim, size in chunks.items() if dim in variable.dims})
    return ds


def _said(table: pd.DataFrame, column: str) -> dict[str, str]:
    """What a column says of the captures of which it says anything."""
    rows = table.loc[table[column] != "", ["id", column]]
    return {str(name): str(words) for name, words in rows.itertuples(index=False)}


_FACTS = ("reason", "duplicate_of", "kind", "white")


def _state(stage: str, done: bool, failed: bool, reason: str, duplicate_of: str, kind: str, white: str) -> str:
    if done:
        return "done"
    if reason:
        return "unreadable"
    if duplicate_of:
        return "duplicate"
    if stage not in needed_stages(kind, white):
        return ""
    return "failed" if failed else "pending"
