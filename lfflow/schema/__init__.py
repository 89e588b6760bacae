"""Declarations of every dataset that lfflow makes or stores."""

from lfflow.schema.declarations import CALIBRATION, DISPARITY, LIGHTFIELD, RAW, SCHEMAS, VIEWS
from lfflow.schema.lattice_variables import (
    PARAMETERS,
    distortion_numbers,
    distortion_of,
    lattice_of,
    lattice_variables,
)
from lfflow.schema.spec import Issue, Schema, Variable

__all__ = [
    "CALIBRATION",
    "DISPARITY",
    "LIGHTFIELD",
    "PARAMETERS",
    "RAW",
    "SCHEMAS",
    "VIEWS",
    "Issue",
    "Schema",
    "Variable",
    "distortion_numbers",
    "distortion_of",
    "lattice_of",
    "lattice_variables",
]
