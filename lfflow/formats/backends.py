"""The xarray engines: ``xr.open_dataset(path, engine="lfp")``; listed as entry points in pyproject.toml."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

import xarray as xr
from xarray.backends import BackendEntrypoint

from lfflow.formats.container import is_container
from lfflow.formats.errors import UnknownFormatError
from lfflow.formats.lfp import Image
from lfflow.formats.opening import is_address, open_picture
from lfflow.formats.raw_pair import is_pair


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
        """Whether the file begins as an LFP container, is one of a RAW + TXT pair, or a member of an archive."""
        if is_container(head_of(filename_or_obj)):
            return True
        if not isinstance(filename_or_obj, str | os.PathLike):
            return False
        return is_pair(filename_or_obj) or is_address(os.fspath(filename_or_obj))


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
        with Path(filename_or_obj).open("rb") as file:
            return file.read(16)
    except (OSError, ValueError):
        return b""


def without(ds: xr.Dataset, names: str | Iterable[str] | None) -> xr.Dataset:
    """Dataset without some variables, as xarray's `drop_variables` asks."""
    if names is None:
        return ds
    dropped = [names] if isinstance(names, str) else list(names)
    return ds.drop_vars([name for name in dropped if name in ds.variables])
