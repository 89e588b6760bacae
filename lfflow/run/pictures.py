"""The pictures of finished captures, drawn into the collection: after each task, or on demand."""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path

from lfflow.collection import Collection
from lfflow.run.chain import CHAIN, Chain

FOLDER = "quicklook"
_drawing = threading.Lock()


def picture_name(capture: str) -> str:
    """Name of the picture of a capture in its collection."""
    return f"{FOLDER}/{capture}.png"


def draw(collection: Collection, capture: str, chain: Chain = CHAIN, threads: int = 1) -> None:
    """Draw a capture, if its light field and its disparity are finished, and keep the picture in the collection."""
    lightfield, disparity = (collection.ledger.find(stage, capture) for stage in ("lightfield", "disparity"))
    if chain.draw is None or lightfield is None or disparity is None:
        return
    with _drawing, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        pair = collection.store("lightfield").read(lightfield), collection.store("disparity").read(disparity)
        chain.draw(*pair, str(path), threads)
        collection.storage.write(picture_name(capture), path.read_bytes())


def draw_missing(
    collection: Collection, *, where: str = "", force: bool = False, chain: Chain = CHAIN
) -> tuple[list[str], dict[str, str]]:
    """Draw the finished captures that have no picture yet; with `force` all of them.

    Returns
    -------
    captures : list of str
        All selected captures that have a picture, old or new.
    failed : dict
        Reason for every capture that could not be drawn.
    """
    there = set(collection.storage.names(FOLDER))
    table = collection.table(where)
    captures, failed = [], {}
    for capture in map(str, table["id"][table["disparity_state"] == "done"]):
        try:
            if force or picture_name(capture).rpartition("/")[2] not in there:
                draw(collection, capture, chain)
            captures.append(capture)
        except Exception as error:  # noqa: BLE001 - one capture must not stop the others
            failed[capture] = f"{type(error).__name__}: {error}"
    return captures, failed
