"""A zarr store in which a missing region is an error: zarr itself would read it as fill values."""

from __future__ import annotations

from collections.abc import Iterable

from zarr.abc.store import ByteRequest, Store
from zarr.core.buffer import Buffer, BufferPrototype
from zarr.storage import WrapperStore

from lfflow.errors import CollectionError


class MissingRegionError(CollectionError):
    """A file that the ledger counts on is not there."""


class WholeStore(WrapperStore[Store]):
    """For readers of what is finished: all chunks of the named arrays were written, so that a missing one is lost.

    Parameters
    ----------
    store
        The store.
    arrays
        Names of the arrays, without their group, of which everything that is read must be there, whatever its name: a
        hit byte in the metadata of an array can make zarr look for its chunks elsewhere.
    """

    def __init__(self, store: Store, arrays: Iterable[str]) -> None:
        super().__init__(store)
        self._arrays = frozenset(arrays)

    def _with_store(self, store: Store) -> WholeStore:
        return WholeStore(store, self._arrays)

    async def get(self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None) -> Buffer | None:
        """Content of a key, or the part of it that is asked for; None where there is none and none is needed."""
        found: Buffer | None = await self._store.get(key, prototype, byte_range)
        _, array, *rest = *key.split("/"), ""
        if found is None and array in self._arrays and rest[0] != "zarr.json" and not rest[0].startswith("."):
            raise MissingRegionError(
                f"{key} of {self._store} is lost: lfflow validate says what else is, and the next run makes it anew"
            )
        return found
