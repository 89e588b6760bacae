"""Every kind of broken file ends in one error that names file, section, what was found and what was expected."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import xarray as xr
from broken_examples import BROKEN, BROKEN_SAMPLES, picture

from lfflow.formats import errors
from lfflow.formats.container import open_container
from lfflow.formats.describe import describe
from lfflow.formats.lfp import open_lfp


@pytest.mark.parametrize("name", BROKEN)
def test_opening_says_what_is_wrong(tmp_path, name) -> None:
    make, kind, parts = BROKEN[name]
    path = make(tmp_path)
    with pytest.raises(errors.FileFormatError) as caught:
        describe(path)
    message = str(caught.value)
    assert type(caught.value).__name__ == kind, message
    assert message.startswith(str(path.with_suffix("")))
    assert ": found " in message
    assert ", expected " in message
    for part in parts:
        assert part in message
    assert str(pickle.loads(pickle.dumps(caught.value))) == message  # noqa: S301


@pytest.mark.parametrize("name", BROKEN_SAMPLES)
def test_reading_says_what_is_wrong(tmp_path, name) -> None:
    make, kind, parts = BROKEN_SAMPLES[name]
    ds = xr.open_dataset(make(tmp_path))
    with pytest.raises(errors.FileFormatError) as caught:
        ds.load()
    assert type(caught.value).__name__ == kind, str(caught.value)
    for part in parts:
        assert part in str(caught.value)


def test_every_kind_of_error_has_an_example() -> None:
    kinds = {kind for _, kind, _ in (*BROKEN.values(), *BROKEN_SAMPLES.values())}
    subclasses = {error.__name__ for error in errors.FileFormatError.__subclasses__()}
    assert kinds == subclasses - {"UnreadableError"}


@pytest.mark.parametrize("end", range(0, 2400, 37))
def test_a_picture_cut_anywhere(tmp_path, end) -> None:
    path = tmp_path / "a.lfp"
    whole = picture(path)
    last = open_container(path).sections[-1].region
    path.write_bytes(whole[: min(end, last.offset + last.length - 1)])
    with pytest.raises(errors.FileFormatError, match=str(path)):
        open_lfp(path)


def test_what_the_system_refuses(tmp_path) -> None:
    import os

    os.mkfifo(tmp_path / "pipe.lfp")
    for name, found in (("none.lfp", "No such file"), ("a\0b.lfp", "null byte"), ("pipe.lfp", "a device or a pipe")):
        with pytest.raises(errors.UnreadableError, match=found):
            xr.open_dataset(f"{tmp_path}/{name}", engine="lfp")
    with pytest.raises(errors.UnreadableError, match="a device or a pipe"):
        open_lfp("/dev/zero")


def flip(data: bytes, at: int, bit: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :]


def test_every_flipped_bit_of_an_image_is_noticed(tmp_path) -> None:
    path = tmp_path / "a.lfp"
    whole = picture(path)
    region = open_container(path).sections[-1].region
    for at in range(region.offset, region.offset + region.length):
        path.write_bytes(flip(whole, at, at % 8))
        with pytest.raises(errors.ChecksumError):
            open_lfp(path)["raw"][1:2, :2].load()
        ds = open_lfp(path, accept_damaged=True)
        assert "SHA-1" in ds.attrs["damaged"]
        assert np.sum(ds["raw"].values != np.arange(24).reshape(4, 6)) == 1
