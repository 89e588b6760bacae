"""The same work on many items, on the cores that a caller may use; kernels release the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


BAND = 32


def bands(rows: int) -> list[tuple[int, int]]:
    """First row and the one after the last, of bands that threads share out."""
    return [(first, min(first + BAND, rows)) for first in range(0, rows, BAND)]


def each(function: Callable[[Item], Result], items: Iterable[Item], threads: int) -> list[Result]:
    """Results of `function` in the order of `items`; the same whatever the number of threads."""
    if threads <= 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, items))
