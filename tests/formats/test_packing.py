"""Packing: the published byte layouts, bit by bit, and every size there and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfflow.formats.layout import PACKINGS, FrameLayout
from lfflow.formats.packing import pack, unpack, window

TWELVE, TEN = PACKINGS[12, "big"], PACKINGS[10, "little"]


def test_twelve_bit_golden_bytes() -> None:
    assert unpack(b"\xff\xf0\x00", TWELVE, 2).tolist() == [4095, 0]
    assert unpack(b"\x12\x34\x56", TWELVE, 2).tolist() == [0x123, 0x456]
    assert pack(np.array([0x123, 0x456], np.uint16), TWELVE) == b"\x12\x34\x56"
    # The published sample of Guitar.lfp: 0.284249084249084 = 1164 / 4095.
    assert unpack(b"\x48\xc0\x00", TWELVE, 1)[0] / 4095 == pytest.approx(0.284249084249084, abs=1e-15)


def test_ten_bit_golden_bytes() -> None:
    packed = bytes([0x01, 0x02, 0x03, 0xFF, 0b11_10_01_00])
    assert unpack(packed, TEN, 4).tolist() == [4, 9, 14, 1023]
    assert pack(np.array([4, 9, 14, 1023], np.uint16), TEN) == packed


def bits_of(values: np.ndarray, bits: int) -> np.ndarray:
    return values[:, None] >> np.arange(bits)[::-1] & 1


def test_twelve_bits_against_a_bit_string() -> None:
    values = np.random.default_rng(0).integers(0, 4096, 1000).astype(np.uint16)
    assert pack(values, TWELVE) == np.packbits(bits_of(values, 12).reshape(-1)).tobytes()


def test_ten_bits_against_a_bit_string() -> None:
    values = np.random.default_rng(0).integers(0, 1024, (250, 4)).astype(np.uint16)
    expected = np.empty((250, 5), np.uint8)
    expected[:, :4] = values >> 2
    expected[:, 4] = np.sum((values & 3) * 4 ** np.arange(4), axis=1)
    assert pack(values, TEN) == expected.tobytes()
    assert np.array_equal(unpack(expected.tobytes(), TEN, 1000), values.reshape(-1))


@pytest.mark.parametrize("packing", PACKINGS.values(), ids=str)
@given(count=st.integers(1, 70), seed=st.integers(0, 1000))
@settings(deadline=None, max_examples=40)
def test_every_count_comes_back(packing, count, seed) -> None:
    values = np.random.default_rng(seed).integers(0, 1 << packing.bits, count).astype(np.uint16)
    packed = pack(values, packing)
    assert len(packed) == packing.size(count)
    assert np.array_equal(unpack(packed, packing, count), values)


@pytest.mark.parametrize("packing", PACKINGS.values(), ids=str)
@given(data=st.data())
@settings(deadline=None, max_examples=40)
def test_rows_are_found_in_the_bytes(packing, data) -> None:
    height, width = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 9))
    first = data.draw(st.integers(0, height - 1))
    last = data.draw(st.integers(first + 1, height))
    frame = np.random.default_rng(0).integers(0, 1 << packing.bits, (height, width)).astype(np.uint16)
    packed = pack(frame, packing)
    begin, length, skipped = window(FrameLayout(height, width, packing), first, last)
    got = unpack(packed[begin : begin + length], packing, skipped + (last - first) * width)[skipped:]
    assert np.array_equal(got, frame[first:last].reshape(-1))
    assert length <= packing.size((last - first) * width + 2 * packing.group_samples)


def test_a_sample_too_large_is_refused() -> None:
    with pytest.raises(ValueError, match="4096 does not fit"):
        pack(np.array([4096], np.uint16), TWELVE)
