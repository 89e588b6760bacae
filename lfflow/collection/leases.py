"""Leases on a piece of work: file locks that the kernel releases when their process dies."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from lfflow.collection.storage import LocalStorage, Storage
from lfflow.errors import CollectionError

_POLL_SECONDS = 0.05


def _folder(storage: Storage) -> Path:
    """Folder of the locks: in the collection, or, for a remote one, on this machine."""
    if isinstance(storage, LocalStorage):
        return storage.root / "leases"
    key = hashlib.sha256(storage.url.encode()).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"lfflow-leases-{os.getuid()}" / key


def _try_lock(path: Path) -> int | None:
    """Descriptor of the locked file, or None when another holds it.

    The file may be removed by its former holder between open and lock: then the lock is on a file that nobody else
    can find, and is not worth anything.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_ino == path.stat().st_ino:
            return descriptor
    except (BlockingIOError, FileNotFoundError):
        pass
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


@contextlib.contextmanager
def _held(path: Path, descriptor: int) -> Iterator[None]:
    holder = {"pid": os.getpid(), "host": socket.gethostname(), "since": time.strftime("%Y-%m-%d %H:%M:%S")}
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(holder).encode(), 0)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)


@contextlib.contextmanager
def lease(storage: Storage, stage: str, capture: str, *, timeout: float = 3600.0) -> Iterator[None]:
    """Hold the lease of one (stage, capture); waits for another holder, at most `timeout` seconds."""
    path = _folder(storage) / stage / quote(capture, safe="")
    limit = time.monotonic() + timeout
    while (descriptor := _try_lock(path)) is None:
        if time.monotonic() > limit:
            raise CollectionError(f"{stage} of {capture} is held by another process ({_holder(path)})")
        time.sleep(_POLL_SECONDS)
    with _held(path, descriptor):
        yield


@contextlib.contextmanager
def run_lease(storage: Storage) -> Iterator[None]:
    """Hold the collection for one run; raises CollectionError that says who holds it."""
    path = _folder(storage) / "run"
    for _ in range(20):
        descriptor = _try_lock(path)
        if descriptor is not None:
            break
        time.sleep(0.01)
    if descriptor is None:
        raise CollectionError(f"another run works on {storage.url} ({_holder(path)})")
    with _held(path, descriptor):
        yield


def _holder(path: Path) -> str:
    try:
        holder = json.loads(path.read_text())
        return f"process {holder['pid']} on {holder['host']} since {holder['since']}"
    except (OSError, ValueError, KeyError):
        return "unknown process"
