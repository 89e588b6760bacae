"""Reads a collection again and again while it is made: the process that would see a half-written capture.

Prints a line for every capture that reads as finished and has not the values of the whole collection, or that cannot be
read; ends when its standard input is closed.
"""

from __future__ import annotations

import select
import sys

import numpy as np

from lfflow.collection import open_collection
from lfflow.errors import CollectionError

WATCHED = {"calibration": "vignetting", "lightfield": "mosaic", "disparity": "disparity"}


def values(collection, kind):
    try:
        ds = collection.open(kind, chunks=None)
    except CollectionError as error:
        if "nothing in" in str(error):
            return {}
        raise
    return {str(name): ds[WATCHED[kind]].sel(capture=name).values for name in ds["capture"].values}


def look(out, whole):
    try:
        collection = open_collection(out)
    except CollectionError:
        return 0
    seen = 0
    for kind in WATCHED:
        for capture, found in values(collection, kind).items():
            seen += 1
            if not np.array_equal(found, whole[kind][capture], equal_nan=True):
                sys.stdout.write(f"{kind} of {capture} is half-written\n")
    return seen


def main() -> None:
    whole, out = sys.argv[1:3]
    expected = {kind: values(open_collection(whole), kind) for kind in WATCHED}
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    looks = seen = 0
    while not select.select([sys.stdin], [], [], 0.02)[0]:
        seen += look(out, expected)
        looks += 1
    sys.stdout.write(f"looked {looks} times at {seen} finished results\n")


if __name__ == "__main__":
    main()
