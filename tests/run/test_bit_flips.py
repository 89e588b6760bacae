"""Rot on the disk: found by validate, repaired by the next run, never a silent wrong number."""

from __future__ import annotations

import json
import random
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fake_stores import store_content
from fault_tools import STAGES, run

from lfflow.collection import open_collection
from lfflow.collection.validate import validate
from lfflow.errors import CollectionError


def flip(path: Path, rng: random.Random) -> None:
    data = bytearray(path.read_bytes())
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)


def files_of(col: Path) -> list[Path]:
    """Every file that a result, its ledger or the catalogue rests on; pictures and lock files are none."""
    ours = (*(f"{stage}.zarr" for stage in STAGES), "ledger", "catalogue.parquet", "catalogue.sha256.json")
    return sorted(
        path for path in col.rglob("*") if path.is_file() and path.relative_to(col).parts[0] in ours
    )  # fmt: skip


def assert_found_and_mended(col, captures, finished, what):
    assert validate(open_collection(col)), f"validate does not see {what}"
    assert run(col, captures).exit_code == 0, f"the next run does not mend {what}"
    assert validate(open_collection(col)) == [], f"the next run does not mend {what}"
    assert store_content(col) == finished, f"the next run does not mend {what}"


PLACES = (
    "disparity.zarr/*/disparity/c/1/0/0/0/0",
    "calibration.zarr/*/vignetting/c/0/*/0",
    "lightfield.zarr/zarr.json",
    "lightfield.zarr/*/zarr.json",
    "lightfield.zarr/*/mosaic/zarr.json",
    "lightfield.zarr/*/dh/c/0",
    "ledger/disparity/done/IMG_1.json",
    "ledger/stores/lightfield/*.json",
    "catalogue.parquet",
    "catalogue.sha256.json",
)


def test_flipped_bits_are_found_and_mended_by_the_next_run(tmp_path, captures):
    run(tmp_path / "col", captures)
    finished = store_content(tmp_path / "col")
    rng = random.Random(3)  # noqa: S311
    for pattern in PLACES:
        flip(next((tmp_path / "col").glob(pattern)), rng)
        assert_found_and_mended(tmp_path / "col", captures, finished, pattern)


@pytest.mark.heavy
def test_a_flipped_bit_in_any_file_is_found_and_mended(tmp_path, captures):
    run(tmp_path / "col", captures)
    finished = store_content(tmp_path / "col")
    rng = random.Random(4)  # noqa: S311
    files = files_of(tmp_path / "col")
    for path in files:
        flip(path, rng)
        assert_found_and_mended(tmp_path / "col", captures, finished, path.relative_to(tmp_path / "col"))
    sys.stdout.write(f"{len(files)} files\n")


def numbers(col):
    """All that a reader gets, by kind, variable or coordinate, and capture."""
    collection = open_collection(col)
    datasets = {kind: collection.open(kind, chunks=None).load() for kind in STAGES}
    return {
        (kind, str(name), str(capture)): np.asarray(
            ds[name].sel(capture=capture) if "capture" in ds[name].dims else ds[name]
        )
        for kind, ds in datasets.items()
        for name in ds.variables
        for capture in ds["capture"].values
    }


def same(first, second):
    return first.keys() == second.keys() and all(
        np.array_equal(value, second[key], equal_nan=value.dtype.kind == "f") for key, value in first.items()
    )


def flips_that_lie(col: Path, spare: Path, files: list[Path], count: int) -> tuple[list[str], int]:
    """Flips after which a reader gets other numbers without an error, and how many raised one."""
    rng = random.Random(5)  # noqa: S311
    return damages_that_lie(col, spare, [rng.choice(files) for _ in range(count)], lambda path: flip(path, rng))


def damages_that_lie(col: Path, spare: Path, files: list[Path], harm: Callable[[Path], None]) -> tuple[list[str], int]:
    """Files after whose damage a reader gets other numbers without an error, and how many raised one.

    A capture that is no longer called finished is no wrong number.
    """
    truth, lies, refused = numbers(col), [], 0
    for path in files:
        shutil.copy2(path, spare)
        harm(path)
        try:
            found = numbers(col)
        except Exception:  # noqa: BLE001 - any error is a clear sign; what matters is that nothing wrong is returned
            refused += 1
        else:
            if not same(found, {key: truth[key] for key in found if key in truth}):
                lies.append(str(path.relative_to(col)))
        shutil.copy2(spare, path)
    return lies, refused


