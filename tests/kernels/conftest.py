from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from lfflow.kernels.mosaicked.mosaic_field import MosaicField, mosaic_field
from lfflow.schema import lattice_of
from tests.mosaic_fields import lightfield, plane


def field_of(lf: xr.Dataset) -> MosaicField:
    """The arrays of a light field without labels."""
    axes = tuple(np.asarray(lf[dim]) for dim in ("v", "u", "t", "s"))
    return mosaic_field(lf.mosaic.to_numpy(), lf.cfa.to_numpy(), lf.weight.to_numpy(), axes, lattice_of(lf))


@pytest.fixture(scope="session")
def slab() -> MosaicField:
    """A plane of soft waves at d = 0.3, without noise."""
    return field_of(lightfield(plane(0.3, seed=4, sharpest=0.2), shape=(40, 46)))
