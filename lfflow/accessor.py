"""``ds.lf`` and ``da.lf``: what can be asked of a light field, each a pipe to the function that does it."""

from __future__ import annotations

import html
from typing import Any

import xarray as xr

from lfflow.conventions import CFA_NONE
from lfflow.errors import LfflowError


class LightFieldAccessor:
    """Views, slices and pictures of a light field; nothing is computed before it is asked for."""

    def __init__(self, data: xr.Dataset | xr.DataArray) -> None:
        self._data: Any = data

    def view(self, u: int = 0, v: int = 0) -> Any:
        """One view (t, s)."""
        return self._data.sel(u=u, v=v)

    def epi(self, *, t: int | None = None, s: int | None = None, u: int = 0, v: int = 0) -> Any:
        """Epipolar image of lens row ``t`` in the views of row ``v``: (u, s); or of column ``s`` in ``u``: (v, t)."""
        if (t is None) == (s is None):
            raise LfflowError("an epipolar image is of one lens row (t=…) or of one lens column (s=…)")
        return self._data.sel(t=t, v=v) if s is None else self._data.sel(s=s, u=u)

    def square(self, scale: int = 1) -> xr.DataArray:
        """Views on the square grid (`lfflow.stages.square.square`)."""
        from lfflow.stages.square import square

        return square(self._data, scale)

    def picture(self, scale: int = 1) -> xr.DataArray:
        """Views as a person sees them (`lfflow.stages.square.picture`)."""
        from lfflow.stages.square import picture

        return picture(self._data, scale)

    def saturated(self) -> xr.DataArray:
        """Clipped samples (`lfflow.stages.samples.saturated`)."""
        from lfflow.stages.samples import saturated

        return self._dataset().pipe(saturated)

    def residual(self) -> xr.Dataset:
        """Rounding of the lens centres, ρ (`lfflow.stages.samples.residual`)."""
        from lfflow.stages.samples import residual

        return self._dataset().pipe(residual)

    def usable_views(self, least: float = 0.1) -> xr.DataArray:
        """Views with enough light (`lfflow.stages.samples.usable_views`)."""
        from lfflow.stages.samples import usable_views

        return self._dataset().pipe(usable_views, least)

    def refocus(self, d: Any = 0.0, **options: Any) -> xr.DataArray:
        """Picture focused on disparity ``d``; several make a focal stack (`lfflow.stages.refocus.refocus`)."""
        from lfflow.stages.refocus import refocus

        return self._dataset().pipe(refocus, d, **options)

    def all_in_focus(self, **options: Any) -> xr.DataArray:
        """Every point in focus (`lfflow.stages.refocus.all_in_focus`)."""
        from lfflow.stages.refocus import all_in_focus

        return self._dataset().pipe(all_in_focus, **options)

    def depth_of_field(self, d0: float, width: float, **options: Any) -> xr.DataArray:
        """Picture sharp within ``d0 ± width/2`` (`lfflow.stages.refocus.depth_of_field`)."""
        from lfflow.stages.refocus import depth_of_field

        return self._dataset().pipe(depth_of_field, d0, width, **options)

    def depth(self, **options: Any) -> xr.Dataset:
        """Metres from disparity, with their deviation (`lfflow.stages.depth.depth`)."""
        from lfflow.stages.depth import depth

        return self._dataset().pipe(depth, **options)

    def epi_lines(self, **options: Any) -> xr.Dataset:
        """Epipolar image and the lines of the disparity in it (`lfflow.stages.epi.epi`)."""
        from lfflow.stages.epi import epi

        return self._dataset().pipe(epi, **options)

    def to_lftoolbox(self) -> xr.Dataset:
        """Dataset under the letters of LFToolbox (`lfflow.stages.samples.to_lftoolbox`)."""
        from lfflow.stages.samples import to_lftoolbox

        return self._dataset().pipe(to_lftoolbox)

    def from_lftoolbox(self) -> xr.Dataset:
        """Dataset back from the letters of LFToolbox (`lfflow.stages.samples.from_lftoolbox`)."""
        from lfflow.stages.samples import from_lftoolbox

        return self._dataset().pipe(from_lftoolbox)

    def plot(self, u: int = 0, v: int = 0, *, scale: int = 1, **options: Any) -> Any:
        """Draw one view: in colour where there are colours, else as values. Returns the matplotlib image."""
        one = self._data.sel(u=u, v=v) if "u" in self._data.dims else self._data
        if isinstance(one, xr.Dataset) or "channel" in one.dims:
            from lfflow.stages.square import picture

            shown = picture(one, scale).fillna(0).transpose("t", "s", "channel")
            return shown.plot.imshow(rgb="channel", yincrease=False, **options)
        return one.transpose("t", "s").plot.imshow(yincrease=False, **options)

    def _dataset(self) -> xr.Dataset:
        if isinstance(self._data, xr.Dataset):
            return self._data
        raise LfflowError("this is asked of the dataset of a light field, not of one of its arrays")

    def _facts(self) -> dict[str, str]:
        data = self._data
        facts = {"camera": " ".join(str(data[n].values) for n in ("camera_model", "camera_serial") if n in data.coords)}
        if "dh" in data.coords and data["dh"].chunks is None and data["dh"].ndim == 0:
            numbers = (f"{name} {float(data[name]):.5f}" for name in ("dh", "dv", "theta", "cx", "cy"))
            facts["lattice"] = ", ".join(numbers)
        facts["views"] = " × ".join(f"{data.sizes[d]} {d}" for d in ("v", "u") if d in data.dims)
        facts["lenses"] = " × ".join(f"{data.sizes[d]} {d}" for d in ("t", "s") if d in data.dims)
        if isinstance(data, xr.Dataset) and "cfa" in data:
            lazy = data["cfa"].chunks is not None
            facts["missing"] = (
                "not computed yet" if lazy else f"{float((data['cfa'] == CFA_NONE).mean()):.1%} of the samples"
            )
        return {name: text for name, text in facts.items() if text}

    def __repr__(self) -> str:
        return "\n".join(["Light field", *(f"  {name:8} {text}" for name, text in self._facts().items())])

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><th>{n}</th><td>{html.escape(text)}</td></tr>" for n, text in self._facts().items())
        return f"<table><caption>Light field</caption>{rows}</table>"


for _register in (xr.register_dataset_accessor, xr.register_dataarray_accessor):
    _register("lf")(LightFieldAccessor)  # type: ignore[no-untyped-call]
