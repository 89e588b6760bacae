"""What every engine owes to xarray and dask: lazy, picklable, many files as one, readable by other processes."""

from __future__ import annotations

import io
import multiprocessing
import pickle
import tarfile
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
import xarray as xr
from format_examples import PRIVATE, metadata_of
from scipy.io import savemat

from lfflow.formats.archives import write_storage
from lfflow.formats.eslf import write_eslf
from lfflow.formats.lfp import write_lfp
from lfflow.formats.raw_pair import pair_bytes, write_pair
from lfflow.formats.toolbox import write_toolbox
from lfflow.formats.views import as_floats, write_views

SHAPE = (24, 30)
Made = tuple[str, str, str, np.ndarray[Any, Any]]


def samples(number: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(number).integers(0, 1024, SHAPE).astype(np.uint16)


def views(number: int) -> xr.Dataset:
    integers = np.random.default_rng(number).integers(0, 256, (3, 3, 8, 10, 3)).astype(np.uint8)
    return xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), as_floats(integers))})


def container(folder: Path, number: int, suffix: str = "lfp") -> Made:
    path = folder / f"IMG_{number}.{suffix}"
    camera = "f01" if suffix == "lfp" else "illum"
    write_lfp(path, samples(number), metadata_of(camera, *SHAPE), PRIVATE)
    return str(path), "lfp", "raw", samples(number)


def pair(folder: Path, number: int) -> Made:
    write_pair(folder / f"MOD_{number}.RAW", samples(number), metadata_of("illum", *SHAPE), PRIVATE)
    return str(folder / f"MOD_{number}.RAW"), "lfp", "raw", samples(number)


def plain_tar(path: Path, files: dict[str, bytes]) -> None:
    with tarfile.open(path, "w") as tar:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))


def archived(folder: Path, number: int, *, storage: bool = True) -> Made:
    image, text = pair_bytes(samples(number), metadata_of("f01", *SHAPE), PRIVATE)
    files = {"C:\\T1CALIB\\MOD_0001.RAW": image, "C:\\T1CALIB\\MOD_0001.TXT": text}
    path = folder / (f"data.C.{number}" if storage else f"caldata-{number}.tar")
    if storage:
        write_storage(path, files)
    else:
        plain_tar(path, files)
    return f"{path}::MOD_0001.RAW", "lfp", "raw", samples(number)


def view_folder(folder: Path, number: int) -> Made:
    write_views(folder / f"scene{number}", views(number))
    return str(folder / f"scene{number}"), "views", "rgb", views(number)["rgb"].values


def lenslets(folder: Path, number: int) -> Made:
    write_eslf(folder / f"{number}_eslf.png", views(number))
    return str(folder / f"{number}_eslf.png"), "eslf", "rgb", views(number)["rgb"].values


def toolbox(folder: Path, number: int, *, packed: bool = False) -> Made:
    path = folder / f"{number}.mat"
    write_toolbox(path, views(number))
    if packed:
        integers = np.rint(views(number)["rgb"].values * 65535).astype(np.uint16)
        savemat(path, {"LF": integers}, do_compression=True)
    return str(path), "lftoolbox", "rgb", views(number)["rgb"].values


SOURCES: dict[str, Callable[[Path, int], Made]] = {
    "lfp": container,
    "lfr": lambda folder, number: container(folder, number, "lfr"),
    "pair": pair,
    "storage": archived,
    "tar": lambda folder, number: archived(folder, number, storage=False),
    "views": view_folder,
    "eslf": lenslets,
    "mat -v6": toolbox,
    "mat -v7": lambda folder, number: toolbox(folder, number, packed=True),
}
every_source = pytest.mark.parametrize("make", SOURCES.values(), ids=SOURCES)


@every_source
def test_engine_is_guessed_and_opening_computes_nothing(make, tmp_path, no_compute) -> None:
    path, engine, name, _ = make(tmp_path, 1)
    guessed, told = xr.open_dataset(path, chunks={}), xr.open_dataset(path, engine=engine, chunks={})
    assert guessed[name].chunks == told[name].chunks
    assert dask.is_dask_collection(guessed)


@every_source
def test_pickled_datasets_read_the_same(make, tmp_path) -> None:
    path, engine, name, values = make(tmp_path, 2)
    lazy = xr.open_dataset(path, engine=engine)
    again = pickle.loads(pickle.dumps(lazy))  # noqa: S301
    assert not again[name].variable._in_memory
    assert len(pickle.dumps(lazy)) < 20_000, "the samples stay in the file"
    assert np.array_equal(again[name].values, values)


@every_source
def test_chunks_hold_the_same(make, tmp_path) -> None:
    path, engine, name, values = make(tmp_path, 3)
    last = values.ndim - 1
    chunks = {"y": 7, "x": 11} if name == "raw" else {"v": 2, "u": 1, "t": 3, "channel": 2}
    with dask.config.set(scheduler="threads"):
        lazy = xr.open_dataset(path, engine=engine)[name].chunk(chunks)
        assert np.array_equal(lazy.values, values)
        assert np.array_equal(lazy[..., ::-2].values, np.flip(values, last)[..., ::2])


@every_source
def test_many_files_open_as_one(make, tmp_path) -> None:
    made = [make(tmp_path, number) for number in range(3)]
    _, engine, name, _ = made[0]
    how: dict[str, Any] = {"combine": "nested", "concat_dim": "capture", "coords": "all", "compat": "override", "join": "override"}  # fmt: skip  # noqa: E501
    with dask.config.set(scheduler="threads"):
        ds = xr.open_mfdataset([path for path, *_ in made], engine=engine, parallel=True, **how)
        assert ds[name].sizes["capture"] == 3
        for number, (*_, values) in enumerate(made):
            assert np.array_equal(ds[name].isel(capture=number).values, values)


