"""Stores of an earlier schema: refused by a run, migrated capture by capture without touching what is stored."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from tiny_store import GROUP, SIZES, finish, lightfield

from lfflow.collection import Collection, migrate
from lfflow.collection.records import sealed, unsealed
from lfflow.errors import SchemaError
from lfflow.schema import SCHEMAS, Variable
from lfflow.schema.migrations import MIGRATIONS, Migration, migrations

ADDED = Variable("brightest", ("t", "s"), "float32", "largest sample of a lens")
LATER = ("axis", "term", "distortion", "view_usable")
SMALL = Variable("mean", (), "float64", "mean of all samples", required=False)


def regions(collection: Path) -> dict[str, tuple[int, str]]:
    """Time and content of every stored chunk."""
    return {
        str(path.relative_to(collection)): (path.stat().st_mtime_ns, hashlib.sha256(path.read_bytes()).hexdigest())
        for path in sorted(collection.glob("*.zarr/*/*/c/**/*"))
        if path.is_file() and path.parts[-7:-6] != ("capture",)
    }


@pytest.fixture
def changed_schema(monkeypatch):
    """Set the schema that this lfflow writes light fields with."""

    def change(version, *, without=(), more=()):
        present = SCHEMAS["lightfield"]
        variables = tuple(v for v in present.variables if v.name not in without) + tuple(more)
        monkeypatch.setitem(SCHEMAS, "lightfield", replace(present, version=version, variables=variables))

    return change


def brightest(ds: xr.Dataset) -> xr.Dataset:
    return ds.assign(brightest=ds["mosaic"].max(("v", "u")), mean=ds["mosaic"].mean().astype("float64"))


def test_light_fields_of_the_first_schema_are_migrated_to_the_present_one(tmp_path, changed_schema, monkeypatch):
    """The real step: version 1 had no bend of the lattice, and did not say which views are usable."""
    with monkeypatch.context() as earlier:
        present = SCHEMAS["lightfield"]
        first = tuple(v for v in present.variables if v.name not in LATER)
        earlier.setitem(SCHEMAS, "lightfield", replace(present, version=1, variables=first))
        finish(tmp_path, "A", "B")
        before = Collection(tmp_path).open("lightfield").load()
    with pytest.raises(SchemaError, match=r"schema version 1, this lfflow writes 2: lfflow migrate"):
        Collection(tmp_path).store("lightfield").ensure(GROUP, SIZES, ["A"])
    kept = {name: state for name, state in regions(tmp_path).items() if "/mosaic/" in name or "/weight/" in name}
    (done,) = migrate.migrate(Collection(tmp_path))
    assert (done.store, done.group, done.before, done.after, done.captures) == ("lightfield", GROUP, 1, 2, 2)
    assert regions(tmp_path).items() >= kept.items()
    after = Collection(tmp_path).open("lightfield").load()
    xr.testing.assert_equal(before, after.drop_vars(LATER, errors="ignore"))
    assert after["view_usable"].dims == ("capture", "v", "u")
    assert after["view_usable"].values.all()
    assert Collection(tmp_path).store("lightfield").ensure(GROUP, SIZES, ["A", "C"]) == {"A": 0, "B": 1, "C": 2}
    assert migrate.migrate(Collection(tmp_path)) == []


def test_every_schema_can_be_reached_from_its_first_version():
    for schema in SCHEMAS.values():
        assert len(migrations(schema, 1)) == schema.version - 1
    assert len({(step.schema, step.before) for step in MIGRATIONS}) == len(MIGRATIONS)


def test_a_new_variable_is_made_from_what_was_stored(tmp_path, changed_schema):
    finish(tmp_path, "A", "B")
    before = regions(tmp_path)
    version = SCHEMAS["lightfield"].version
    changed_schema(version + 1, more=(ADDED, SMALL))
    step = Migration("lightfield", version, "the brightest sample", brightest)
    (done,) = migrate.migrate(Collection(tmp_path), [*MIGRATIONS, step])
    assert done.what == ("the brightest sample",)
    found = Collection(tmp_path).open("lightfield").load()
    np.testing.assert_array_equal(found["brightest"], found["mosaic"].max(("v", "u")))
    np.testing.assert_allclose(found["mean"], found["mosaic"].mean(("v", "u", "t", "s")), rtol=1e-6)
    assert regions(tmp_path).items() >= before.items(), "what was stored is not touched"
    record = Collection(tmp_path).ledger.read("lightfield", "A")
    assert record is not None
    assert any("/brightest/" in name for name in record.files)
    assert all(Collection(tmp_path).storage.digest(name) == digest for name, digest in record.files.items())


def test_a_variable_that_is_no_more_is_removed(tmp_path, changed_schema):
    finish(tmp_path, "A")
    version = SCHEMAS["lightfield"].version
    changed_schema(version + 1, without=("weight",))
    migrate.migrate(Collection(tmp_path), [*MIGRATIONS, Migration("lightfield", version, "no weight")])
    assert not (tmp_path / "lightfield.zarr" / GROUP / "weight").joinpath("zarr.json").exists()
    assert "weight" not in Collection(tmp_path).open("lightfield")
    record = Collection(tmp_path).ledger.read("lightfield", "A")
    assert record is not None
    assert not any("/weight/" in name for name in record.files)


@pytest.mark.parametrize("stop_after", range(1, 9))
def test_a_migration_that_was_stopped_is_done_again(tmp_path, changed_schema, monkeypatch, stop_after):
    finish(tmp_path, "A", "B")
    version = SCHEMAS["lightfield"].version
    changed_schema(version + 1, more=(ADDED,))
    known = [*MIGRATIONS, Migration("lightfield", version, "the brightest sample", brightest)]
    storage = type(Collection(tmp_path).storage)
    writes = 0

    def counted(self, name, data, *, durable=True, whole=storage.write):
        nonlocal writes
        writes += 1
        if writes == stop_after:
            raise KeyboardInterrupt
        whole(self, name, data, durable=durable)

    with monkeypatch.context() as stopping:
        stopping.setattr(storage, "write", counted)
        try:
            migrate.migrate(Collection(tmp_path), known)
        except KeyboardInterrupt:
            stopping.undo()
            migrate.migrate(Collection(tmp_path), known)
    changed_schema(version + 1)
    found = Collection(tmp_path).open("lightfield").load()
    np.testing.assert_array_equal(found["brightest"], found["mosaic"].max(("v", "u")))
    assert migrate.migrate(Collection(tmp_path), known) == []


def test_what_cannot_be_migrated_is_refused_before_anything_changes(tmp_path, changed_schema):
    finish(tmp_path, "A")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    version = SCHEMAS["lightfield"].version
    changed_schema(version + 2)
    step = Migration("lightfield", version + 1, "only the second step is known")
    with pytest.raises(SchemaError, match=rf"no step from {version}"):
        migrate.migrate(Collection(tmp_path), [*MIGRATIONS, step])
    changed_schema(version + 1, without=("mosaic",), more=(replace(SCHEMAS["lightfield"]["mosaic"], dtype="float64"),))
    step = Migration("lightfield", version, "another dtype")
    with pytest.raises(SchemaError, match="mosaic: data_type: found float32, expected float64"):
        migrate.migrate(Collection(tmp_path), [*MIGRATIONS, step])
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_store_of_a_later_lfflow_is_left_alone(tmp_path):
    finish(tmp_path, "A")
    name = f"ledger/stores/lightfield/{GROUP}.json"
    document = unsealed((tmp_path / name).read_bytes(), name)
    (tmp_path / name).write_bytes(sealed({**document, "schema_version": 99}))
    with pytest.raises(SchemaError, match="use a later lfflow"):
        migrate.migrate(Collection(tmp_path))


def test_a_light_field_has_every_variable_of_its_schema():
    """The helper of these tests is a light field."""
    assert SCHEMAS["lightfield"].issues(lightfield(1)) == []
