"""Disparity of the central view (METHOD 8)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.kernels.match_field import match_pairs
from lfflow.kernels.mosaic_field import MosaicField
from lfflow.schema import DISPARITY
from lfflow.stages.costs import Pair, default_hypotheses
from lfflow.stages.on_field import carried_coords, on_field

_OUTPUTS = [(("t", "s"), "float32"), (("t", "s"), "float32"), (("t", "s"), "uint8")]


def disparity(
    lf: xr.Dataset,
    *,
    pairs: Sequence[Pair] | None = None,
    hypotheses: Sequence[float] | npt.NDArray[np.floating] | None = None,
    sigma: float = 1.5,
    **options: Any,
) -> xr.Dataset:
    """Disparity of the central view of a light field, mosaicked or in full colour."""
    if "rgb" in lf.data_vars and "mosaic" not in lf.data_vars:
        from lfflow.stages.view_matching import disparity_of_views

        result: xr.Dataset = disparity_of_views(lf, **options)
        return result
    chosen = list(pairs) if pairs is not None else [(a, 0) for a in (-4, -2, 2, 4)]
    labels = np.asarray(default_hypotheses(chosen) if hypotheses is None else hypotheses, dtype=np.float64)

    def match(field: MosaicField) -> tuple[npt.NDArray[Any], ...]:
        return match_pairs(field, chosen, labels, sigma)

    found = on_field(match, lf, _OUTPUTS, {})
    out = xr.Dataset(dict(zip(("disparity", "disparity_std", "flags"), found, strict=True)))
    out = out.assign_coords({**carried_coords(lf, ("t", "s")), "u": 0, "v": 0})
    return DISPARITY.annotate(out)
