"""The on-disk layout of a collection: catalogue, stores, ledger and leases."""

from lfflow.collection.collection import Collection, open_collection

__all__ = ["Collection", "open_collection"]
