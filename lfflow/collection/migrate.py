"""Bring the stores of a collection to the present schema: capture by capture, safe to stop and to start again.

The manifest of a group, written last, says which version the group has; until then it counts as old, and all that was
done is done again with the same outcome. What is stored is left where it is: only what is new is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import xarray as xr

from lfflow.collection.collection import KINDS, Collection
from lfflow.collection.records import Record
from lfflow.collection.scalars import is_region, small_variables
from lfflow.collection.stores import Store
from lfflow.errors import SchemaError
from lfflow.schema.migrations import MIGRATIONS, Migration, migrations


@dataclass(frozen=True, slots=True)
class Migrated:
    """What was done to one group of one store."""

    store: str
    group: str
    before: int
    after: int
    captures: int
    what: tuple[str, ...]


def migrate(collection: Collection, known: Sequence[Migration] = MIGRATIONS) -> list[Migrated]:
    """Migrate every group whose schema is not the present one; the caller holds the lease of the collection.

    Raises
    ------
    SchemaError
        If a store was made by a later lfflow, or there is no way from its version; nothing has been changed then.
    """
    waiting = []
    for kind in KINDS:
        store = collection.store(kind)
        for group in store.groups():
            manifest = store.manifest(group)
            if manifest is not None and manifest.version != store.schema.version:
                waiting.append((store, group, manifest.version))
    for store, group, _ in waiting:
        _check_encodings(store, group)
    ways = [migrations(store.schema, version, tuple(known)) for store, _, version in waiting]
    return [
        _migrate_group(collection, store, group, version, steps)
        for (store, group, version), steps in zip(waiting, ways, strict=True)
    ]


def _migrate_group(
    collection: Collection, store: Store, group: str, version: int, steps: Sequence[Migration]
) -> Migrated:
    name = store.schema.name
    records = {c: record for c, record in collection.ledger.records(name).items() if record.group == group}
    stored = store.stored_variables(group)
    declared = {variable.name for variable in store.schema.variables if is_region(variable)}
    store.add_arrays(group, sorted(declared - stored))
    migrated: dict[str, Record] = {}
    for capture, record in records.items():
        migrated[capture] = _migrate_capture(store, record, declared, steps)
        collection.ledger.write(migrated[capture])
    store.drop_arrays(group, stored)
    store.adopt_schema(group, migrated)
    return Migrated(name, group, version, store.schema.version, len(records), tuple(step.what for step in steps))


def _migrate_capture(store: Store, record: Record, declared: set[str], steps: Sequence[Migration]) -> Record:
    """Record of a capture that has every declared variable; those that it had are read, the others written."""
    had = {store.variable_of(file) for file in record.files}
    absent = [variable.name for variable in small_variables(store.schema) if variable.name not in record.scalars]
    ds = store.read(record, only=had).drop_vars(absent)
    for step in steps:
        ds = step.convert(ds)
    added = declared - had
    _check_complete(store, record.capture, ds, added)
    files = store.write(record.group, record.slot, ds, only=added) if added else {}
    kept = {file: digest for file, digest in record.files.items() if store.variable_of(file) in declared}
    return replace(record, files={**kept, **files}, scalars=store.scalars(ds))


def _check_complete(store: Store, capture: str, ds: xr.Dataset, added: set[str]) -> None:
    missing = sorted(name for name in added if name not in ds.variables and store.schema[name].required)
    if missing:
        raise SchemaError(f"the migration of {capture} in {store.folder} gives no {', '.join(missing)}")


def _check_encodings(store: Store, group: str) -> None:
    """What is stored can stay only if it is stored as the present schema would store it."""
    differences = store.encoding_differences(group)
    if differences:
        raise SchemaError(f"{store.folder}/{group} cannot be migrated in place: {'; '.join(differences)}")
