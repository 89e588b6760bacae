"""Structure-aware mutants of what is no LFP container: fields are changed, then checksums and lengths made right again.

Each function makes one mutant of its kind from a random generator; the unchanged file is within reach of it.
"""

from __future__ import annotations

import json
import struct
import zlib
from random import Random
from typing import Any

import numpy as np
from format_mutations import mutate_bytes, mutate_json

NUMBERS = (0, 1, 2, 3, 4, 5, 8, 9, 255, 256, 512, 65535, 2**16, 2**24, 2**28, 2**31 - 1, 2**31, 2**32 - 1)


def maybe(value: Any, random: Random, among: tuple[Any, ...] = NUMBERS, chance: float = 0.12) -> Any:
    return random.choice(among) if random.random() < chance else value


def mutate_document(text: bytes, random: Random) -> bytes:
    """JSON with a place changed, or with what strangers' editors leave around it."""
    if random.random() < 0.15:
        return mutate_bytes(text, random)
    new = json.dumps(mutate_json(json.loads(text), random)).encode()
    around = random.randrange(8)
    return (b"\xef\xbb\xbf" if around == 0 else b"") + new + (b"\0" * random.randrange(9) if around < 3 else b"")


def png_mutant(random: Random, bits: int = 8) -> bytes:
    """A PNG of 8 × 6 RGB samples with right CRCs and (mostly) a right zlib stream."""
    width, height, depth, color = 8, 6, bits, 2
    rows = b"".join(b"\0" + bytes(range(r, r + 3 * width * depth // 8)) for r in range(height))
    head = struct.pack(
        ">IIBBBBB", maybe(width, random), maybe(height, random), maybe(depth, random, (0, 1, 2, 3, 4, 8, 16, 32)),
        maybe(color, random, (0, 1, 2, 3, 4, 5, 6, 7)), 0, 0, maybe(0, random, (0, 1, 2)),
    )  # fmt: skip
    packed = zlib.compress(maybe(rows, random, (b"", rows[:9], rows * 2, bytes(70_000))))
    if random.random() < 0.1:
        packed = mutate_bytes(packed, random)
    side = maybe(b"2", random, (b"", b"0", b"1", b"7", b"99", b"-2", b"\xb2", b"x" * 9, b"1e9"), 0.3)
    chunks = [(b"IHDR", head), (b"tEXt", b"views\0" + side), (b"IDAT", packed), (b"IEND", b"")]
    kind = random.randrange(8)
    if kind == 0:
        random.shuffle(chunks)
    elif kind == 1:
        chunks.insert(random.randrange(1, 4), random.choice(chunks))
    elif kind == 2:
        chunks.pop(random.randrange(4))
    elif kind == 3:
        chunks.insert(1, (random.choice((b"PLTE", b"tRNS", b"iCCP", b"acTL", b"eXIf", b"zTXt")), random.randbytes(9)))
    out = b"\x89PNG\r\n\x1a\n"
    for name, body in chunks:
        length = len(body) if random.random() < 0.97 else random.choice(NUMBERS)
        out += struct.pack(">I", length) + name + body + struct.pack(">I", zlib.crc32(name + body))
    return mutate_bytes(out, random) if random.random() < 0.15 else out


def tar_mutant(members: dict[str, bytes], random: Random) -> bytes:
    """A tar with right header checksums."""
    out = b""
    for name, data in members.items():
        body = mutate_document(data, random) if name.endswith(".TXT") and random.random() < 0.5 else data
        body = mutate_bytes(body, random) if random.random() < 0.05 else body
        label = maybe(
            name, random, ("../../x.RAW", "/MOD_0000.RAW", "a/MOD_0000.TXT", "", "\x1b[2J.raw", "é" * 40), 0.1
        )
        flag = maybe(
            b"0", random, (b"\0", b"1", b"2", b"3", b"5", b"6", b"7", b"K", b"L", b"S", b"x", b"g", b"V"), 0.15
        )
        size = f"{maybe(len(body), random, chance=0.05):011o}".encode()[-12:]
        size = maybe(size, random, (b"-0000000001", b"\x80" + b"\xff" * 10, b"99999999999", b"", b"7" * 12), 0.04)
        out += tar_header(label.encode(), size, flag) + body + bytes(-len(body) % 512)
    out += bytes(random.choice((0, 512, 1024, 10240)))
    return mutate_bytes(out, random) if random.random() < 0.15 else out


def tar_header(name: bytes, size: bytes, flag: bytes) -> bytes:
    head = bytearray(512)
    head[: len(name[:100])] = name[:100]
    head[124 : 124 + len(size)] = size
    head[148:156] = b" " * 8
    head[156:157] = flag
    head[257:265] = b"ustar\x0000"
    head[148:155] = f"{sum(head):06o}\0".encode()
    return bytes(head)


def mat_mutant(random: Random, *, compressed: bool) -> bytes:
    """A MATLAB file of version 5 with an array LF of 3 × 3 × 2 × 2 × 4 samples."""
    shape = [3, 3, 2, 2, 4]
    values = np.arange(np.prod(shape), dtype="<u2").tobytes()
    axis = random.randrange(5)
    shape[axis] = maybe(shape[axis], random, (0, 1, 2, 3, 4, -1, 2**31 - 1, 2**20), 0.2)
    shape = maybe(shape, random, ([], [3, 3], [1] * 60, [2**30] * 5, [3, 3, 2, 2, 3, 1]), 0.05)
    stored = maybe(4, random, (0, 1, 2, 3, 5, 6, 7, 9, 12, 13, 14, 15, 99), 0.1)
    flags = struct.pack("<II", maybe(11, random, (0, 1, 4, 6, 7, 8, 9, 13, 0x0B0B, 0x80B), 0.1), 0)
    body = _element(6, flags, random) + _element(5, struct.pack(f"<{len(shape)}i", *shape), random)
    body += _element(1, maybe(b"LF", random, (b"", b"LG", b"LF" * 40, b"\xff"), 0.05), random)
    body += _element(stored, maybe(values, random, (b"", values[:7], values * 3), 0.1), random)
    element = _element(14, body, random)
    if compressed:
        packed = zlib.compress(element + maybe(b"", random, (bytes(9), bytes(99_999)), 0.05))
        packed = mutate_bytes(packed, random) if random.random() < 0.1 else packed
        element = struct.pack("<II", 15, maybe(len(packed), random, chance=0.03)) + packed
    head = b"MATLAB 5.0".ljust(124, b" ") + maybe(b"\0\1IM", random, (b"\1\0MI", b"\0\2IM", b"    "), 0.02)
    out = head + maybe(b"", random, (_element(14, b"", random), _element(9, bytes(16), random)), 0.1) + element
    return mutate_bytes(out, random) if random.random() < 0.1 else out


def _element(kind: int, data: bytes, random: Random) -> bytes:
    if len(data) <= 4 and kind == 1 and random.random() < 0.5:
        return struct.pack("<HH", kind, len(data)) + data.ljust(4, b"\0")
    return struct.pack("<II", kind, maybe(len(data), random, chance=0.03)) + data + bytes(-len(data) % 8)


def pfm_mutant(random: Random) -> bytes:
    """A float map, grey or in colour, of either byte order."""
    color = random.random() < 0.5
    width, height = (maybe(size, random, (*NUMBERS, -1, "x", "1.5", "9" * 12)) for size in (4, 3))
    scale = random.choice(("-1.0", "1.0", "1", "-0.003922", *("0", "nan", "inf", "1e999", "-", ".", "1e-400", "x", "")))
    gap = random.choice(("\n", " ", "\r\n", "\t"))
    head = f"{'PF' if color else 'Pf'}\n{width}{gap}{height}\n{scale}\n".encode()
    out = head + np.arange(12 * (3 if color else 1), dtype="<f4").tobytes()
    return mutate_bytes(out, random) if random.random() < 0.3 else out


def cfg_mutant(random: Random) -> bytes:
    """A parameters.cfg of a 3 × 3 grid."""
    values = ("3", "9", "0", "-3", "4", "1e300", "nan", "inf", "", "%(x)s", "9" * 5000, "3.5", "0x3")
    names = ("num_cams_x", "num_cams_y", "baseline_mm", "disp_min", "focal_length_mm")
    lines = [f"{name} {random.choice('=:')} {random.choice(values) if random.random() < 0.3 else 3}" for name in names]
    lines.insert(0, maybe("[extrinsics]", random, ("", "[", "[]", "[DEFAULT]", "[a]\n[a]", "x" * 40_000)))
    if random.random() < 0.2:
        lines.insert(random.randrange(len(lines)), random.choice((" continued", "no value", "=", ":", ";", "[meta]")))
    out = "\n".join(lines).encode()
    return mutate_bytes(out, random) if random.random() < 0.3 else out
