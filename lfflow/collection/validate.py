"""Whether everything that the ledger calls finished is still whole on the disk."""

from __future__ import annotations

from dataclasses import dataclass

from lfflow.collection import catalogue, template
from lfflow.collection.collection import KINDS, Collection
from lfflow.collection.records import DAMAGED, DONE, FAILED, DamagedRecordError, Record
from lfflow.collection.stores import Store


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is not as it should be; `capture` is empty where it concerns a whole store."""

    what: str
    capture: str
    reason: str


def validate(collection: Collection, *, mark: bool = True) -> list[Finding]:
    """Check catalogue, ledger, metadata and every finished region against checksums and schema.

    With `mark`, what is damaged is no longer called finished: it vanishes from `Collection.open`, and the next run
    makes it anew.
    """
    found: list[Finding] = []
    try:
        catalogue.load(collection.storage)
    except catalogue.DamagedCatalogueError as error:
        found.append(Finding("catalogue", "", str(error)))
    for kind in KINDS:
        store = collection.store(kind)
        for group in store.groups():
            found += _check_metadata(store, group)
        records = _whole_records(collection, kind, found, mark=mark)
        for record in records.values():
            reasons = _check_region(store, record)
            found += [Finding(kind, record.capture, reason) for reason in reasons]
            if reasons and mark:
                collection.ledger.move(record, DAMAGED)
        found += _check_small(store, records)
    return found


def _whole_records(collection: Collection, kind: str, found: list[Finding], *, mark: bool) -> dict[str, Record]:
    """Records of what is done; damaged ones, also of failures, are added to what was found."""
    records: dict[str, Record] = {}
    for state in (DONE, FAILED):
        for capture, record in collection.ledger.each(kind, state):
            if isinstance(record, DamagedRecordError):
                found.append(Finding("ledger", capture, str(record)))
                if mark:
                    collection.ledger.remove(kind, capture, state)
            elif state == DONE:
                records[capture] = record
    return records


def _check_region(store: Store, record: Record) -> list[str]:
    reasons = []
    for name, wanted in record.files.items():
        try:
            if store.storage.digest(name) != wanted:
                reasons.append(f"{name} does not match its checksum")
        except FileNotFoundError:
            reasons.append(f"{name} is missing")
        except OSError as error:
            reasons.append(f"{name} cannot be read: {error.strerror or error}")
    return reasons


def _check_metadata(store: Store, group: str) -> list[Finding]:
    manifest = store.manifest(group)
    if manifest is None:
        return []
    found = [Finding("ledger", "", reason)] if (reason := store.manifest_damage(group)) else []
    expected = template.build(store.schema, group, manifest.sizes, manifest.captures, {}, values=False)
    contents = store.storage.read_many([f"{store.folder}/{key}" for key in expected])
    for key, wanted in expected.items():
        name = f"{store.folder}/{key}"
        there = contents.get(name)
        differences = ["missing"] if there is None else template.differences(there, wanted)
        if there is not None and not differences and template.has_other_length(there, wanted):
            differences = ["it has not the captures of its group"]
        found += [Finding("metadata", "", f"{name}: {difference}") for difference in differences]
    return found


def _check_small(store: Store, records: dict[str, Record]) -> list[Finding]:
    """Compare axes and small variables with what the ledger says they are."""
    found = []
    for group in store.groups():
        manifest = store.manifest(group)
        if manifest is None:
            continue
        mine = {name: record for name, record in records.items() if record.group == group}
        expected = template.build(store.schema, group, manifest.sizes, manifest.captures, mine)
        small = {f"{store.folder}/{key}": data for key, data in expected.items() if not key.endswith("zarr.json")}
        there = store.storage.read_many(list(small))
        wrong = [name for name, wanted in small.items() if there.get(name) != wanted]
        found += [Finding("small variables", "", f"{name} does not match the ledger") for name in wrong]
    return found
