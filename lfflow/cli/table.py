"""Text tables: columns as wide as they need to be, and what is written to a terminal made harmless."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def lines(rows: Iterable[Sequence[object]], header: Sequence[str] = ()) -> list[str]:
    """Lines of a table, two spaces between columns."""
    texts = [[printable(cell) for cell in row] for row in rows]
    if header:
        texts.insert(0, list(header))
    if not texts:
        return []
    widths = [max(len(row[column]) for row in texts) for column in range(len(texts[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in texts]


def printable(value: object) -> str:
    """Text of a value without anything that would move the cursor: names and reasons come from files."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in str(value))


def size(count: float) -> str:
    """Bytes in the unit that a person would choose."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if count < 1024:
            return f"{count:.0f} {unit}" if unit == "B" or count >= 10 else f"{count:.1f} {unit}"
        count /= 1024
    return f"{count:.1f} TiB"


def duration(seconds: float) -> str:
    """Seconds as a person would say them."""
    if seconds < 90:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
