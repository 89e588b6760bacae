"""What all tests share: a scheduler that refuses to compute, and the folder of real captures."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import dask
import pytest


class UnwantedComputeError(AssertionError):
    """Something was computed that should have stayed lazy."""


def _refuse(*args: object, **kwargs: object) -> None:
    raise UnwantedComputeError("a dask graph was computed that should have stayed lazy")


@contextmanager
def raise_if_dask_computes() -> Iterator[None]:
    with dask.config.set(scheduler=_refuse):
        yield


@pytest.fixture
def no_compute() -> Iterator[None]:
    with raise_if_dask_computes():
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    root = Path(os.environ.get("LFFLOW_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no real captures at {root} (set LFFLOW_DATA)")
    return root
