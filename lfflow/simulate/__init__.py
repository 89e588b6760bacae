"""A forward model of a plenoptic camera: scene, optics, lens array, sensor, files, and the truth beside them."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfflow.simulate.capture import simulate_capture, simulate_white

_HOME = {
    "simulate_capture": "lfflow.simulate.capture",
    "simulate_white": "lfflow.simulate.capture",
}

__all__ = ["simulate_capture", "simulate_white"]


def __getattr__(name: str) -> Any:
    """Import the public functions when they are first used: numba and scipy are slow to import."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'lfflow.simulate' has no attribute {name!r}")
