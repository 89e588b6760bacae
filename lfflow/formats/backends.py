"""The xarray engines: ``xr.open_dataset(path, engine="lfp")``; listed as entry points in pyproject.toml."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any, ClassVar

import xarray as xr
from xarray.backends import BackendEntrypoint

from lfflow.formats.container import is_container
from lfflow.formats.errors import UnknownFormatError, UnreadableError
from lfflow.formats.eslf import open_eslf
from lfflow.formats.lfp import Image
from lfflow.formats.opening import is_address, open_picture
from lfflow.formats.png import SIGNATURE
from lfflow.formats.raw_pair import is_pair
from lfflow.formats.region import open_binary
from lfflow.formats.tar import is_tar
from lfflow.formats.toolbox import is_toolbox, open_toolbox
from lfflow.formats.views import is_view_folder, open_views

_HEAD_BYTES = 512


class LfpEntrypoint(BackendEntrypoint):
    """Engine "lfp": pictures in LFP containers."""

    description: ClassVar[str] = "Lytro pictures (.lfp, .lfr, .RAW with .TXT, members of calibration archives)"
    open_dataset_parameters: ClassVar[tuple[str, ...]] = (
        "filename_or_obj", "drop_variables", "image", "accept_damaged",
    )  # fmt: skip

    def open_dataset(
        self,
        filename_or_obj: Any,
        *,
        drop_variables: str | Iterable[str] | None = None,
        image: Image = "raw",
        accept_damaged: bool = False,
    ) -> xr.Dataset:
        """Open a picture lazily; see `lfflow.formats.opening.open_picture`."""
        ds = open_picture(path_of(filename_or_obj), image=image, accept_damaged=accept_damaged)
        return without(ds, drop_variables)

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether the file begins as an LFP container or a tar, is half of a RAW + TXT pair, or is in an archive."""
        head = head_of(filename_or_obj)
        if is_container(head) or is_tar(head):
            return True
        if not isinstance(filename_or_obj, str | os.PathLike):
            return False
        return is_pair(filename_or_obj) or is_address(os.fspath(filename_or_obj))


class ViewsEntrypoint(BackendEntrypoint):
    """Engine "views": folders of view images."""

    description: ClassVar[str] = "Folders of view images (HCI names)"
    open_dataset_parameters: ClassVar[tuple[str, ...]] = ("filename_or_obj", "drop_variables")

    def open_dataset(self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None) -> xr.Dataset:
        """Open a folder lazily; see `lfflow.formats.views.open_views`."""
        return without(open_views(path_of(filename_or_obj)), drop_variables)

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether it is a folder with view images in it."""
        return isinstance(filename_or_obj, str | os.PathLike) and is_view_folder(filename_or_obj)


class EslfEntrypoint(BackendEntrypoint):
    """Engine "eslf": lenslet pictures."""

    description: ClassVar[str] = "Lenslet pictures (Stanford's _eslf.png)"
    open_dataset_parameters: ClassVar[tuple[str, ...]] = ("filename_or_obj", "drop_variables", "views")

    def open_dataset(
        self,
        filename_or_obj: Any,
        *,
        drop_variables: str | Iterable[str] | None = None,
        views: int | None = None,
    ) -> xr.Dataset:
        """Open a picture lazily; see `lfflow.formats.eslf.open_eslf`."""
        return without(open_eslf(path_of(filename_or_obj), views=views), drop_variables)

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether it is a PNG whose name ends as Stanford's do."""
        if head_of(filename_or_obj)[:8] != SIGNATURE:
            return False
        return str(filename_or_obj).lower().endswith("eslf.png")


class ToolboxEntrypoint(BackendEntrypoint):
    """Engine "lftoolbox": light fields of LFToolbox."""

    description: ClassVar[str] = "Light fields of LFToolbox (.mat)"
    open_dataset_parameters: ClassVar[tuple[str, ...]] = ("filename_or_obj", "drop_variables")

    def open_dataset(self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None) -> xr.Dataset:
        """Open a file lazily; see `lfflow.formats.toolbox.open_toolbox`."""
        return without(open_toolbox(path_of(filename_or_obj)), drop_variables)

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether the file begins as a MATLAB file of version 5."""
        return is_toolbox(head_of(filename_or_obj))


def path_of(filename_or_obj: Any) -> str:
    """Path that an engine was asked to open."""
    if isinstance(filename_or_obj, str | os.PathLike):
        return os.fspath(filename_or_obj)
    raise UnknownFormatError(str(filename_or_obj)[:80], "input", type(filename_or_obj).__name__, "a path")


def head_of(filename_or_obj: Any) -> bytes:
    """First bytes of a file; none where it cannot be read."""
    if not isinstance(filename_or_obj, str | os.PathLike):
        return b""
    try:
        with open_binary(os.fspath(filename_or_obj)) as file:
            return file.read(_HEAD_BYTES)
    except UnreadableError:
        return b""


def without(ds: xr.Dataset, names: str | Iterable[str] | None) -> xr.Dataset:
    """Dataset without some variables, as xarray's `drop_variables` asks."""
    if names is None:
        return ds
    dropped = [names] if isinstance(names, str) else list(names)
    return ds.drop_vars([name for name in dropped if name in ds.variables])