def test_a_flipped_bit_is_never_a_wrong_number(tmp_path, captures):
    run(tmp_path / "col", captures)
    stored = [path for path in files_of(tmp_path / "col") if "ledger" not in path.parts]
    chunks = [path for path in stored if path.name != "zarr.json"]
    arrays = [path for path in stored if path.parent.name in ("mosaic", "disparity", "vignetting")]
    for files in (chunks, arrays):
        assert flips_that_lie(tmp_path / "col", tmp_path / "spare", files, 5)[0] == []


@pytest.mark.heavy
def test_of_a_thousand_flipped_bits_none_is_a_wrong_number(tmp_path, captures):
    run(tmp_path / "col", captures)
    lies, refused = flips_that_lie(tmp_path / "col", tmp_path / "spare", files_of(tmp_path / "col"), 1000)
    sys.stdout.write(f"1000 flips: {refused} refused, {len(lies)} lies\n")
    assert lies == []


def stored_files(col: Path) -> list[Path]:
    return [path for path in files_of(col) if path.relative_to(col).parts[0].endswith(".zarr")]


def test_a_lost_region_is_never_a_wrong_number(tmp_path, captures):
    """Zarr reads a file that is not there as fill values."""
    run(tmp_path / "col", captures)
    finished = store_content(tmp_path / "col")
    next((tmp_path / "col").glob("disparity.zarr/*/disparity/c/1/0/0/0/0")).unlink()
    lazy = open_collection(tmp_path / "col").open("disparity")
    assert np.isfinite(lazy["disparity"].sel(capture=["IMG_0", "IMG_2"]).values).any()
    for read in (lazy, open_collection(tmp_path / "col").open("disparity", chunks=None)):
        with pytest.raises(CollectionError, match=r"disparity/c/1/0/0/0/0 of .* is lost"):
            read["disparity"].sel(capture="IMG_1").load()
    assert_found_and_mended(tmp_path / "col", captures, finished, "a lost region")
    metadata = next((tmp_path / "col").glob("disparity.zarr/*/disparity/zarr.json"))
    metadata.write_text(metadata.read_text().replace('"separator": "/"', '"separator": "."'))
    with pytest.raises(CollectionError, match=r"disparity/c\.\d\.0\.0\.0\.0 of .* is lost"):
        open_collection(tmp_path / "col").open("disparity")["disparity"].load()
    assert_found_and_mended(tmp_path / "col", captures, finished, "a hit separator")
    next((tmp_path / "col").glob("disparity.zarr/*/u/c/0")).unlink()
    with pytest.raises(CollectionError, match=r"u/c/0 of .* is lost"):
        open_collection(tmp_path / "col").open("disparity")


def test_a_growth_that_was_stopped_half_way_hides_nothing_from_readers(tmp_path, captures):
    run(tmp_path / "col", captures)
    finished, before = store_content(tmp_path / "col"), numbers(tmp_path / "col")
    path = next((tmp_path / "col").glob("lightfield.zarr/*/mosaic/zarr.json"))
    metadata = json.loads(path.read_text())
    metadata["shape"][0] += 5
    path.write_text(json.dumps(metadata))
    assert same(numbers(tmp_path / "col"), before)
    assert_found_and_mended(tmp_path / "col", captures, finished, "a growth that was stopped")


@pytest.mark.heavy
def test_no_lost_file_is_a_wrong_number_and_each_is_found_and_mended(tmp_path, captures):
    col = tmp_path / "col"
    run(col, captures)
    finished, files = store_content(col), stored_files(col)
    lies, refused = damages_that_lie(col, tmp_path / "spare", files, Path.unlink)
    sys.stdout.write(f"{len(files)} files lost: {refused} refused, {len(lies)} lies\n")
    assert lies == []
    for path in files:
        path.unlink()
        assert_found_and_mended(col, captures, finished, path.relative_to(col))


def test_a_damaged_region_that_a_run_meets_is_made_anew_by_the_next(tmp_path, captures):
    run(tmp_path / "col", captures)
    finished = store_content(tmp_path / "col")
    flip(next((tmp_path / "col").glob("lightfield.zarr/*/mosaic/c/1/0/0/0/0")), random.Random(6))  # noqa: S311
    outcome = run(tmp_path / "col", captures, config={"disparity": {"offset": 1.0}})
    assert "is damaged" in outcome.failed["IMG_1"]
    assert outcome.counts == {"done": 2, "failed": 1, "kept": 4}
    assert run(tmp_path / "col", captures).exit_code == 0
    assert store_content(tmp_path / "col") == finished
