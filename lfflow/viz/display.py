"""What the pictures of a capture share: square pixels and the part worth showing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.schema import lattice_of

FloatImage = npt.NDArray[np.float32]

LENS_PIXELS = 2
"""Picture pixels a lens pitch."""


def shown_box(square: FloatImage) -> tuple[int, int, int, int]:
    """First and last row and column (y0, y1, x0, x1) of a picture that are known in their greater part."""
    known = np.isfinite(square).reshape(*square.shape[:2], -1).any(axis=-1)
    rows, columns = (np.flatnonzero(known.mean(axis=axis) > 0.5) for axis in (1, 0))
    if not rows.size or not columns.size:
        return 0, square.shape[0], 0, square.shape[1]
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


def to_square(lenses: FloatImage, lightfield: xr.Dataset) -> FloatImage:
    """Values (t, s[, channel]) of the lenses on square pixels, `LENS_PIXELS` a lens pitch, NaN where there is none."""
    import cv2

    lattice = lattice_of(lightfield)
    rows, columns = lenses.shape[:2]
    height, width = round(rows * lattice.row_pitch * LENS_PIXELS), LENS_PIXELS * columns
    row = (np.arange(height) + 0.5) / (lattice.row_pitch * LENS_PIXELS) - 0.5
    column = (np.arange(width) + 0.5) / LENS_PIXELS - 0.5
    low = np.clip(np.floor(row), 0, rows - 1)
    picture = np.zeros((height, width, *lenses.shape[2:]), dtype=np.float32)
    for t, share in ((low, 1 - (row - low)), (np.minimum(low + 1, rows - 1), row - low)):
        x = column[None, :] - lattice.row_offset(t)[:, None]
        y = np.broadcast_to(t[:, None], x.shape)
        part = cv2.remap(lenses, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR,
                         borderMode=cv2.BORDER_CONSTANT, borderValue=(np.nan,) * 4)  # fmt: skip
        factor = np.clip(share, 0, 1).reshape(-1, *[1] * (part.ndim - 1))
        picture += np.where(factor > 0, factor * part, 0).astype(np.float32)
    return picture


def one_capture(ds: xr.Dataset) -> xr.Dataset:
    """Dataset of a single capture without its ``capture`` dim."""
    if "capture" not in ds.dims:
        return ds
    if ds.sizes["capture"] != 1:
        raise ValueError(f"one capture at a time is drawn, not {ds.sizes['capture']}")
    return ds.isel(capture=0)
