"""Structure-aware mutation: pictures are changed as JSON and sections, then put together again under right SHA-1s.

Byte mutation alone seldom gets past the hashes; here most mutants have right ones, so that what lies behind is reached.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import struct
from copy import deepcopy
from dataclasses import dataclass, field
from random import Random
from typing import Any

HOSTILE: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 7, 10, 12, 16, 255, 65536, 2**31, 2**32, 2**63, 10**400, -(2**63), 0.5, 1e308,
    -1e-308, "", "x", "big", "little", "gr", "b", "sha1-", "sha1-" + "0" * 40, "\x1b[2J", "../../x", "é\ud800",
    [], {}, [[]], [None] * 20, {"": {}}, [1] * 9, ["a"] * 9,
)  # fmt: skip
HEAD = struct.Struct(">8sII")


@dataclass
class Container:
    """A container before it is written: table of contents and named chunks; JSON is still JSON."""

    toc: Any
    chunks: dict[str, Any]
    order: list[str] = field(default_factory=list)

    def to_bytes(self, random: Random, *, wild: bool) -> bytes:
        bodies = {name: _body(chunk) for name, chunk in self.chunks.items()}
        ids = {name: "sha1-" + hashlib.sha1(body, usedforsecurity=False).hexdigest() for name, body in bodies.items()}
        toc = _body(_with_references(self.toc, ids))
        sections = [(b"\x89LFM\r\n\x1a\n", toc)]
        sections += [(b"\x89LFC\r\n\x1a\n", bodies[name]) for name in self.order or bodies if name in bodies]
        if wild:
            _shuffle(sections, random)
        out = bytearray(HEAD.pack(b"\x89LFP\r\n\x1a\n", 1, 0))
        for magic, body in sections:
            length = len(body)
            if wild and random.random() < 0.05:
                length = random.choice((0, 1, length - 1, length + 1, length + 16, 2**31, 2**32 - 1)) % 2**32
            sha1 = hashlib.sha1(body, usedforsecurity=False).hexdigest()
            out += HEAD.pack(magic, 0, length) + f"sha1-{sha1}".encode().ljust(80, b"\0") + body
            out += bytes(-len(body) % 16 if not wild or random.random() < 0.9 else random.randrange(100))
        return bytes(out)


def mutate_json(value: Any, random: Random) -> Any:
    """A copy with one or two places changed."""
    value = json.loads(json.dumps(value))
    for _ in range(random.choice((1, 1, 1, 2, 2))):
        value = _change(value, random)
    return value


def mutate_bytes(data: bytes, random: Random) -> bytes:
    """A copy that is cut, has bytes changed, doubled, moved or taken out."""
    out = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 4))):
        at = random.randrange(len(out) + 1)
        kind = random.randrange(6)
        if kind == 0:
            del out[at:]
        elif kind == 1 and at < len(out):
            out[at] ^= 1 << random.randrange(8)
        elif kind == 2:
            out[at : at + 4] = random.choice((b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\0\0\0\x01"))
        elif kind == 3:
            del out[at : at + random.randrange(40)]
        elif kind == 4:
            out[at:at] = out[max(0, at - 50) : at]
        else:
            out[at:at] = random.randbytes(random.randrange(20))
    return bytes(out)


def _change(value: Any, random: Random) -> Any:
    places = list(_places(value))
    if not places or random.random() < 0.02:
        return deepcopy(random.choice(HOSTILE))
    parent, key = random.choice(places)
    kind = random.randrange(7)
    if kind == 0:
        del parent[key]
    elif kind == 1:
        other, name = random.choice(places)
        with contextlib.suppress(KeyError, IndexError):
            parent[key] = json.loads(json.dumps(other[name]))
    elif kind == 2:
        deep: Any = parent[key]
        for _ in range(random.choice((1, 5, 70, 200))):
            deep = [deep] if random.random() < 0.5 else {"a": deep}
        parent[key] = deep
    else:
        parent[key] = deepcopy(random.choice(HOSTILE))
    return value


def _places(value: Any) -> Any:
    if isinstance(value, dict):
        for key in value:
            yield value, key
            yield from _places(value[key])
    elif isinstance(value, list):
        for key in range(len(value)):
            yield value, key
            yield from _places(value[key])


def _body(chunk: Any) -> bytes:
    return chunk if isinstance(chunk, bytes) else json.dumps(chunk).encode()


def _with_references(value: Any, ids: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _with_references(item, ids) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_references(item, ids) for item in value]
    return ids.get(value[1:], value) if isinstance(value, str) and value.startswith("@") else value


def _shuffle(sections: list[tuple[bytes, bytes]], random: Random) -> None:
    kind = random.randrange(6)
    if kind == 0:
        random.shuffle(sections)
    elif kind == 1:
        sections.append(random.choice(sections))
    elif kind == 2:
        sections.pop(random.randrange(len(sections)))
    elif kind == 3:
        sections.append((b"\x89LFC\r\n\x1a\n", b""))
    elif kind == 4:
        at = random.randrange(len(sections))
        sections[at] = (random.choice((b"\x89LFM\r\n\x1a\n", b"\x89LFC\r\n\x1a\n", b"rubbish!")), sections[at][1])
