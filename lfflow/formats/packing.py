"""Sensor samples packed to 8, 10, 12 or 16 bits, as the cameras store them (METHOD B.2).

12 bits, big-endian: bytes b0 b1 b2 hold ``p0 = b0 << 4 | b1 >> 4`` and ``p1 = (b1 & 15) << 8 | b2``.
10 bits, little-endian: bytes b0 … b4 hold ``p_k = b_k << 2 | (b4 >> 2k) & 3``, k = 0…3.
An odd last sample of 12 bits takes two bytes; a last group of 10 bits is filled up with zeros.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from lfflow.formats.layout import FrameLayout, Packing

Bytes = npt.NDArray[np.uint8]
Samples = npt.NDArray[np.uint16]


@numba.njit(nogil=True, cache=True)
def unpack12(packed: Bytes, samples: Samples) -> None:
    """Fill `samples` (n,) from `packed` (⌈3n/2⌉,)."""
    pairs = samples.size // 2
    for i in range(pairs):
        middle = np.uint16(packed[3 * i + 1])
        samples[2 * i] = np.uint16(packed[3 * i]) << np.uint16(4) | middle >> np.uint16(4)
        samples[2 * i + 1] = (middle & np.uint16(15)) << np.uint16(8) | np.uint16(packed[3 * i + 2])
    if samples.size % 2:
        samples[2 * pairs] = np.uint16(packed[3 * pairs]) << np.uint16(4) | np.uint16(packed[3 * pairs + 1]) >> 4


@numba.njit(nogil=True, cache=True)
def pack12(samples: Samples, packed: Bytes) -> None:
    """Fill `packed` (⌈3n/2⌉,) from `samples` (n,), each below 4096."""
    pairs = samples.size // 2
    for i in range(pairs):
        first, second = samples[2 * i], samples[2 * i + 1]
        packed[3 * i] = first >> 4
        packed[3 * i + 1] = (first & 15) << 4 | second >> 8
        packed[3 * i + 2] = second & 255
    if samples.size % 2:
        last = samples[2 * pairs]
        packed[3 * pairs] = last >> 4
        packed[3 * pairs + 1] = (last & 15) << 4


def unpack10(packed: Bytes, samples: Samples) -> None:
    """Fill `samples` (n,) from `packed` (5⌈n/4⌉,)."""
    groups = samples.size // 4
    if groups:
        # Four bytes of every five as one word, wherever it lies, and the fifth; four samples are one word to write.
        high = np.ndarray((groups,), np.uint32, packed, 0, (5,))
        _spread10(high, packed[4 : 5 * groups : 5], samples[: 4 * groups].view(np.uint64))
    rest = samples[4 * groups :]
    if rest.size:
        last = packed[5 * groups : 5 * groups + 5].astype(np.uint16)
        rest[:] = last[: rest.size] << 2 | last[4] >> 2 * np.arange(rest.size, dtype=np.uint16) & 3


@numba.njit(nogil=True, cache=True)
def _spread10(high: npt.NDArray[np.uint32], low: Bytes, quads: npt.NDArray[np.uint64]) -> None:
    """Four samples a word: the bytes of `high`, the pairs of bits of `low`, are moved to lanes of 16 bits by halves."""
    for i in range(quads.size):
        tops, bottoms = np.uint64(high[i]), np.uint64(low[i])
        tops = (tops | tops << np.uint64(16)) & np.uint64(0x0000FFFF0000FFFF)
        tops = (tops | tops << np.uint64(8)) & np.uint64(0x00FF00FF00FF00FF)
        bottoms = (bottoms | bottoms << np.uint64(28)) & np.uint64(0x0000000F0000000F)
        bottoms = (bottoms | bottoms << np.uint64(14)) & np.uint64(0x0003000300030003)
        quads[i] = tops << np.uint64(2) | bottoms


@numba.njit(nogil=True, cache=True)
def pack10(samples: Samples, packed: Bytes) -> None:
    """Fill `packed` (5⌈n/4⌉,) from `samples` (n,), each below 1024."""
    groups = samples.size // 4
    for i in range(groups):
        p0, p1, p2, p3 = samples[4 * i], samples[4 * i + 1], samples[4 * i + 2], samples[4 * i + 3]
        packed[5 * i] = p0 >> np.uint16(2)
        packed[5 * i + 1] = p1 >> np.uint16(2)
        packed[5 * i + 2] = p2 >> np.uint16(2)
        packed[5 * i + 3] = p3 >> np.uint16(2)
        packed[5 * i + 4] = (p0 & 3) | (p1 & 3) << 2 | (p2 & 3) << 4 | (p3 & 3) << 6
    rest = samples.size - 4 * groups
    if rest:
        packed[5 * groups : 5 * groups + 5] = 0
        for k in range(rest):
            packed[5 * groups + k] = samples[4 * groups + k] >> 2
            packed[5 * groups + 4] |= (samples[4 * groups + k] & 3) << (2 * k)


def unpack(data: bytes, packing: Packing, count: int) -> Samples:
    """The first `count` samples that are packed in `data`.

    Returns
    -------
    ndarray of uint16, shape (count,)
    """
    packed = np.frombuffer(data, np.uint8)
    if packing.bits == 8:
        return packed[:count].astype(np.uint16)
    if packing.bits == 16:
        order = ">u2" if packing.endianness == "big" else "<u2"
        return packed[: 2 * count].view(order).astype(np.uint16)
    samples = np.empty(count, np.uint16)
    (unpack12 if packing.bits == 12 else unpack10)(packed, samples)
    return samples


def pack(samples: npt.NDArray[np.uint16], packing: Packing) -> bytes:
    """Bytes of `samples` (any shape, row by row).

    Raises
    ------
    ValueError
        If a sample does not fit into the bits.
    """
    flat = np.ascontiguousarray(samples, np.uint16).reshape(-1)
    if packing.bits < 16 and flat.size and int(flat.max()) >> packing.bits:
        raise ValueError(f"sample {int(flat.max())} does not fit into {packing.bits} bits")
    if packing.bits == 8:
        return flat.astype(np.uint8).tobytes()
    if packing.bits == 16:
        return flat.astype(">u2" if packing.endianness == "big" else "<u2").tobytes()
    packed = np.empty(packing.size(flat.size), np.uint8)
    (pack12 if packing.bits == 12 else pack10)(flat, packed)
    return packed.tobytes()


def window(layout: FrameLayout, first: int, last: int) -> tuple[int, int, int]:
    """Bytes that hold rows `first` … `last` − 1: first byte, number of bytes, samples to skip at their start."""
    packing = layout.packing
    start = first * layout.width // packing.group_samples
    skipped = first * layout.width - start * packing.group_samples
    stop = last * layout.width
    begin = start * packing.group_bytes
    end = -(-stop // packing.group_samples) * packing.group_bytes
    return begin, min(end, layout.size) - begin, skipped
