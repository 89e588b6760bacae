"""Leases on a piece of work: file locks that the kernel releases when their process dies.

A lock file says who holds it (process, machine) and, every few seconds, that its holder lives. On one machine the lock
alone decides: a lock that can be had belonged to a process that is dead. A file system that several machines share may
keep each machine's locks to itself, and a lock file left by another machine may be that of a power cut: so the
heartbeat of another machine's lock is watched for a while before it is taken over. A file that was left behind also
says whose death it is: a capture whose process died again and again is found by it (`abandoned`).

A collection on an object store has the locks of its captures on the machine that works, for results are the same bits
whoever writes them; the lease of the whole run is an object with a heartbeat beside it (`object_lease`).
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import quote, unquote

from lfflow.collection.object_lease import Tenure, object_lease
from lfflow.collection.storage import LocalStorage, RemoteStorage, Storage
from lfflow.errors import CollectionError

BEAT_SECONDS = 2.0
PATIENCE_SECONDS = 12.0
"""A holder on another machine whose heartbeat stands still for so long is dead."""
_POLL_SECONDS = 0.05


@dataclass(slots=True)
class Holder:
    """Who holds a lease; `deaths` counts the holders before it that died with it."""

    pid: int
    host: str
    machine: str
    since: str
    beat: int = 0
    deaths: int = 0

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host} since {self.since}"


def _machine() -> str:
    """Name of the kernel that runs: containers on it share its locks, the same host after a restart does not."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return socket.gethostname()


def _myself(deaths: int) -> Holder:
    return Holder(os.getpid(), socket.gethostname(), _machine(), time.strftime("%Y-%m-%d %H:%M:%S"), deaths=deaths)


def _read(path: Path) -> Holder | None:
    try:
        return Holder(**json.loads(path.read_bytes()))
    except (OSError, ValueError, TypeError):
        return None


class _Heart:
    """One thread of this process that keeps the heartbeat of every lock file that is held going."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._held: dict[int, Holder] = {}
        self._thread: threading.Thread | None = None

    def add(self, descriptor: int, holder: Holder) -> None:
        with self._guard:
            self._held[descriptor] = holder
            os.ftruncate(descriptor, 0)
            self._write(descriptor, holder)
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._beat, name="lfflow-leases", daemon=True)
                self._thread.start()

    def remove(self, descriptor: int) -> None:
        with self._guard:
            del self._held[descriptor]

    def _beat(self) -> None:
        while True:
            time.sleep(BEAT_SECONDS)
            with self._guard:
                for descriptor, holder in self._held.items():
                    holder.beat += 1
                    with contextlib.suppress(OSError):
                        self._write(descriptor, holder)
                        os.fsync(descriptor)

    @staticmethod
    def _write(descriptor: int, holder: Holder) -> None:
        os.pwrite(descriptor, json.dumps(asdict(holder)).encode(), 0)


_HEART = _Heart()


def _folder(storage: Storage) -> Path:
    """Folder of the locks: in the collection, or, for a remote one, on this machine."""
    if isinstance(storage, LocalStorage):
        return storage.root / "leases"
    key = hashlib.sha256(storage.url.encode()).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"lfflow-leases-{os.getuid()}" / key


def _path(storage: Storage, stage: str, capture: str) -> Path:
    return _folder(storage) / stage / quote(capture, safe="")


def _try_lock(path: Path) -> int | None:
    """Descriptor of the locked file, or None when another holds it.

    The file may be removed by its former holder between open and lock: then the lock is on a file that nobody else
    can find, and is not worth anything.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_ino == path.stat().st_ino and not _lives_elsewhere(path):
            return descriptor
    except (BlockingIOError, FileNotFoundError):
        pass
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


def _lives_elsewhere(path: Path) -> bool:
    """Whether the lock file belongs to a process of another machine whose heart beats."""
    content, holder = path.read_bytes(), _read(path)
    if not content or (holder is not None and holder.machine == _machine()):
        return False
    limit = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < limit:
        time.sleep(min(BEAT_SECONDS, PATIENCE_SECONDS) / 2)
        if path.read_bytes() != content:
            return True
    return False


@contextlib.contextmanager
def _held(path: Path, descriptor: int) -> Iterator[None]:
    former = _read(path)
    try:
        _HEART.add(descriptor, _myself(former.deaths + 1 if former else 0))
        try:
            yield
        finally:
            _HEART.remove(descriptor)
            path.unlink(missing_ok=True)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def lease(storage: Storage, stage: str, capture: str, *, timeout: float = 3600.0) -> Iterator[None]:
    """Hold the lease of one (stage, capture); waits for another holder, at most `timeout` seconds."""
    path = _path(storage, stage, capture)
    limit = time.monotonic() + timeout
    while (descriptor := _try_lock(path)) is None:
        if time.monotonic() > limit:
            raise CollectionError(f"{stage} of {capture} is held by another process ({_read(path) or 'unknown'})")
        time.sleep(_POLL_SECONDS)
    with _held(path, descriptor):
        yield


@contextlib.contextmanager
def run_lease(storage: Storage) -> Iterator[Tenure]:
    """Hold the collection for one run; raises CollectionError that says who holds it."""
    path = _folder(storage) / "run"
    for _ in range(20):
        descriptor = _try_lock(path)
        if descriptor is not None:
            break
        time.sleep(0.01)
    if descriptor is None:
        raise CollectionError(f"another run works on {storage.url} ({_read(path) or 'unknown process'})")
    with _held(path, descriptor):
        if isinstance(storage, RemoteStorage):
            with object_lease(storage, _machine()) as tenure:
                yield tenure
        else:
            yield Tenure()


def abandoned(storage: Storage) -> dict[str, int]:
    """How often in a row the process of a capture died while it worked on it; only for the holder of the run's lease.

    A lock file that nobody removed is that of a process that died, by its own fault or because it was killed.
    """
    deaths: dict[str, int] = {}
    folder = _folder(storage)
    for path in sorted(folder.glob("*/*")):
        holder = _read(path)
        if holder is not None:
            capture = unquote(path.name)
            deaths[capture] = max(deaths.get(capture, 0), holder.deaths + 1)
    return deaths
