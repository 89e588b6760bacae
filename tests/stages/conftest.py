from __future__ import annotations

import pytest
import xarray as xr

from tests.mosaic_fields import lightfield, plane


@pytest.fixture(scope="session")
def tilted() -> xr.Dataset:
    """A noisy plane at d = 0.3."""
    return lightfield(plane(0.3), noise=0.002)
