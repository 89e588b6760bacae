"""Costs of pairs of mosaicked views (METHOD 8.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from lfflow.kernels.mosaicked.mosaic_field import MosaicField
from lfflow.kernels.mosaicked.pair_cost import INTERPOLATIONS, Interpolation, pair_cost
from lfflow.stages.on_field import carried_coords, on_field

Pair = tuple[int, int]


def default_pairs(u: npt.ArrayLike, v: npt.ArrayLike, *, longest: int = 4, diagonals: bool = False) -> list[Pair]:
    """Pairs of view (0, 0) with every view of its row and its column, up to `longest` view steps.

    Which of them have same-colour support depends on the lattice: on an F01 the even steps along the row, on an Illum
    most. A pair without support simply has no cost.
    """
    across = [int(a) for a in np.asarray(u) if 0 < abs(a) <= longest]
    down = [int(b) for b in np.asarray(v) if 0 < abs(b) <= longest]
    pairs = [(a, 0) for a in across] + [(0, b) for b in down]
    if diagonals:
        pairs += [(a, b) for a in across for b in down if abs(a) == abs(b)]
    return pairs


def default_hypotheses(pairs: Sequence[Pair], low: float = -1.0, high: float = 1.0) -> npt.NDArray[np.float64]:
    """Disparities from `low` to `high` at which the longest pair moves by ½ lens (METHOD 8.4: Nyquist of the SSD)."""
    step = 0.5 / max(max(abs(a), abs(b)) for a, b in pairs)
    return np.arange(np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9) + 1) * step


def pair_costs(
    lf: xr.Dataset,
    *,
    pairs: Sequence[Pair] | None = None,
    hypotheses: Sequence[float] | npt.NDArray[np.floating] | None = None,
    reference: Pair = (0, 0),
    sigma: float = 1.5,
    min_support: float = 0.2,
    interpolation: Interpolation = "cubic",
) -> xr.DataArray:
    """Same-colour block costs of a mosaicked light field, one for each pair and hypothesis.

    Parameters
    ----------
    lf
        Light field (`lfflow.schema.LIGHTFIELD`): ``mosaic``, ``cfa``, ``weight`` (v, u, t, s) in any order, numpy or
        dask, with or without ``capture``.
    pairs
        Baselines (pair_u, pair_v) in view steps; by default those of `default_pairs`. All in one array: give few where
        memory counts, or use `lfflow.disparity`, which never holds them.
    hypotheses
        Equally spaced disparities, lens pitches per view step; by default −1 to 1 in steps by which the longest pair
        moves half a lens.
    reference
        View (u, v) in whose lenses the costs are given.
    sigma
        Standard deviation of the Gaussian block, lens pitches.
    min_support
        Share of the block that must have met its own colour; NaN below.
    interpolation
        "nearest", "linear", "cubic" or "bandlimited", along the rows.

    Returns
    -------
    DataArray ``cost`` (pair, hypothesis, t, s), float32, squared radiance; ``pair`` is indexed by ``pair_u`` and
    ``pair_v``: ``costs.sel(pair_u=2)``.

    Raises
    ------
    ValueError
        A pair leads to a view that the light field does not have, or an option is unknown.
    SchemaError
        `lf` is no light field.
    """
    chosen = list(pairs) if pairs is not None else default_pairs(lf["u"], lf["v"])
    if not chosen:
        raise ValueError("no pair of views to match")
    if interpolation not in INTERPOLATIONS:
        raise ValueError(f"interpolation {interpolation!r} is none of {INTERPOLATIONS}")
    for a, b in [(0, 0), *chosen]:
        if reference[0] + a not in lf["u"].to_numpy() or reference[1] + b not in lf["v"].to_numpy():
            raise ValueError(f"pair ({a}, {b}) of view {reference} leaves the light field")
    labels = np.asarray(default_hypotheses(chosen) if hypotheses is None else hypotheses, dtype=np.float64)

    def costs(field: MosaicField) -> tuple[npt.NDArray[Any], ...]:
        options: dict[str, Any] = {"sigma": sigma, "min_support": min_support, "interpolation": interpolation}
        return (np.stack([pair_cost(field, pair, labels, reference=reference, **options) for pair in chosen]),)

    dims = ("pair", "hypothesis", "t", "s")
    (cost,) = on_field(costs, lf, [(dims, "float32")], {"pair": len(chosen), "hypothesis": len(labels)})
    index = pd.MultiIndex.from_tuples(chosen, names=["pair_u", "pair_v"])
    cost = cost.assign_coords(xr.Coordinates.from_pandas_multiindex(index, "pair"))
    cost = cost.assign_coords(hypothesis=("hypothesis", labels), **carried_coords(lf, ("t", "s")))
    cost = cost.assign_coords(u=reference[0], v=reference[1])
    cost["hypothesis"].attrs = {"long_name": "candidate disparity", "units": "1"}
    cost.attrs = {"long_name": "mean squared same-colour difference", "units": "1"}
    return cost.rename("cost")
