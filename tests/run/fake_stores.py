"""The content of a collection's stores, for comparison."""

from __future__ import annotations

import hashlib
from pathlib import Path


def store_content(collection: Path) -> dict[str, str]:
    """sha256 of every file of the zarr stores."""
    return {
        str(path.relative_to(collection)): hashlib.sha256(path.read_bytes()).hexdigest()
        for store in sorted(collection.glob("*.zarr"))
        for path in sorted(store.rglob("*"))
        if path.is_file()
    }
