"""The ledger: one record per (stage, capture) says what is done, written last."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any
from urllib.parse import quote, unquote

from lfflow.collection.storage import Storage
from lfflow.errors import CollectionError

DONE = "done"
FAILED = "failed"
DAMAGED = "damaged"


_BATCH = 500
"""Records that are read at once."""


class DamagedRecordError(CollectionError):
    """A record of the ledger does not match its own checksum."""


@dataclass(frozen=True, slots=True)
class Record:
    """Outcome of one stage of one capture.

    Parameters
    ----------
    stage, capture, state
        What it is about; `state` is "done" or "failed".
    fingerprint
        Hash of all that the result depends on: input, stage version, parameters, upstream fingerprints.
    source
        Path and sha256 of the input file.
    group, slot
        Place of the region in the store.
    files
        sha256 of every file of the region.
    scalars
        Variables without large dims, as `lfflow.collection.scalars` encodes them.
    reason, transient
        Why it failed, and whether the same input may succeed another time.
    damaged
        What is wrong with the files that it was made of although they were accepted, by file.
    """

    stage: str
    capture: str
    state: str
    fingerprint: str
    source: Mapping[str, Any]
    group: str = ""
    slot: int = -1
    files: Mapping[str, str] = field(default_factory=dict)
    scalars: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    upstream: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    finished: str = ""
    seconds: float = 0.0
    reason: str = ""
    transient: bool = False
    damaged: Mapping[str, str] = field(default_factory=dict)


def canonical(document: Any) -> bytes:
    """JSON text that is the same for equal documents."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def sealed(document: Any) -> bytes:
    """JSON file that carries its own checksum."""
    digest = hashlib.sha256(canonical(document)).hexdigest()
    return json.dumps({"document": document, "sha256": digest}, sort_keys=True, indent=1, allow_nan=False).encode()


def unsealed(data: bytes, name: str) -> Any:
    """Document of a sealed file; raises DamagedRecordError."""
    try:
        outer = json.loads(data)
        document, digest = outer["document"], outer["sha256"]
    except (ValueError, KeyError, TypeError) as error:
        raise DamagedRecordError(f"{name} is damaged: {type(error).__name__}: {error}") from error
    if hashlib.sha256(canonical(document)).hexdigest() != digest:
        raise DamagedRecordError(f"{name} is damaged: its content does not match its checksum")
    return document


class Ledger:
    """All records of a collection."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    @staticmethod
    def _name(stage: str, capture: str, state: str) -> str:
        return f"ledger/{stage}/{state}/{quote(capture, safe='')}.json"

    def read(self, stage: str, capture: str, state: str = DONE) -> Record | None:
        """Return the record, or None; a damaged one raises DamagedRecordError."""
        try:
            data = self._storage.read(self._name(stage, capture, state))
        except FileNotFoundError:
            return None
        return self._parsed(data, stage, capture, state)

    def _parsed(self, data: bytes, stage: str, capture: str, state: str) -> Record:
        name = self._name(stage, capture, state)
        try:
            record = Record(**unsealed(data, name))
        except TypeError as error:
            raise DamagedRecordError(f"{name} is no record: {error}") from error
        if (record.stage, record.capture, record.state) != (stage, capture, state):
            raise DamagedRecordError(f"{name} is a record of {record.stage} of {record.capture}")
        return record

    def find(self, stage: str, capture: str, state: str = DONE) -> Record | None:
        """Return the record if it is there and whole."""
        try:
            return self.read(stage, capture, state)
        except DamagedRecordError:
            return None

    def write(self, record: Record) -> None:
        """Commit: from here on, the (stage, capture) is done (or failed)."""
        self._storage.write(self._name(record.stage, record.capture, record.state), sealed(asdict(record)))
        if record.state == DONE:
            for old in (FAILED, DAMAGED):
                self.remove(record.stage, record.capture, old)

    def remove(self, stage: str, capture: str, state: str = DONE) -> None:
        """Take a record away, before its region is written again."""
        self._storage.remove(self._name(stage, capture, state))

    def move(self, record: Record, state: str) -> None:
        """Give a record another state: a damaged one is kept for the report, but its capture is no longer done."""
        self.remove(record.stage, record.capture, record.state)
        self.write(replace(record, state=state))

    def captures(self, stage: str, state: str = DONE) -> list[str]:
        """Captures that have a record, whole or not."""
        folder = f"ledger/{stage}/{state}"
        return [unquote(name.removesuffix(".json")) for name in self._storage.names(folder) if name.endswith(".json")]

    def fingerprints(self, stage: str) -> dict[str, str]:
        """Fingerprint of everything that is done of a stage, by capture: a small part of the records."""
        return {name: record.fingerprint for name, record in self.each(stage) if isinstance(record, Record)}

    def records(self, stage: str, state: str = DONE) -> dict[str, Record]:
        """Whole records of a stage, by capture."""
        return {name: record for name, record in self.each(stage, state) if isinstance(record, Record)}

    def each(self, stage: str, state: str = DONE) -> Iterator[tuple[str, Record | DamagedRecordError]]:
        """Every capture that has a record, with the record, or with what is wrong with it."""
        known = self.captures(stage, state)
        for first in range(0, len(known), _BATCH):
            captures = known[first : first + _BATCH]
            files = {capture: self._name(stage, capture, state) for capture in captures}
            contents = self._storage.read_many(list(files.values()))
            for capture, file in files.items():
                if file in contents:
                    try:
                        yield capture, self._parsed(contents[file], stage, capture, state)
                    except DamagedRecordError as error:
                        yield capture, error
