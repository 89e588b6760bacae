"""Raw plenoptic captures to labelled 4D light fields and disparity maps.

Axes, signs and units: `lfflow.conventions`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from lfflow.registration import register_accessor

if TYPE_CHECKING:
    from lfflow.collection import open_collection
    from lfflow.lattice import Lattice
    from lfflow.stages.calibrate import calibrate
    from lfflow.stages.costs import pair_costs
    from lfflow.stages.demultiplex import demultiplex
    from lfflow.stages.disparity import disparity
    from lfflow.stages.reconstruct import reconstruct_views
    from lfflow.stages.transpose import transpose_disparity

__version__ = "0.1.0"

_HOME = {
    "Lattice": "lfflow.lattice",
    "calibrate": "lfflow.stages.calibrate",
    "demultiplex": "lfflow.stages.demultiplex",
    "disparity": "lfflow.stages.disparity",
    "open_collection": "lfflow.collection",
    "pair_costs": "lfflow.stages.costs",
    "reconstruct_views": "lfflow.stages.reconstruct",
    "transpose_disparity": "lfflow.stages.transpose",
}

__all__ = [
    "Lattice",
    "calibrate",
    "demultiplex",
    "disparity",
    "open_collection",
    "pair_costs",
    "reconstruct_views",
    "transpose_disparity",
]


register_accessor()


def __getattr__(name: str) -> Any:
    """Import the public functions when they are first used: `lfflow --help` must not wait for scipy."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'lfflow' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
