"""The lease of a run on an object store: an object that its holder writes anew every few seconds."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator

from lfflow.collection.storage import RemoteStorage
from lfflow.errors import CollectionError

NAME = "leases/run"
BEAT_SECONDS = 3.0
PATIENCE_SECONDS = 15.0
"""A lease that is not written anew for so long belongs to nobody."""
SETTLE_SECONDS = 1.0
"""Two that take over one stale lease both look again after so long: the one whose object stayed has it."""


class Tenure:
    """What the holder of a run's lease knows about it."""

    def __init__(self) -> None:
        self.lost = False


@contextlib.contextmanager
def object_lease(storage: RemoteStorage, machine: str) -> Iterator[Tenure]:
    """Hold the collection at a URL for one run; raises CollectionError that says who holds it.

    The caller has the lock of its own machine already: an object that this machine left is that of a dead process.
    When another takes the lease over, because this process slept for too long, `Tenure.lost` becomes true.
    """
    token = {"token": uuid.uuid4().hex, "pid": os.getpid(), "host": socket.gethostname(), "machine": machine,
             "since": time.strftime("%Y-%m-%d %H:%M:%S")}  # fmt: skip
    _acquire(storage, token)
    tenure, stop = Tenure(), threading.Event()
    beating = threading.Thread(target=_beat, args=(storage, token, tenure, stop), name="lfflow-run", daemon=True)
    beating.start()
    try:
        yield tenure
    finally:
        stop.set()
        beating.join()
        if not tenure.lost:
            storage.remove(NAME)


def _acquire(storage: RemoteStorage, token: dict[str, object]) -> None:
    found = _content(storage)
    if found is not None:
        if found.get("machine") != token["machine"]:
            _watch(storage, found)
        storage.remove(NAME)
    created = storage.create(NAME, _encoded(token, 0))
    if found is not None:
        time.sleep(SETTLE_SECONDS)
    holder = _content(storage)
    if not created or holder is None or holder.get("token") != token["token"]:
        raise CollectionError(f"another run works on {storage.url} ({_named(holder)})")


def _watch(storage: RemoteStorage, found: dict[str, object]) -> None:
    """Return when the holder's heart has stood still for long enough; raises CollectionError when it beats."""
    limit = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < limit:
        time.sleep(min(1.0, PATIENCE_SECONDS / 4))
        now = _content(storage)
        if now is not None and now != found:
            raise CollectionError(f"another run works on {storage.url} ({_named(now)})")


def _beat(storage: RemoteStorage, token: dict[str, object], tenure: Tenure, stop: threading.Event) -> None:
    beat = 0
    while not stop.wait(BEAT_SECONDS):
        beat += 1
        with contextlib.suppress(OSError):
            holder = _content(storage)
            if holder is None or holder.get("token") != token["token"]:
                tenure.lost = True
                return
            storage.write(NAME, _encoded(token, beat))


def _encoded(token: dict[str, object], beat: int) -> bytes:
    return json.dumps({**token, "beat": beat}).encode()


def _content(storage: RemoteStorage) -> dict[str, object] | None:
    try:
        content = json.loads(storage.read(NAME))
    except (FileNotFoundError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _named(holder: dict[str, object] | None) -> str:
    if holder is None:
        return "unknown process"
    return f"process {holder.get('pid')} on {holder.get('host')} since {holder.get('since')}"
