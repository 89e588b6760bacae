"""How the samples of a sensor frame lie in its bytes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Endianness = Literal["big", "little"]

MAX_SAMPLES = 1 << 28
"""Samples of the largest frame that is opened: six times that of an Illum."""


@dataclass(frozen=True, slots=True)
class Packing:
    """Samples of `bits`, stored in groups of `group_samples` samples in `group_bytes` bytes."""

    bits: int
    endianness: Endianness
    group_samples: int
    group_bytes: int

    def size(self, samples: int) -> int:
        """Bytes that hold `samples` samples."""
        groups, rest = divmod(samples, self.group_samples)
        if not rest:
            return groups * self.group_bytes
        # The low bits of a 10-bit group stand last: there a group is never cut.
        tail = self.group_bytes if self.bits == 10 else -(-rest * self.bits // 8)
        return groups * self.group_bytes + tail


PACKINGS: dict[tuple[int, str], Packing] = {
    (packing.bits, packing.endianness): packing
    for packing in (
        Packing(8, "big", 1, 1),
        Packing(8, "little", 1, 1),
        Packing(10, "little", 4, 5),
        Packing(12, "big", 2, 3),
        Packing(16, "big", 1, 2),
        Packing(16, "little", 1, 2),
    )
}


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """Size and packing of a sensor frame: row-major, top-left first, no padding between rows.

    Each sample is shifted right by `shift` bits after it was unpacked (``pixelFormat.rightShift``).
    """

    height: int
    width: int
    packing: Packing
    shift: int = 0

    @property
    def size(self) -> int:
        """Bytes of the whole frame."""
        return self.packing.size(self.height * self.width)
