"""Stores grow without touching what is finished, refuse what differs from their declaration, and are read lazily."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import dask
import numpy as np
import pytest
from tiny_store import GROUP, SIZES, finish, lightfield
from zarr.storage import LocalStore

from lfflow.collection import Collection, open_collection
from lfflow.errors import CollectionError, SchemaError


def chunks(collection: Path) -> dict[str, tuple[int, bytes]]:
    """Time of change and content of every chunk of the large arrays."""
    return {
        str(path): (path.stat().st_mtime_ns, path.read_bytes())
        for name in ("mosaic", "cfa", "weight", "view_usable")
        for path in sorted((collection / "lightfield.zarr").glob(f"*/{name}/c/**/*"))
        if path.is_file()
    }


def records(collection: Path) -> dict[str, tuple[int, bytes]]:
    paths = sorted((collection / "ledger/lightfield").rglob("*.json"))
    return {str(path): (path.stat().st_mtime_ns, path.read_bytes()) for path in paths}


def test_new_captures_touch_nothing_that_is_finished(tmp_path):
    finish(tmp_path, "B", "C")
    before = chunks(tmp_path) | records(tmp_path)
    finish(tmp_path, "B", "C", "A", "D")
    after = chunks(tmp_path) | records(tmp_path)
    assert before.items() <= after.items()
    assert len(after) == 2 * len(before)
    found = Collection(tmp_path).open("lightfield").load()
    assert list(found["capture"].values) == ["B", "C", "A", "D"]
    for name in "BCAD":
        expected = lightfield(sum(map(ord, name)) % 97 + 1)
        np.testing.assert_allclose(found["mosaic"].sel(capture=name), expected["mosaic"], rtol=2**-12)
        assert found["iso"].sel(capture=name) == expected["iso"]


def test_a_new_camera_is_a_group_beside_the_others(tmp_path):
    finish(tmp_path, "A")
    before = chunks(tmp_path) | records(tmp_path)
    finish(tmp_path, "Z", group="T2-60x80")
    assert before.items() <= (chunks(tmp_path) | records(tmp_path)).items()
    col = Collection(tmp_path)
    with pytest.raises(CollectionError, match="which camera"):
        col.open("lightfield")
    assert list(col.open("lightfield", camera="T2-60x80")["capture"].values) == ["Z"]


def edited(document: dict, *keys: object, value: object) -> dict:
    inner = document
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return document


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (("data_type",), "float64", "data_type: found float64, expected float32"),
        (("dimension_names",), ["capture", "u", "v", "t", "s"], "dimension_names: found"),
        (("shape",), [2, 3, 3, 4, 50], r"shape: found \[3, 3, 4, 50\], expected \[3, 3, 4, 5\]"),
        (("chunk_grid", "configuration", "chunk_shape"), [2, 3, 3, 4, 5], "chunk_grid: found"),
        (("codecs", 0, "configuration", "codecs"), [{"name": "bytes"}], "codecs: found"),
        (("attributes", "units"), "a long unit that is none", "attributes: found"),
        (("fill_value",), 0.0, "fill_value: found 0.0, expected NaN"),
    ],
)
def test_a_store_that_differs_is_refused_with_the_difference(tmp_path, keys, value, message):
    finish(tmp_path, "A", "B")
    path = tmp_path / "lightfield.zarr" / GROUP / "mosaic" / "zarr.json"
    path.write_text(json.dumps(edited(json.loads(path.read_text()), *keys, value=value)))
    before = chunks(tmp_path)
    with pytest.raises(SchemaError, match=message) as refused:
        Collection(tmp_path).store("lightfield").ensure(GROUP, SIZES, ["A", "B", "C"])
    assert "lightfield.zarr/T1-40x40/mosaic/zarr.json differs from its declaration" in str(refused.value)
    assert chunks(tmp_path) == before


@pytest.fixture
def reads(monkeypatch) -> Counter[str]:
    """Names of what is read from any zarr store, with their number."""
    found: Counter[str] = Counter()
    whole = LocalStore.get

    async def counted(self, key, *args, **kwargs):
        found[f"{Path(str(self.root)).name}/{key}"] += 1
        return await whole(self, key, *args, **kwargs)

    monkeypatch.setattr(LocalStore, "get", counted)
    return found


def regions_of(reads: Counter[str]) -> set[tuple[str, str]]:
    """(variable, slot) of the large arrays that were read."""
    parts = [name.split("/") for name in reads if "/c/" in name]
    return {(part[2], part[4]) for part in parts if part[2] in ("mosaic", "cfa", "weight")}


def test_opening_and_selecting_reads_no_region(tmp_path, reads):
    finish(tmp_path, *(f"IMG_{n}" for n in range(6)))
    reads.clear()
    col = open_collection(tmp_path)
    with dask.config.set(scheduler=lambda *_args, **_kwargs: pytest.fail("something was computed")):
        chosen = col.open("lightfield").sel(capture=col.query("id in ['IMG_1', 'IMG_4']"))
    assert list(chosen["capture"].values) == ["IMG_1", "IMG_4"]
    assert regions_of(reads) == set()


def test_only_what_is_asked_for_is_read(tmp_path, reads):
    finish(tmp_path, *(f"IMG_{n}" for n in range(6)))
    col = open_collection(tmp_path)
    chosen = col.open("lightfield").sel(capture=col.query("id in ['IMG_1', 'IMG_4']"))
    reads.clear()
    chosen["mosaic"].sel(u=0, v=0).load()
    assert regions_of(reads) == {("mosaic", "1"), ("mosaic", "4")}
    reads.clear()
    col.open("lightfield", chunks=None)["weight"].sel(capture="IMG_3").load()
    assert regions_of(reads) == {("weight", "3")}


def test_nothing_that_is_not_finished_is_shown(tmp_path):
    finish(tmp_path, "A", "B")
    collection = Collection(tmp_path)
    collection.store("lightfield").ensure(GROUP, SIZES, ["A", "B", "C"])
    collection.ledger.remove("lightfield", "A")
    assert list(collection.open("lightfield")["capture"].values) == ["B"]


@pytest.mark.parametrize("place", [0, -1], ids=["first byte", "index of the shard"])
def test_a_region_is_written_anew_whatever_is_left_of_the_old_one(tmp_path, place):
    collection = finish(tmp_path, "A")
    before = {name: content for name, (_, content) in chunks(tmp_path).items()}
    for name, content in before.items():
        damaged = bytearray(content)
        damaged[place] ^= 1
        Path(name).write_bytes(damaged)
    store = collection.store("lightfield")
    store.write(GROUP, 0, lightfield(ord("A") % 97 + 1))
    assert {name: content for name, (_, content) in chunks(tmp_path).items()} == before
