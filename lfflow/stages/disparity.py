"""Disparity of one view, the central one if no other is asked for (METHOD 8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.kernels.mosaicked.fusion import FUSIONS, Fusion
from lfflow.kernels.mosaicked.match_field import Matching, match_field
from lfflow.kernels.mosaicked.mosaic_field import MosaicField
from lfflow.kernels.mosaicked.pair_cost import INTERPOLATIONS, Interpolation
from lfflow.kernels.mosaicked.subpixel import COST_INTERPOLATIONS, CostInterpolation
from lfflow.schema import DISPARITY
from lfflow.stages.costs import Pair
from lfflow.stages.on_field import carried_coords, on_field

_MAP = ("t", "s")
_OUTPUTS = [(_MAP, "float32"), (_MAP, "float32"), (_MAP, "uint8")]


def disparity(
    lf: xr.Dataset,
    *,
    u: int = 0,
    v: int = 0,
    pairs: Sequence[Pair] | None = None,
    hypotheses: Sequence[float] | npt.NDArray[np.floating] | None = None,
    sigma: float = 1.5,
    interpolation: Interpolation = "cubic",
    cost_interpolation: CostInterpolation = "parabola",
    fusion: Fusion = "opposite",
    second_pass: bool = True,
    regularise: bool = True,
    min_support: float = 0.2,
    threads: int = 1,
    **view_options: Any,
) -> xr.Dataset:
    """Disparity of one view of a light field, with its error map.

    Parameters
    ----------
    lf
        Mosaicked light field (`lfflow.schema.LIGHTFIELD`), or a dataset of full-colour views with ``rgb``, which goes
        to `lfflow.stages.view_matching.disparity_of_views` with `threads` and `view_options`; the other options have no
        meaning there. Any dim order, numpy or dask, with or without ``capture``.
    u, v
        View whose disparity is wanted, one of those of `lf`. It is best known for the central one, which has others on
        all sides; `lfflow.transpose_disparity` carries it to every view, and joins those of several.
    pairs
        Baselines (pair_u, pair_v) of the first pass; by default those of the row and the column of the view whose
        same-colour support, measured on the field, is enough.
    hypotheses
        Disparities that bound the search, lens pitches per view step; by default −1 to 1, doubled while the disparities
        press against the border.
    sigma
        Gaussian block of the first pass, lens pitches.
    interpolation, cost_interpolation
        How images ("nearest", "linear", "cubic", "bandlimited") and costs ("none", "parabola", "equiangular", "spline")
        are read between their samples.
    fusion
        How the costs of pairs and of sides of the aperture become one: `lfflow.kernels.mosaicked.fusion.fuse_costs`.
    second_pass
        Complete the colours of the view along the first disparity and compare every sample of every view with
        it.
    regularise
        Aggregate along paths that follow the picture's edges and fill what has no texture from trusted neighbours. Off:
        each block decides for itself.
    min_support
        Share of a block that must have met its own colour.
    threads
        Cores that one capture may use; the result does not depend on it.

    Returns
    -------
    Dataset ``disparity``, ``disparity_std`` (float32, lens pitches per view step) and ``flags`` (uint8 bits: no data,
    low texture, saturated, occluded, filled), dims (t, s), with the scalar coordinates u, v. Lazy where `lf` is.

    Raises
    ------
    ValueError
        An option is unknown, the light field has no such view, or too few lenses or views beside it.
    TypeError
        An option has no meaning for `lf`.
    SchemaError
        `lf` is no light field.
    """
    options = Matching(
        pairs=None if pairs is None else tuple((int(a), int(b)) for a, b in pairs),
        hypotheses=None if hypotheses is None else tuple(map(float, hypotheses)),
        sigma=sigma,
        interpolation=interpolation,
        cost_interpolation=cost_interpolation,
        fusion=fusion,
        second_pass=second_pass,
        regularise=regularise,
        min_support=min_support,
        threads=threads,
    )
    lf = _seen_from(lf, u, v)
    if "rgb" in lf.data_vars and "mosaic" not in lf.data_vars:
        return DISPARITY.annotate(_of_views(lf, options, view_options).assign_coords(u=u, v=v))
    if view_options:
        raise TypeError(f"unknown option {', '.join(sorted(view_options))} for a mosaicked light field")
    _check("interpolation", interpolation, INTERPOLATIONS)
    _check("cost_interpolation", cost_interpolation, COST_INTERPOLATIONS)
    _check("fusion", fusion, FUSIONS)

    def match(field: MosaicField) -> tuple[npt.NDArray[Any], ...]:
        return match_field(field, options)

    found = on_field(match, lf, _OUTPUTS, {})
    out = xr.Dataset(dict(zip(("disparity", "disparity_std", "flags"), found, strict=True)))
    out = out.assign_coords({**carried_coords(lf, _MAP), "u": u, "v": v})
    return DISPARITY.annotate(out)


def _seen_from(lf: xr.Dataset, u: int, v: int) -> xr.Dataset:
    """The same views, counted from another one: disparities are of points, whichever view they are counted from."""
    if (u, v) == (0, 0):
        return lf
    for name, wanted in (("u", u), ("v", v)):
        known = lf[name].values.tolist() if name in lf.variables else []
        if wanted not in known:
            raise ValueError(f"no view {name}={wanted}: the light field has {name} {known}")
    return lf.assign_coords(u=lf["u"] - u, v=lf["v"] - v)


def _check(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{name} {value!r} is none of {', '.join(known)}")


def _of_views(lf: xr.Dataset, given: Matching, options: dict[str, Any]) -> xr.Dataset:
    from lfflow.stages.view_matching import disparity_of_views

    usual = Matching()
    names = (option.name for option in fields(Matching) if option.name != "threads")
    strange = [name for name in names if getattr(given, name) != getattr(usual, name)]
    if strange:
        raise TypeError(f"{', '.join(strange)}: no option for full-colour views, which are matched in another way")
    result: xr.Dataset = disparity_of_views(lf, threads=given.threads, **options)
    return result
