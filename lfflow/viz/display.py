"""Views of a mosaicked light field as pictures for people: every colour at every lens, square pixels, sRGB."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.conventions import CFA_NONE, FIELD_DIMS
from lfflow.schema import lattice_of

FloatImage = npt.NDArray[np.float32]

LENS_PIXELS = 2
"""Picture pixels a lens pitch."""
_TENT = {(dv, du): 0.5 ** (abs(dv) + abs(du)) for dv in (-1, 0, 1) for du in (-1, 0, 1)}


def view_colours(lightfield: xr.Dataset, v: int, u: int) -> FloatImage:
    """Radiance (t, s, channel) of one view, its missing colours taken from the adjacent views at the same lens.

    It mixes views one sensor pixel apart, so it is good for looking at, and for nothing else.

    Parameters
    ----------
    lightfield
        Schema LIGHTFIELD, one capture.
    v, u
        The view.
    """
    total = np.zeros((3, lightfield.sizes["t"], lightfield.sizes["s"]), dtype=np.float32)
    weight = np.zeros_like(total)
    for (dv, du), share in _TENT.items():
        if v + dv not in lightfield["v"] or u + du not in lightfield["u"]:
            continue
        view = lightfield[["mosaic", "cfa"]].sel(v=v + dv, u=u + du).transpose("t", "s")
        mosaic, cfa = view["mosaic"].values, view["cfa"].values
        known = (cfa != CFA_NONE) & np.isfinite(mosaic)
        for channel in range(3):
            here = known & (cfa == channel)
            total[channel][here] += share * mosaic[here]
            weight[channel][here] += share
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.moveaxis(_without_holes(total / weight), 0, -1)


def _without_holes(channels: FloatImage) -> FloatImage:
    """Channels (channel, t, s) with single missing lenses filled by the mean of their four neighbours."""
    padded = np.pad(channels, ((0, 0), (1, 1), (1, 1)), constant_values=np.nan)
    around = np.stack([padded[:, :-2, 1:-1], padded[:, 2:, 1:-1], padded[:, 1:-1, :-2], padded[:, 1:-1, 2:]])
    enough = np.isfinite(around).sum(axis=0) >= 3
    mean = np.nansum(around, axis=0) / np.maximum(np.isfinite(around).sum(axis=0), 1)
    return np.where(np.isfinite(channels) | ~enough, channels, mean)


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


def to_srgb(radiance: FloatImage, lightfield: xr.Dataset, *, white: float) -> FloatImage:
    """Display colours (…, channel) in 0..1: white balance, colour matrix, gamma (seed 5.2, 5.3.4, 5.3.5).

    Parameters
    ----------
    white
        Level of the brightest colour, after white balance and matrix.
    """
    graded = graded_radiance(radiance, lightfield) / max(white, 1e-6)
    gamma = float(lightfield["gamma"]) if "gamma" in lightfield.coords else 1 / 2.4
    gamma = gamma if np.isfinite(gamma) and gamma > 0 else 1 / 2.4
    return np.asarray(np.clip(np.nan_to_num(graded, nan=0.0), 0, 1) ** gamma, dtype=np.float32)


def graded_radiance(radiance: FloatImage, lightfield: xr.Dataset) -> FloatImage:
    """Radiance (…, channel) after white balance and colour matrix, where the light field carries them."""
    graded: npt.NDArray[np.floating] = radiance
    if "white_balance" in lightfield.coords:
        gains = lightfield["white_balance"].values
        graded = graded * (gains if np.all(np.isfinite(gains)) else np.ones(3))
    if "color_matrix" in lightfield.coords:
        matrix = lightfield["color_matrix"].transpose("channel", "channel_in").values
        graded = np.minimum(graded, 1.5) @ (matrix.T if np.all(np.isfinite(matrix)) else np.eye(3))
    return np.asarray(graded, dtype=np.float32)


def one_capture(ds: xr.Dataset) -> xr.Dataset:
    """Dataset of a single capture without its ``capture`` dim."""
    if "capture" not in ds.dims:
        return ds
    if ds.sizes["capture"] != 1:
        raise ValueError(f"one capture at a time is drawn, not {ds.sizes['capture']}")
    return ds.isel(capture=0)


def outer_view(lightfield: xr.Dataset, *, least: float = 0.4, share: float = 0.95) -> int:
    """Largest u ≥ 1 whose views (0, ±u) get `least` of the light, and at least `share` of the centre's samples."""
    field = lightfield["weight"].sel(v=0).transpose("u", *FIELD_DIMS[2:])
    lit = {int(u): _positive(field.sel(u=u).values) for u in lightfield["u"].values}
    enough = share * lit[0].size
    for u in range(max(lit), 1, -1):
        if all(lit[side].size >= enough and np.median(lit[side]) >= least for side in (-u, u)):
            return u
    return 1


def _positive(values: FloatImage) -> FloatImage:
    kept = values[values > 0]
    return kept if kept.size else np.zeros(1, dtype=np.float32)
