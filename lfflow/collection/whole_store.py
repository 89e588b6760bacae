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
        Names of the arrays, without their group, of which every chunk that is read must be there.
    """

    def __init__(self, store: Store, arrays: Iterable[str]) -> None:
        super().__init__(store)
        self._arrays = frozenset(arrays)

    def _with_store(self, store: Store) -> WholeStore:
        return WholeStore(store, self._arrays)

    async def get(self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None) -> Buffer | None:
        """Content of a key, or the part of it that is asked for; None where there is none and none is needed."""
        found: Buffer | None = await self._store.get(key, prototype, byte_range)
        array, chunk, _ = key.partition("/c/")
        if found is None and chunk and array.rpartition("/")[2] in self._arrays:
            raise MissingRegionError(
                f"{key} of {self._store} is lost: lfflow validate says what else is, and the next run makes it anew"
            )
        return found