def test_other_processes_read_what_was_opened_here(tmp_path) -> None:
    made = {source: make(tmp_path, 4) for source, make in SOURCES.items()}
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        opened = {source: xr.open_dataset(path, engine=engine) for source, (path, engine, *_) in made.items()}
        loaded = {source: pool.submit(xr.Dataset.load, ds) for source, ds in opened.items()}
        for source, (*_, name, values) in made.items():
            assert np.array_equal(loaded[source].result()[name].values, values), source


def bytes_read() -> int:
    """Bytes that this process has asked the system to read so far."""
    return int(Path("/proc/self/io").read_text().split()[1])


def cost(work: Callable[[], object]) -> int:
    """Bytes that work reads, when it has been done before."""
    work()
    before = bytes_read()
    work()
    return bytes_read() - before


needs_counter = pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="the system counts no bytes")


@needs_counter
@pytest.mark.parametrize(("camera", "bits"), [("f01", 12), ("illum", 10)])
def test_opening_reads_headers_and_a_window_reads_its_rows(tmp_path, camera, bits) -> None:
    height, width = 600, 1000
    raw = np.random.default_rng(0).integers(0, 1 << bits, (height, width)).astype(np.uint16)
    path = tmp_path / "IMG.lfr"
    write_lfp(path, raw, metadata_of(camera, height, width), PRIVATE)
    assert cost(lambda: xr.open_dataset(path, engine="lfp")) < path.stat().st_size / 15
    lazy = xr.open_dataset(path, engine="lfp")["raw"]
    row = width * bits // 8
    assert row * 10 <= cost(lambda: lazy[100:110].values) <= row * 10 + 2 * io.DEFAULT_BUFFER_SIZE
    assert cost(lambda: lazy[100:110, 3:5].values) <= row * 10 + 2 * io.DEFAULT_BUFFER_SIZE
    assert np.array_equal(lazy[100:110, 3:5].values, raw[100:110, 3:5])
    whole = row * height
    assert whole <= cost(lambda: lazy[:height].values) <= whole + 2 * io.DEFAULT_BUFFER_SIZE


@needs_counter
@pytest.mark.parametrize("storage", [True, False])
def test_opening_an_image_of_an_archive_reads_no_image(tmp_path, storage) -> None:
    height, width = 400, 1000
    raw = np.zeros((height, width), np.uint16)
    image, text = pair_bytes(raw, metadata_of("f01", height, width), PRIVATE)
    files = {name: data for n in range(3) for name, data in ((f"MOD_{n:04d}.RAW", image), (f"MOD_{n:04d}.TXT", text))}
    path = tmp_path / "data.C.0"
    if storage:
        write_storage(path, files)
    else:
        plain_tar(path, files)
    assert path.stat().st_size > 3 * len(image)
    assert cost(lambda: xr.open_dataset(f"{path}::MOD_0001.RAW", engine="lfp")) < 200_000
    lazy = xr.open_dataset(f"{path}::MOD_0001.RAW", engine="lfp")["raw"]
    assert cost(lambda: lazy[5:9].values) <= 4 * 1500 + 2 * io.DEFAULT_BUFFER_SIZE


@needs_counter
def test_opening_views_reads_their_headers_and_one_view_its_file(tmp_path) -> None:
    integers = np.random.default_rng(0).integers(0, 256, (5, 5, 200, 300, 3)).astype(np.uint8)
    write_views(tmp_path, xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), as_floats(integers))}))
    one = (tmp_path / "input_Cam007.png").stat().st_size
    assert cost(lambda: xr.open_dataset(tmp_path, engine="views")) < 25 * io.DEFAULT_BUFFER_SIZE + 20_000
    lazy = xr.open_dataset(tmp_path, engine="views")["rgb"]
    assert cost(lambda: lazy[1, 2, :3].values) < 1.1 * one + 2 * io.DEFAULT_BUFFER_SIZE


@needs_counter
def test_opening_a_lenslet_picture_reads_its_header(tmp_path) -> None:
    integers = np.random.default_rng(0).integers(0, 256, (5, 5, 60, 80, 3)).astype(np.uint8)
    write_eslf(tmp_path / "a_eslf.png", xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), as_floats(integers))}))
    assert (tmp_path / "a_eslf.png").stat().st_size > 300_000
    assert cost(lambda: xr.open_dataset(tmp_path / "a_eslf.png", engine="eslf")) < 60_000


def test_a_huge_toolbox_file_is_mapped_and_not_read(tmp_path) -> None:
    path = tmp_path / "a.mat"
    write_toolbox(path, views(0))
    data = bytearray(path.read_bytes())
    old, new = np.array([3, 3, 8, 10, 3], "<i4"), np.array([3, 3, 6000, 7000, 3], "<i4")
    size = int(np.prod(new, dtype=np.int64)) * 2
    shape_at = data.find(old.tobytes())
    size_at = data.find((int(np.prod(old)) * 2).to_bytes(4, "little"), shape_at)
    data[shape_at : shape_at + 20] = new.tobytes()
    data[size_at : size_at + 4] = size.to_bytes(4, "little")
    data[132:136] = (size_at + 4 + size - 136).to_bytes(4, "little")
    path.write_bytes(data)
    with path.open("r+b") as file:  # 2.3 GB, of holes
        file.truncate(size_at + 4 + size)
    tracemalloc.start()
    lazy = xr.open_dataset(path, engine="lftoolbox")["rgb"]
    assert lazy.shape == (3, 3, 6000, 7000, 3)
    assert lazy[1, 1, 5000:5004, 6000:6005].values.shape == (4, 5, 3)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()
