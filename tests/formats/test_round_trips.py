"""Every format that is written is read back the same: all sizes, bit depths, mosaics and byte orders."""

from __future__ import annotations

import io
import json
import tarfile

import numpy as np
import xarray as xr
from format_examples import PRIVATE, metadata_of
from hypothesis import given, settings
from hypothesis import strategies as st

from lfflow.formats.archives import archive_entries, write_storage
from lfflow.formats.eslf import write_eslf
from lfflow.formats.lfp import read_hot_pixels, write_lfp
from lfflow.formats.pfm import read_pfm, write_pfm
from lfflow.formats.png import read_png, write_png
from lfflow.formats.raw_pair import pair_bytes, write_pair
from lfflow.formats.toolbox import write_toolbox
from lfflow.formats.views import as_floats, write_views
from lfflow.schema import RAW, VIEWS

PATTERNS = {"r": "RGGB", "gr": "GRBG", "gb": "GBRG", "b": "BGGR"}
DIMS = ("v", "u", "t", "s", "channel")
properties = settings(deadline=None, max_examples=40)


@st.composite
def frames(draw):
    """A camera, its metadata and samples that they describe."""
    camera = draw(st.sampled_from(["f01", "illum"]))
    bits = draw(st.sampled_from([8, 10, 12, 16]))
    height, width = draw(st.integers(1, 13)), draw(st.integers(1, 13))
    corner = draw(st.sampled_from(sorted(PATTERNS)))
    shift = draw(st.integers(0, bits - 6))
    metadata = metadata_of(camera, height, width, bits, corner)
    details = metadata["image"].get("rawDetails", metadata["image"])
    top = (1 << bits - shift) - 1
    sites = ("r", "gr", "gb", "b")
    levels = {"black": dict.fromkeys(sites, 8), "white": dict.fromkeys(sites, top)}
    details["pixelFormat"] = {"rightShift": shift, **levels}
    samples = np.random.default_rng(draw(st.integers(0, 99))).integers(0, top + 1, (height, width)).astype(np.uint16)
    return camera, corner, metadata, samples


def same_frame(ds: xr.Dataset, corner: str, metadata: dict, samples: np.ndarray) -> None:
    RAW.check(ds)
    assert np.array_equal(ds["raw"].values, samples)
    assert np.array_equal(ds["raw"][-1:, ::2].values, samples[-1:, ::2])
    assert str(ds["cfa_pattern"].values) == PATTERNS[corner]
    assert str(ds["camera_serial"].values) == PRIVATE["camera"]["serialNumber"]
    assert json.loads(ds.attrs["metadata"]) == metadata


