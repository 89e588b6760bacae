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

    def picture(self, scale: int = 1, *, camera: xr.Dataset | None = None) -> xr.DataArray:
        """Views as a person sees them (`lfflow.stages.square.picture`)."""
        from lfflow.stages.square import picture

        return picture(self._data, scale, camera=camera)

    @property
    def views(self) -> xr.Dataset:
        """Light field with the samples of its usable views alone (`lfflow.stages.samples.only_usable`)."""
        from lfflow.stages.samples import only_usable

        return self._dataset().pipe(only_usable)

    def saturated(self) -> xr.DataArray:
        """Clipped samples (`lfflow.stages.samples.saturated`)."""
        from lfflow.stages.samples import saturated

        return self._dataset().pipe(saturated)

    def residual(self) -> xr.Dataset:
        """Rounding of the lens centres, ρ (`lfflow.stages.samples.residual`)."""
        from lfflow.stages.samples import residual

        return self._dataset().pipe(residual)

    def usable_views(self) -> xr.DataArray:
        """Views with enough light (`lfflow.stages.samples.usable_views`)."""
        from lfflow.stages.samples import usable_views

        return self._dataset().pipe(usable_views)

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

    def plot(self, u: int = 0, v: int = 0, *, scale: int = 1, camera: xr.Dataset | None = None, **options: Any) -> Any:
        """Draw one view: in colour where there are colours, else as values. Returns the matplotlib image."""
        one = self._data.sel(u=u, v=v) if "u" in self._data.dims else self._data
        if not isinstance(one, xr.Dataset) and "channel" not in one.dims:
            return one.transpose("t", "s").plot.imshow(yincrease=False, **options)
        from lfflow.stages.square import picture

        shown = picture(one, scale, camera=camera).fillna(0).transpose("t", "s", "channel")
        image = shown.plot.imshow(rgb="channel", yincrease=False, **options)
        image.axes.set_aspect("equal")
        usable = one.coords.get("view_usable")
        dark = usable is not None and usable.chunks is None and not usable.item()
        image.axes.set_title(f"view u = {u}, v = {v}" + (" (hardly any light)" if dark else ""))
        return image

    def _dataset(self) -> xr.Dataset:
        if isinstance(self._data, xr.Dataset):
            return self._data
        raise LfflowError("this is asked of the dataset of a light field, not of one of its arrays")

    def _facts(self) -> dict[str, str]:
        data = self._data
        names = [name for name in ("camera_model", "camera_serial") if name in data.coords]
        facts = {"camera": " ".join(sorted({str(value) for name in names for value in data[name].values.ravel()}))}
        facts["captures"] = str(data.sizes["capture"]) if "capture" in data.dims else ""
        if "dh" in data.coords and data["dh"].chunks is None and data["dh"].ndim == 0:
            units = {"dh": "px", "dv": "px", "theta": "rad", "cx": "px", "cy": "px"}
            facts["lattice"] = ", ".join(f"{name} {float(data[name]):.5f} {unit}" for name, unit in units.items())
        facts["views"] = " × ".join(f"{data.sizes[d]} {d}" for d in ("v", "u") if d in data.dims) + self._usable()
        facts["lenses"] = " × ".join(f"{data.sizes[d]} {d}" for d in ("t", "s") if d in data.dims)
        facts["missing"] = self._missing()
        return {name: text for name, text in facts.items() if text}

    def _usable(self) -> str:
        usable = self._data.coords.get("view_usable")
        if usable is None or usable.chunks is not None or not {"v", "u"} & set(usable.dims):
            return ""
        return f", {float(usable.sum({'v', 'u'} & set(usable.dims)).mean()):g} of them usable"

    def _missing(self) -> str:
        if not isinstance(self._data, xr.Dataset) or "cfa" not in self._data:
            return ""
        if self._data["cfa"].chunks is not None:
            return "not computed yet"
        missing = self._data["cfa"] == CFA_NONE
        text = f"{float(missing.mean()):.1%} of the places"
        if "view_usable" not in self._data.coords or "v" not in self._data.dims:
            return text
        return f"{text}, {float(missing.where(self._data['view_usable']).mean()):.1%} of those of usable views"

    def __repr__(self) -> str:
        return "\n".join(["Light field", *(f"  {name:8} {text}" for name, text in self._facts().items())])

    def _repr_html_(self) -> str:
        left = 'style="text-align: left; vertical-align: top; padding: 0.1em 1em 0.1em 0"'
        rows = "".join(
            f"<tr><th {left}>{name}</th><td {left}>{html.escape(text)}</td></tr>"
            for name, text in self._facts().items()
        )
        return f"<table><caption {left}><b>Light field</b></caption>{rows}</table>"


for _register in (xr.register_dataset_accessor, xr.register_dataarray_accessor):
    _register("lf")(LightFieldAccessor)  # type: ignore[no-untyped-call]
