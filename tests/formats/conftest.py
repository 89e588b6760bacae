"""Small pictures of both cameras."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from format_examples import metadata_of


@pytest.fixture
def metadata() -> Callable[..., dict[str, Any]]:
    return metadata_of


@pytest.fixture
def samples() -> np.ndarray[Any, Any]:
    return np.random.default_rng(1).integers(0, 4096, (24, 30)).astype(np.uint16)
