"""``ds.lf`` is there as soon as both lfflow and xarray are imported, in whichever order.

Importing xarray with lfflow would make ``lfflow --help`` wait for it. So where xarray is not imported yet, a finder on
`sys.meta_path` waits until it is, and registers the accessor right after.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

_ACCESSOR = "lfflow.accessor"


def register_accessor() -> None:
    """Register ``.lf`` now, or right after xarray is imported."""
    if "xarray" in sys.modules:
        importlib.import_module(_ACCESSOR)
    else:
        sys.meta_path.insert(0, _AfterXarray())


class _AfterXarray(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        del path, target  # xarray is a package at the top
        if fullname != "xarray":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            spec.loader = _Registering(spec.loader)
        return spec


class _Registering(Loader):
    """Loader of xarray that registers the accessor when it is done, and then is out of the way."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        module.__loader__ = self._loader
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        importlib.import_module(_ACCESSOR)
