"""One zarr store per kind of result: its groups, how they grow, and the region of a capture."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
import zarr
from numcodecs.bitround import BitRound

from lfflow.collection import template
from lfflow.collection.records import DamagedRecordError, Record, sealed, unsealed
from lfflow.collection.scalars import decode, encode, is_region, small_variables
from lfflow.collection.storage import Storage
from lfflow.collection.whole_store import WholeStore
from lfflow.errors import SchemaError
from lfflow.kernels.threads import each
from lfflow.schema import Schema, Variable


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a group holds: the size of every dim, the capture of every slot, and the schema version it was made with."""

    sizes: Mapping[str, int]
    captures: tuple[str, ...]
    version: int = 0


class Store:
    """The zarr store of one stage's results."""

    def __init__(self, storage: Storage, schema: Schema) -> None:
        self.storage = storage
        self.schema = schema
        self.folder = f"{schema.name}.zarr"
        self._zarr = storage.zarr_store(self.folder)
        self._whole = WholeStore(self._zarr, _always_written(schema))

    def groups(self) -> list[str]:
        """Groups (camera models) of the store."""
        return [name.removesuffix(".json") for name in self.storage.names(f"ledger/stores/{self.schema.name}")]

    def manifest(self, group: str) -> Manifest | None:
        """Sizes and slots of a group; rebuilt from the arrays when its file is damaged; None when there is no group."""
        name = self._manifest_name(group)
        try:
            document = unsealed(self.storage.read(name), name)
        except FileNotFoundError:
            return None
        except DamagedRecordError:
            return self._manifest_from_arrays(group)
        return Manifest(document["sizes"], tuple(document["captures"]), int(document["schema_version"]))

    def manifest_damage(self, group: str) -> str:
        """What is wrong with the file of a group's sizes and slots; empty when nothing is."""
        name = self._manifest_name(group)
        try:
            unsealed(self.storage.read(name), name)
        except (FileNotFoundError, DamagedRecordError) as error:
            return str(error)
        return ""

    def mend_manifest(self, group: str, records: Iterable[Record]) -> None:
        """Write a damaged file of sizes and slots anew, from the arrays and the ledger."""
        if not self.manifest_damage(group):
            return
        found = self._manifest_from_arrays(group)
        captures = dict(enumerate(found.captures)) | {record.slot: record.capture for record in records}
        self._write_manifest(
            group, found.sizes, [captures.get(slot, "") for slot in range(max(captures, default=-1) + 1)]
        )

    def _write_manifest(self, group: str, sizes: Mapping[str, int], captures: Sequence[str]) -> None:
        document = {"sizes": dict(sizes), "captures": list(captures), "schema_version": self.schema.version}
        name, data = self._manifest_name(group), sealed(document)
        if self.storage.read_many([name]).get(name) != data:
            self.storage.write(name, data)

    def _manifest_name(self, group: str) -> str:
        return f"ledger/stores/{self.schema.name}/{group}.json"

    def _manifest_from_arrays(self, group: str) -> Manifest:
        node = zarr.open_group(self._zarr, path=group, mode="r", zarr_format=3)
        captures: Any = node["capture"]
        sizes: dict[str, int] = {}
        for variable in self.schema.variables:
            if is_region(variable) and variable.name in node:
                array: Any = node[variable.name]
                sizes.update(zip(variable.dims, array.shape[1:], strict=True))
        version: Any = node.attrs.get("schema_version", self.schema.version)
        return Manifest(sizes, tuple(str(name) for name in captures[...]), int(version))

    def ensure(self, group: str, sizes: Mapping[str, int], captures: Sequence[str]) -> dict[str, int]:
        """Make the group or let it grow, so that each capture has a slot; finished regions stay untouched.

        Returns the slot of every capture. Only one process at a time may call this (the coordinator of a run).
        Raises SchemaError when the store differs from its declaration.
        """
        manifest = self.manifest(group)
        before = manifest.captures if manifest else ()
        sizes = manifest.sizes if manifest else sizes
        if manifest:
            self.check(group, manifest)
        after = (*before, *(name for name in captures if name not in set(before)))
        if after != before or not manifest:
            content = template.build(self.schema, group, sizes, after, {}, values=not manifest)
            self._write_small(content, fresh=not manifest)
        # Last: a slot that the manifest names has its place in every array, also after a crash in between.
        self._write_manifest(group, sizes, after)
        return {name: slot for slot, name in enumerate(after)}

    def check(self, group: str, manifest: Manifest) -> None:
        """Raise SchemaError when the metadata on the disk differs from the declaration; mend it where it is rotten."""
        if manifest.version != self.schema.version:
            raise SchemaError(
                f"{self.folder}/{group} has schema version {manifest.version}, this lfflow writes "
                f"{self.schema.version}: lfflow migrate brings it there"
            )
        expected = template.build(self.schema, group, manifest.sizes, manifest.captures, {}, values=False)
        contents = {f"{self.folder}/{key}": data for key, data in expected.items() if key.endswith("zarr.json")}
        there = self.storage.read_many(list(contents))
        for name, wanted in contents.items():
            found = there.get(name)
            if found is None:
                self.storage.write(name, wanted)
                continue
            differences = template.differences(found, wanted)
            rotten = template.looks_rotten(found, wanted) if differences else template.has_other_length(found, wanted)
            if rotten:
                self.storage.write(name, wanted)
            elif differences:
                raise SchemaError(f"{name} differs from its declaration: " + "; ".join(differences))

    def finalise(self, group: str, records: Mapping[str, Record]) -> None:
        """Write axes and small variables of all finished captures, as the ledger has them."""
        manifest = self.manifest(group)
        if manifest is None:
            return
        lines = {f"lfflow {r.versions.get('lfflow', '?')}: {r.stage} {dict(sorted(r.parameters.items()))}"
                 for r in records.values()}  # fmt: skip
        content = template.build(self.schema, group, manifest.sizes, manifest.captures, records, sorted(lines))
        self._write_small(content)

    def _write_small(self, content: Mapping[str, bytes], *, fresh: bool = False) -> None:
        """Write what differs from the disk; array metadata last, so that a longer shape never lacks its labels.

        Of a `fresh` group nothing is there yet. None of it needs to survive a power cut: every run derives it anew.
        """
        names = {f"{self.folder}/{key}": data for key, data in content.items()}
        there = {} if fresh else self.storage.read_many(list(names))
        changed = {name: data for name, data in names.items() if there.get(name) != data}
        for metadata in (False, True):
            self.storage.write_many({n: data for n, data in changed.items() if n.endswith("zarr.json") == metadata})

    def _array(self, group: str, name: str, mode: Any) -> Any:
        store = self._whole if mode == "r" else self._zarr
        array = zarr.open_array(store, path=f"{group}/{name}", mode=mode, zarr_format=3)
        return array.with_config({"write_empty_chunks": True})

    def region_files(self, group: str, slot: int, *, only: Container[str] | None = None) -> list[str]:
        """Names of the files of one capture's region."""
        names: list[str] = []
        for variable in self._regions(only):
            names += self.storage.files_below(f"{self.folder}/{group}/{variable.name}/c/{slot}")
        return names

    def variable_of(self, file: str) -> str:
        """Variable to whose region a file belongs."""
        return file.removeprefix(f"{self.folder}/").split("/")[1]

    def stored_variables(self, group: str) -> set[str]:
        """Variables that have an array in a group, declared or not."""
        node = zarr.open_group(self._zarr, path=group, mode="r", zarr_format=3)
        return {str(name) for name, _ in node.arrays()}

    def add_arrays(self, group: str, names: Iterable[str]) -> None:
        """Make the arrays of declared variables that an earlier schema has not; nothing else is written."""
        manifest = self.manifest(group)
        if manifest is not None:
            content = template.build(self.schema, group, manifest.sizes, manifest.captures, {}, values=False)
            keys = [f"{group}/{name}/zarr.json" for name in names]
            self._write_small({key: content[key] for key in keys})

    def encoding_differences(self, group: str) -> list[str]:
        """How arrays that are stored and declared differ in more than their attributes."""
        manifest = self.manifest(group)
        if manifest is None:
            return []
        expected = template.build(self.schema, group, manifest.sizes, manifest.captures, {}, values=False)
        stored, found = self.stored_variables(group), []
        for variable in self._regions(stored):
            key = f"{group}/{variable.name}/zarr.json"
            differences = template.differences(self.storage.read(f"{self.folder}/{key}"), expected[key])
            found += [f"{variable.name}: {text}" for text in differences if not text.startswith("attributes:")]
        return found

    def drop_arrays(self, group: str, names: Iterable[str]) -> None:
        """Remove the arrays in `names` that the schema does not declare."""
        node = zarr.open_group(self._zarr, path=group, mode="r+", zarr_format=3)
        for name in sorted(set(names) - {"capture", *self.schema.names}):
            del node[name]

    def adopt_schema(self, group: str, records: Mapping[str, Record]) -> None:
        """Write metadata and small variables as the present schema declares them, then say that the group has it."""
        manifest = self.manifest(group)
        if manifest is not None:
            self.finalise(group, records)
            self._write_manifest(group, manifest.sizes, manifest.captures)

    def _regions(self, only: Container[str] | None = None) -> list[Variable]:
        return [v for v in self.schema.variables if is_region(v) and (only is None or v.name in only)]

    def write(
        self, group: str, slot: int, ds: xr.Dataset, threads: int = 1, *, only: Container[str] | None = None
    ) -> dict[str, str]:
        """Write the region of one capture (of the variables in `only`); returns the sha256 of its files on the disk."""

        def one(variable: Variable) -> None:
            values = np.ascontiguousarray(ds[variable.name].transpose(*variable.dims).values)
            if variable.keep_bits is not None:
                values = _rounded(values, variable.keep_bits)
            array = self._array(group, variable.name, "r+")
            if array.shape[1:] != values.shape:
                raise SchemaError(
                    f"{variable.name} has shape {values.shape}, group {group} of {self.folder} holds {array.shape[1:]}"
                )
            array[slot] = values

        given = [v for v in self._regions(only) if v.required or v.name in ds.variables]
        # Not written over: zarr reads what is there of a shard, and would stumble over one that is rotten.
        for name in self.region_files(group, slot, only=only):
            self.storage.remove(name)
        each(one, given, threads)
        files = self.region_files(group, slot, only=only)
        self.storage.flush(files)
        return {name: self.storage.digest(name) for name in files}

    def read(self, record: Record, *, only: Container[str] | None = None) -> xr.Dataset:
        """Result of one finished capture (of the large variables in `only`), in memory; a damaged chunk raises."""
        variables: dict[str, Any] = {}
        for variable in self._regions(only):
            variables[variable.name] = (variable.dims, self._array(record.group, variable.name, "r")[record.slot])
        for variable in small_variables(self.schema):
            variables[variable.name] = (variable.dims, decode(record.scalars, variable))
        ds = xr.Dataset(variables)
        axes = [variable for variable in self.schema.variables if variable.axis and variable.name in ds.dims]
        ds = ds.assign_coords({a.name: (a.dims, template.axis_values(a.name, ds.sizes[a.name])) for a in axes})
        return self.schema.annotate(ds.assign_coords(capture=record.capture))

    def scalars(self, ds: xr.Dataset) -> dict[str, Any]:
        """Small variables of one capture for its ledger record."""
        return encode(ds, self.schema)

    def open(self, group: str) -> xr.Dataset:
        """Regions and axes of all slots of a group, lazily, without dask; what is finished is for the ledger to say.

        Arrays that differ in length, because a run lets the group grow or was killed when it did, have the shortest:
        all that is finished lies within.
        """
        source = xr.backends.ZarrStore.open_group(self._whole, mode="r", group=group, consolidated=False)
        variables, attributes = source.load()
        shown = {
            v.name: variables[v.name] for v in self.schema.variables if v.axis or is_region(v) if v.name in variables
        }
        length = min((v.sizes["capture"] for v in shown.values() if "capture" in v.dims), default=0)
        shown = {name: v.isel(capture=slice(length), missing_dims="ignore") for name, v in shown.items()}
        return xr.decode_cf(xr.Dataset(shown, attrs=attributes))


def _always_written(schema: Schema) -> list[str]:
    """Arrays of which every chunk that a reader of finished captures meets is there: axes, and required regions."""
    return [v.name for v in schema.variables if v.axis or (v.required and is_region(v))]


def _rounded(values: np.ndarray[Any, Any], keep_bits: int) -> np.ndarray[Any, Any]:
    codec = BitRound(keep_bits)
    rounded: np.ndarray[Any, Any] = np.asarray(codec.decode(codec.encode(values))).view(values.dtype)
    return rounded.reshape(values.shape)