@given(frame=frames(), extension=st.sampled_from(["lfp", "lfr", "LFP", "LFR"]), embed=st.booleans())
@properties
def test_containers(tmp_path_factory, frame, extension, embed) -> None:
    _, corner, metadata, samples = frame
    path = tmp_path_factory.mktemp("p") / f"IMG_0001.{extension}"
    hot = ([0, 7], [3, 1])
    write_lfp(path, samples, metadata, PRIVATE, modulation=samples // 2, hot_pixels=hot, embed_metadata=embed)
    same_frame(xr.open_dataset(path, engine="lfp"), corner, metadata, samples)
    white = xr.open_dataset(path, engine="lfp", image="modulation")
    assert np.array_equal(white["raw"].values, samples // 2)
    assert str(white["kind"].values) == "white"
    pixels = read_hot_pixels(path)
    assert (pixels["x"].values.tolist(), pixels["y"].values.tolist()) == hot


@given(frame=frames(), dark=st.booleans())
@properties
def test_pairs(tmp_path_factory, frame, dark) -> None:
    _, corner, metadata, samples = frame
    path = tmp_path_factory.mktemp("p") / "MOD_0001.RAW"
    write_pair(path, samples, metadata, PRIVATE, white=not dark, dark=dark)
    for half in (path, path.with_suffix(".TXT")):
        ds = xr.open_dataset(half, engine="lfp")
        same_frame(ds, corner, metadata, samples)
        assert str(ds["kind"].values) == ("dark" if dark else "white")


@given(many=st.lists(frames(), min_size=1, max_size=4), storage=st.booleans())
@settings(deadline=None, max_examples=25)
def test_archives(tmp_path_factory, many, storage) -> None:
    files = {}
    for number, (_, _, metadata, samples) in enumerate(many):
        image, text = pair_bytes(samples, metadata, PRIVATE)
        files |= {f"C:\\T1CALIB\\MOD_{number:04d}.RAW": image, f"C:\\T1CALIB\\MOD_{number:04d}.TXT": text}
    path = tmp_path_factory.mktemp("p") / ("data.C.0" if storage else "caldata-B5143909630.tar")
    if storage:
        write_storage(path, files)
    else:
        path.write_bytes(tar_bytes({name.replace("C:\\T1CALIB\\", "unitdata/"): data for name, data in files.items()}))
    entries = list(archive_entries(path))
    assert [entry.name for entry in entries] == [f"MOD_{number:04d}.RAW" for number in range(len(many))]
    for entry, (_, corner, metadata, samples) in zip(entries, many, strict=True):
        same_frame(xr.open_dataset(entry.path, engine="lfp"), corner, metadata, samples)


def tar_bytes(files: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as tar:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return buffer.getvalue()


@st.composite
def light_fields(draw, sides):
    """Views whose values are integers of 8 or 16 bits."""
    bits, side = draw(st.sampled_from([8, 16])), draw(sides)
    shape = (side, side, draw(st.integers(1, 6)), draw(st.integers(1, 6)), 3)
    kind = np.uint8 if bits == 8 else np.uint16
    integers = np.random.default_rng(draw(st.integers(0, 99))).integers(0, 1 << bits, shape).astype(kind)
    return bits, xr.Dataset({"rgb": (DIMS, as_floats(integers))})


def same_views(back: xr.Dataset, ds: xr.Dataset) -> None:
    VIEWS.check(back)
    assert np.array_equal(back["rgb"].values, ds["rgb"].values)
    assert np.array_equal(back["rgb"][:, -1, 0, :, 1].values, ds["rgb"][:, -1, 0, :, 1].values)


@given(field=light_fields(st.sampled_from([1, 3, 5, 9])))
@settings(deadline=None, max_examples=20)
def test_folders_of_views(tmp_path_factory, field) -> None:
    bits, ds = field
    folder = tmp_path_factory.mktemp("views")
    write_views(folder, ds.transpose("channel", "s", "v", "t", "u"), bits=bits)
    assert sorted(path.name for path in folder.glob("*.png"))[0] == "input_Cam000.png"
    back = xr.open_dataset(folder, engine="views")
    same_views(back, ds)
    assert back["v"].values.tolist() == list(range(-(ds.sizes["v"] // 2), ds.sizes["v"] // 2 + 1))


@given(field=light_fields(st.integers(1, 15)))
@properties
def test_lenslet_pictures(tmp_path_factory, field) -> None:
    bits, ds = field
    path = tmp_path_factory.mktemp("p") / "a_eslf.png"
    write_eslf(path, ds.transpose("channel", "s", "v", "t", "u"), bits=bits)
    same_views(xr.open_dataset(path), ds)


@given(field=light_fields(st.integers(1, 9)), weight=st.booleans())
@properties
def test_toolbox_files(tmp_path_factory, field, weight) -> None:
    _, ds = field  # the values of 8 bits are values of 16 bits: 65535 = 257 · 255
    if weight:
        ds["weight"] = ds["rgb"][..., 1]
    path = tmp_path_factory.mktemp("p") / "LF.mat"
    write_toolbox(path, ds.transpose("channel", "s", "v", "t", "u"))
    back = xr.open_dataset(path)
    same_views(back, ds)
    assert ("weight" in back) == weight
    if weight:
        assert np.array_equal(back["weight"].values, ds["weight"].values)


@given(height=st.integers(1, 9), width=st.integers(1, 9), colour=st.booleans(), order=st.sampled_from("<>"))
@properties
def test_float_maps(tmp_path_factory, height, width, colour, order) -> None:
    shape = (height, width, 3) if colour else (height, width)
    values = np.random.default_rng(height).standard_normal(shape).astype(np.float32)
    values.reshape(-1)[:2] = [np.nan, -np.inf][: values.size]
    path = tmp_path_factory.mktemp("p") / "a.pfm"
    write_pfm(path, values, order=order)
    head, data = path.read_bytes()[:3], path.read_bytes()[-values.nbytes :]
    assert head == (b"PF\n" if colour else b"Pf\n")
    assert data == values[::-1].astype(f"{order}f4").tobytes()
    assert np.array_equal(read_pfm(path), values, equal_nan=True)


@given(height=st.integers(1, 9), width=st.integers(1, 9), bits=st.sampled_from([8, 16]), colour=st.booleans())
@properties
def test_pictures(tmp_path_factory, height, width, bits, colour) -> None:
    kind = np.uint8 if bits == 8 else np.uint16
    shape = (height, width, 3) if colour else (height, width)
    picture = np.random.default_rng(width).integers(0, 1 << bits, shape).astype(kind)
    path = tmp_path_factory.mktemp("p") / "a.png"
    write_png(path, picture)
    back = read_png(path)
    assert back.dtype == kind
    assert np.array_equal(back, picture if colour else np.repeat(picture[..., None], 3, axis=2))
