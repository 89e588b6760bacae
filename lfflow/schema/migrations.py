"""How results that were stored under an earlier schema become results under the present one.

A schema whose variables change gets the next version and a migration from the last one here. `lfflow migrate` applies
them, capture by capture; a run refuses a store of another version. A migration gives what is new a value from what was
stored, or leaves it absent where the schema says that it may be. Where numbers themselves have changed there is nothing
to migrate: the stage gets a new version (`lfflow.run.chain`), and the next run makes the results anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import xarray as xr

from lfflow.errors import SchemaError
from lfflow.schema.declarations import LIGHTFIELD
from lfflow.schema.spec import Schema

_NO_SAMPLE = LIGHTFIELD["cfa"].flags["no_sample"]

Convert = Callable[[xr.Dataset], xr.Dataset]


def unchanged(ds: xr.Dataset) -> xr.Dataset:
    """Dataset as it is: what is new may be absent."""
    return ds


@dataclass(frozen=True, slots=True)
class Migration:
    """One step from a version of a schema to the next.

    Parameters
    ----------
    schema
        Name of the schema.
    before
        Version that it starts from; it ends at the next.
    what
        What changes, in words.
    convert
        From the dataset of one capture, with the variables that were stored, to one with those of the next version.
    """

    schema: str
    before: int
    what: str
    convert: Convert = unchanged


def with_usable_views(ds: xr.Dataset) -> xr.Dataset:
    """Light field that says which of its views have a sample at half of the lenses on the sensor, or more."""
    samples = ds["cfa"] != _NO_SAMPLE
    lenses = samples.any(("v", "u")).sum()
    counts = samples.sum(("t", "s"))
    return ds.assign_coords(view_usable=(counts > 0) & (2 * counts >= lenses))


MIGRATIONS: tuple[Migration, ...] = (
    Migration("calibration", 1, "the bend of the lattice and how sure it is, absent where it was not measured"),
    Migration(
        "lightfield",
        1,
        "which views are usable; the bend of the lattice, absent where it was not measured",
        with_usable_views,
    ),
)


def migrations(schema: Schema, version: int, known: tuple[Migration, ...] = MIGRATIONS) -> list[Migration]:
    """Steps from a version of a schema to its present one, in order; none when it is the present one.

    Raises
    ------
    SchemaError
        If the version is later than the present one, or a step is missing.
    """
    if version > schema.version:
        raise SchemaError(
            f"{schema.name} has schema version {version}, this lfflow knows {schema.version}: use a later lfflow"
        )
    by_version = {step.before: step for step in known if step.schema == schema.name}
    missing = [number for number in range(version, schema.version) if number not in by_version]
    if missing:
        raise SchemaError(
            f"{schema.name} of schema version {version} cannot be migrated to {schema.version} (no step from "
            f"{missing[0]}): make it anew in another folder"
        )
    return [by_version[number] for number in range(version, schema.version)]
