"""A forward model of a plenoptic camera: scene, optics, lens array, sensor, files, and the truth beside them."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfflow.simulate.capture import simulate_capture, simulate_white
    from lfflow.simulate.collection import open_truth, simulate_collection
    from lfflow.simulate.from_views import simulate_from_views
    from lfflow.simulate.hard import hard_scene
    from lfflow.simulate.natural import natural_scene
    from lfflow.simulate.optics import Optics
    from lfflow.simulate.scene import Layer, Scene, Texture

_HOME = {
    "simulate_capture": "lfflow.simulate.capture",
    "simulate_white": "lfflow.simulate.capture",
    "open_truth": "lfflow.simulate.collection",
    "simulate_collection": "lfflow.simulate.collection",
    "simulate_from_views": "lfflow.simulate.from_views",
    "hard_scene": "lfflow.simulate.hard",
    "natural_scene": "lfflow.simulate.natural",
    "Optics": "lfflow.simulate.optics",
    "Layer": "lfflow.simulate.scene",
    "Scene": "lfflow.simulate.scene",
    "Texture": "lfflow.simulate.scene",
}

__all__ = [
    "Layer",
    "Optics",
    "Scene",
    "Texture",
    "hard_scene",
    "natural_scene",
    "open_truth",
    "simulate_capture",
    "simulate_collection",
    "simulate_from_views",
    "simulate_white",
]


def __getattr__(name: str) -> Any:
    """Import the public functions when they are first used: numba and scipy are slow to import."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'lfflow.simulate' has no attribute {name!r}")
