"""Finished light fields of a made-up camera, written as a run writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from lfflow.collection import Collection, catalogue
from lfflow.collection.records import DONE, Record
from lfflow.schema import PARAMETERS

GROUP = "T1-40x40"
SIZES = {"v": 3, "u": 3, "t": 4, "s": 5}
DIMS = ("v", "u", "t", "s")


def lightfield(seed: int) -> xr.Dataset:
    """A light field of chance."""
    rng = np.random.default_rng(seed)
    shape = tuple(SIZES.values())
    return xr.Dataset(
        {
            "mosaic": (DIMS, rng.random(shape).astype("float32")),
            "cfa": (DIMS, rng.integers(0, 3, shape).astype("uint8")),
            "weight": (DIMS, rng.random(shape).astype("float32")),
        },
        coords={
            **dict.fromkeys(PARAMETERS, 1.5), "arrangement": np.uint8(0), "iso": 100.0 * seed,
            "view_usable": (("v", "u"), np.ones((3, 3), bool)),
            "v": np.arange(3) - 1, "u": np.arange(3) - 1, "t": np.arange(4), "s": np.arange(5),
        },
    )  # fmt: skip


def finish(where: Path | str, *captures: str, group: str = GROUP) -> Collection:
    """Collection in which the light fields of these captures are finished."""
    collection = Collection(where)
    store = collection.store("lightfield")
    slots = store.ensure(group, SIZES, list(captures))
    for capture in captures:
        if collection.ledger.find("lightfield", capture) is not None:
            continue
        ds = lightfield(sum(map(ord, capture)) % 97 + 1)
        files = store.write(group, slots[capture], ds)
        collection.ledger.write(Record(
            "lightfield", capture, DONE, f"mark of {capture}", {"path": f"/in/{capture}.lfp", "sha256": capture},
            group=group, slot=slots[capture], files=files, scalars=store.scalars(ds),
        ))  # fmt: skip
    done = {name: r for name, r in collection.ledger.records("lightfield").items() if r.group == group}
    store.finalise(group, done)
    known = {row["id"]: row for row in catalogue.rows_of(catalogue.load(collection.storage))}
    rows = [known.get(name) or {"id": name, "path": f"/in/{name}.lfp", "sha256": name, "kind": "scene",
                                "white": "self", "group": group, "judged_by": "camera"}
            for name in {*known, *captures}]  # fmt: skip
    catalogue.save(collection.storage, catalogue.frame(rows))
    return collection
