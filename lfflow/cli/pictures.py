"""The pictures of a collection's finished captures: what `lfflow quicklook` and `lfflow report` share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfflow.collection.collection import Collection

FOLDER = "quicklook"


def draw_collection(where_is: Path, *, where: str = "", force: bool = False) -> tuple[list[Path], dict[str, str]]:
    """Draw the captures whose disparity is finished.

    Returns
    -------
    pictures : list of Path
        Of all selected captures that have one, old or new.
    failed : dict
        Reason for every capture that could not be drawn.
    """
    from lfflow.collection import open_collection

    collection = open_collection(where_is)
    selected = set(collection.query(where))
    folder = where_is / FOLDER
    folder.mkdir(exist_ok=True)
    drawn, failed = [], {}
    for camera in collection.store("disparity").groups():
        for capture in finished(collection, camera):
            if capture not in selected:
                continue
            path = folder / f"{capture}.png"
            try:
                if force or not path.exists():
                    _draw(collection, camera, capture, path)
                drawn.append(path)
            except Exception as error:  # noqa: BLE001 - one capture must not stop the others
                failed[capture] = f"{type(error).__name__}: {error}"
    return sorted(drawn), failed


def finished(collection: Collection, camera: str) -> list[str]:
    """Ids of the captures of a camera whose disparity is finished."""
    return [str(name) for name in collection.open("disparity", camera=camera)["capture"].values]


def _draw(collection: Collection, camera: str, capture: str, path: Path) -> None:
    from lfflow.viz.quicklook import draw_quicklook

    pair = [collection.open(kind, camera=camera).sel(capture=capture).load() for kind in ("lightfield", "disparity")]
    draw_quicklook(pair[0], pair[1], path)
