"""How a store is declared: one object gives the template, the encoding, the validation and the documentation table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from lfflow.errors import SchemaError


@dataclass(frozen=True, slots=True)
class Variable:
    """Declaration of one variable of a store.

    Parameters
    ----------
    name, dims, dtype
        As in the dataset; ``dims`` leave out ``capture``, which stores add in front of all but the axes.
    long_name, units
        CF attributes; "1" is dimensionless, "" of a time, whose units belong to its encoding.
    flags
        Meaning of each value (bits where `flag_bits`), written as CF ``flag_values`` or ``flag_masks``.
    coordinate
        Carried as a coordinate, so that it follows the arrays it belongs to.
    axis
        Belongs to the grid and not to a capture: has no ``capture`` dim in a store.
    required
        A dataset without it is refused.
    keep_bits
        Bits of the float32 mantissa that are kept when written; None keeps all.
    """

    name: str
    dims: tuple[str, ...]
    dtype: str
    long_name: str
    units: str = "1"
    flags: Mapping[str, int] = field(default_factory=dict)
    flag_bits: bool = False
    coordinate: bool = False
    axis: bool = False
    required: bool = True
    keep_bits: int | None = None

    @property
    def attrs(self) -> dict[str, Any]:
        """CF attributes of the variable."""
        attrs: dict[str, Any] = {"long_name": self.long_name}
        if self.units:
            attrs["units"] = self.units
        if self.flags:
            key = "flag_masks" if self.flag_bits else "flag_values"
            attrs[key] = np.array(list(self.flags.values()), dtype=self.dtype)
            attrs["flag_meanings"] = " ".join(self.flags)
        return attrs

    @property
    def fill_value(self) -> float | int | str:
        """What a region holds before it is written: NaN, 255 (no sample), 0, or an empty string."""
        if self.dtype.startswith("float"):
            return float("nan")
        if self.dtype == "string":
            return ""
        return 255 if self.name == "cfa" else 0


@dataclass(frozen=True, slots=True)
class Issue:
    """One difference between a dataset and its declaration."""

    variable: str
    found: str
    expected: str

    def __str__(self) -> str:
        return f"{self.variable}: found {self.found}, expected {self.expected}"


@dataclass(frozen=True, slots=True)
class Schema:
    """Declaration of one kind of dataset."""

    name: str
    version: int
    description: str
    variables: tuple[Variable, ...]

    def __getitem__(self, name: str) -> Variable:
        """The declaration of variable `name`."""
        for variable in self.variables:
            if variable.name == name:
                return variable
        raise KeyError(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all declared variables."""
        return tuple(variable.name for variable in self.variables)

    def annotate(self, ds: xr.Dataset) -> xr.Dataset:
        """Dataset with the declared attributes and coordinates; values and laziness stay as they are."""
        ds = ds.assign_attrs({**ds.attrs, "schema": self.name, "schema_version": self.version})
        present = [variable for variable in self.variables if variable.name in ds.variables]
        ds = ds.set_coords([variable.name for variable in present if variable.coordinate or variable.axis])
        for variable in present:
            ds[variable.name].attrs.update(variable.attrs)
        return ds

    def issues(self, ds: xr.Dataset) -> list[Issue]:
        """Every difference between `ds` (with or without a ``capture`` dim) and this declaration."""
        found: list[Issue] = []
        for variable in self.variables:
            if variable.name not in ds.variables:
                if variable.required:
                    found.append(Issue(variable.name, "no such variable", f"{variable.dtype} {variable.dims}"))
                continue
            array = ds[variable.name]
            dims = {str(dim) for dim in array.dims} - {"capture"}
            if dims != set(variable.dims) - {"capture"}:
                found.append(Issue(variable.name, f"dims {array.dims}", f"dims {variable.dims}"))
            if not _same_dtype(array.dtype, variable.dtype):
                found.append(Issue(variable.name, f"dtype {array.dtype}", f"dtype {variable.dtype}"))
        return found

    def check(self, ds: xr.Dataset, what: str = "dataset") -> xr.Dataset:
        """Return `ds` unchanged, or raise `SchemaError` with every difference."""
        issues = self.issues(ds)
        if issues:
            listed = "; ".join(map(str, issues))
            raise SchemaError(f"{what} is no {self.name} (schema version {self.version}): {listed}")
        return ds

    def table(self) -> str:
        """Markdown table of the declaration, as data/README.md shows it."""
        rows = ["| variable | dims | dtype | units | meaning |", "|---|---|---|---|---|"]
        for variable in self.variables:
            dims = ", ".join(variable.dims) or "–"
            meaning = variable.long_name
            if variable.flags:
                meaning += " (" + ", ".join(f"{value} {name}" for name, value in variable.flags.items()) + ")"
            optional = "" if variable.required else " *"
            rows.append(f"| `{variable.name}`{optional} | {dims} | {variable.dtype} | {variable.units} | {meaning} |")
        return "\n".join(rows)


def _same_dtype(found: np.dtype[Any], declared: str) -> bool:
    if declared == "string":
        return found.kind in "OUT"
    return found == np.dtype(declared)


def scalars(names: Sequence[tuple[str, str, str]], *, coordinate: bool) -> tuple[Variable, ...]:
    """Float64 declarations without dims from (name, long_name, units)."""
    return tuple(Variable(name, (), "float64", text, units, coordinate=coordinate) for name, text, units in names)
