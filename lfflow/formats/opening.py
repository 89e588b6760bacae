"""One door for everything that a Lytro camera or its software wrote."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

import xarray as xr

from lfflow.formats.archives import SEPARATOR, archive_frame, is_storage
from lfflow.formats.bounded_json import at
from lfflow.formats.container import Container, is_container, open_container
from lfflow.formats.errors import UnsupportedError
from lfflow.formats.foreign import foreign
from lfflow.formats.frame import Frame
from lfflow.formats.lfp import FRAMES, IMAGES, Image, raw_frame
from lfflow.formats.raw_pair import is_pair, open_pair
from lfflow.formats.region import open_binary
from lfflow.formats.renderings import accelerations, rendering
from lfflow.formats.tar import is_tar

ContainerKind = Literal["raw", "rendering", "storage"]


def open_picture(path: str | os.PathLike[str], *, image: Image = "raw", accept_damaged: bool = False) -> xr.Dataset:
    """Lazy dataset of any single picture: raw (container, RAW + TXT, member of an archive) or derived (stack, depth).

    Parameters
    ----------
    path
        A file, or ``archive::member``.
    image
        "raw", or "modulation": the white image that an Illum picture embeds (also ``picture.lfr::modulation``).
    accept_damaged
        Read also what differs from its SHA-1; a raw dataset says so in ``attrs["damaged"]``.

    Raises
    ------
    FileFormatError
        The subclass says how the file is broken.
    """
    name = os.fspath(path)
    if not is_address(name) and is_container(_head(name)):
        container = open_container(os.path.abspath(name), accept_damaged=accept_damaged)  # noqa: PTH100
        if container_kind(container) == "rendering":
            return rendering(container)
    return open_frame(name, image=image, accept_damaged=accept_damaged).dataset()


def open_frame(path: str | os.PathLike[str], *, image: Image = "raw", accept_damaged: bool = False) -> Frame:
    """The sensor frame behind a path; parameters and errors as in `open_picture`."""
    name = os.fspath(path)
    if is_address(name):
        archive, _, member = name.rpartition(SEPARATOR)
        if member not in IMAGES:
            return archive_frame(name, accept_damaged=accept_damaged)
        return open_frame(
            archive, image="modulation" if member == "modulation" else "raw", accept_damaged=accept_damaged
        )
    if is_pair(name):
        return open_pair(name)
    head = _head(name)
    many = UnsupportedError(name, "file", "an archive of many images", f"one of them: {name}{SEPARATOR}MOD_NNNN.RAW")
    if is_tar(head):
        raise many
    if not is_container(head):
        raise foreign(name, head, "an LFP container, or a .RAW with its .TXT")
    container = open_container(os.path.abspath(name), accept_damaged=accept_damaged)  # noqa: PTH100
    if container_kind(container) == "storage":
        raise many
    return raw_frame(container, image)


def verify(path: str | os.PathLike[str]) -> None:
    """Read all bytes of a picture that stand under a SHA-1, and compare; RAW + TXT and tars carry none.

    Raises
    ------
    ChecksumError
        If a section is damaged.
    FileFormatError
        If the file is broken in another way.
    """
    name = os.fspath(path)
    if not is_address(name) and is_container(_head(name)):
        for section in open_container(os.path.abspath(name)).sections:  # noqa: PTH100
            section.region.verify()
    else:
        open_frame(name).region.verify()


def container_kind(container: Container) -> ContainerKind:
    """What a container holds; one whose image is elsewhere but whose pictures are here is a rendering."""
    if is_storage(container):
        return "storage"
    toc = container.toc.value
    references = (at(toc, *place, "frame", "imageRef") for place in FRAMES)
    if any(container.find_chunk(reference) for reference in references):
        return "raw"
    return "rendering" if accelerations(toc) else "raw"


def is_address(path: str) -> bool:
    """Whether a path is ``archive::member`` and not the name of a file."""
    return SEPARATOR in path and not Path(path).exists() and Path(path.rpartition(SEPARATOR)[0]).is_file()


def _head(path: str) -> bytes:
    with open_binary(path) as file:
        return file.read(512)
