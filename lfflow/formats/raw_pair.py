"""Bare sensor frames: ``MOD_0001.RAW`` and its JSON beside it (``MOD_0001.TXT`` or ``.json``), of both cameras.

Neither file carries a checksum. A wrong length is noticed; a flipped bit in the samples cannot be, one in the JSON only
where it breaks the text or a needed value. Who keeps such files should keep their sha256 too, as a catalogue does.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lfflow.formats.bounded_json import EMPTY, Document, at, check_json_size, parse_json, write_json
from lfflow.formats.errors import StructureError, UnreadableError
from lfflow.formats.frame import Frame
from lfflow.formats.lfp import frame_region, packed_frame, tags_of
from lfflow.formats.metadata import FrameMetadata, frame_metadata
from lfflow.formats.region import Region
from lfflow.formats.writing import written_whole

_RAW = (".raw", ".RAW", ".Raw")
_DOCUMENTS = (".TXT", ".txt", ".json", ".JSON")


def is_pair(path: str | os.PathLike[str]) -> bool:
    """Whether a path is either half of a RAW + TXT pair that is there."""
    return pair_of(path) is not None


def pair_of(path: str | os.PathLike[str]) -> tuple[Path, Path] | None:
    """The .RAW and its text, given by either half; None when it is no pair."""
    return _halves(Path(path))


def open_pair(path: str | os.PathLike[str]) -> Frame:
    """Frame of a RAW + TXT pair, given by either half.

    Raises
    ------
    FileFormatError
        If a half is missing, or they contradict each other.
    """
    halves = pair_of(path)
    if halves is None:
        raise StructureError(os.fspath(path), "pair", "one half only", "a .RAW and its .TXT or .json beside it")
    raw, document = (os.path.abspath(half) for half in halves)  # noqa: PTH100
    return paired_frame(Path(raw).stem, _whole(raw, "image"), _whole(document, "metadata"))


def paired_frame(capture: str, image: Region, text: Region, damaged: tuple[str, ...] = ()) -> Frame:
    """Frame from the bytes of its samples and of its JSON, wherever they lie.

    The JSON is the camera's own (``master.picture.frameArray[0].frame``), or just the frame's metadata.
    """
    parsed, documents = _parsed(text, f"metadata of {image.name}")
    region = frame_region(image, image.name, parsed.layout.size)
    return Frame(capture, region, parsed, documents, damaged)


def document_metadata(path: str | os.PathLike[str]) -> FrameMetadata:
    """What the JSON of a frame says, where the frame itself is not there.

    Raises
    ------
    FileFormatError
        If it is no JSON, or not of a frame.
    """
    return _parsed(_whole(os.path.abspath(path), "metadata"), "metadata")[0]  # noqa: PTH100


def _parsed(text: Region, where: str) -> tuple[FrameMetadata, dict[str, Document]]:
    check_json_size(text.length, text.path, where)
    whole = parse_json(text.read(), text.path, where)
    master = at(whole.value, "master") or whole.value
    entry = at(master, "picture", "frameArray", 0, "frame")
    metadata = Document.of(at(entry, "metadata")) if entry is not None else whole
    private = Document.of(at(entry, "privateMetadata")) if entry is not None else EMPTY
    parsed = frame_metadata(metadata.value, private.value, tags_of(master), text.path)
    return parsed, {"metadata": metadata, "private_metadata": private, "document": whole}


def write_pair(
    path: str | os.PathLike[str],
    raw: npt.NDArray[np.uint16],
    metadata: Mapping[str, Any],
    private_metadata: Mapping[str, Any] | None = None,
    *,
    white: bool = True,
    dark: bool = False,
) -> None:
    """Write ``path`` (``.RAW``) and its ``.TXT``; parameters as in `lfflow.formats.lfp.write_lfp`."""
    target = Path(path)
    image, text = pair_bytes(raw, metadata, private_metadata or {}, white=white, dark=dark, path=os.fspath(path))
    for name, data in ((target, image), (target.with_suffix(".TXT"), text)):
        with written_whole(name) as file:
            file.write(data)


def pair_bytes(
    raw: npt.NDArray[np.uint16],
    metadata: Mapping[str, Any],
    private_metadata: Mapping[str, Any],
    *,
    white: bool = True,
    dark: bool = False,
    path: str = "MOD",
) -> tuple[bytes, bytes]:
    """Contents of the .RAW and the .TXT of a frame."""
    frame = {"metadata": dict(metadata), "privateMetadata": dict(private_metadata), "imageRef": "unknown"}
    tags = {"darkFrame": dark, "modulationFrame": white}
    entry = {"frame": frame, "parameters": {"vendorContent": {"com.lytro.tags": tags}}}
    picture = {"viewArray": [], "accelerationArray": [], "frameArray": [entry], "derivationArray": []}
    document = {"master": {"version": {"major": 1, "minor": 0}, "picture": picture, "thumbnailArray": []}}
    return packed_frame(raw, metadata, private_metadata, path), write_json(document)


def _halves(path: Path) -> tuple[Path, Path] | None:
    suffixes = _DOCUMENTS if path.suffix in _RAW else _RAW if path.suffix in _DOCUMENTS else ()
    for suffix in suffixes:
        other = path.with_suffix(suffix)
        if path.is_file() and other.is_file():
            return (path, other) if path.suffix in _RAW else (other, path)
    return None


def _whole(path: str, name: str) -> Region:
    try:
        size = Path(path).stat().st_size
    except (OSError, ValueError) as error:
        raise UnreadableError(path, "file", str(error), "a readable file") from error
    return Region(path, name, 0, size)
