"""One picture per capture: views, focus near and far, an epipolar image, disparity and error map."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.kernels.colour.gather import Rule
from lfflow.kernels.threads import each
from lfflow.schema import lattice_of
from lfflow.stages.epi import epi
from lfflow.stages.picture import develop, to_integers
from lfflow.stages.reconstruct import reconstruct_views
from lfflow.stages.samples import usable_reach
from lfflow.viz.canvas import INK, SOFT, Canvas, FloatImage, coloured, palette
from lfflow.viz.display import one_capture, shown_box, to_square

_WIDTH, _MARGIN, _SIDE, _HEAD, _CAPTION = 1560, 24, 488, 62, 24
_EPI_ROW, _EPI_LINES = 12, 16
_MAPS = ("disparity", "disparity_std")
_DISPARITY = "disparity, lens pitches per view step", cv2.COLORMAP_TURBO
_ERROR = "standard deviation of the disparity", cv2.COLORMAP_MAGMA
_ANY_SURFACE = Rule(radius=1.3, tolerance=1e3, lift=0.6, stiffness=0.5, likeness=0.5)
"""Samples of all surfaces: a picture focused on a plane, what lies off it blurred."""
_OFF_FOCUS = 0.3
"""Disparity off the plane at which a place is blurred by more than the distance of two lens rows."""


def draw_quicklook(
    lightfield: xr.Dataset, disparity: xr.Dataset, path: str | os.PathLike[str], *, threads: int = 1
) -> None:
    """Draw a capture as a PNG.

    Left view, centre view with everything in focus, right view; focused near and far; an epipolar image with the
    lines of the disparity; the disparity and its error.

    Parameters
    ----------
    lightfield
        Schema LIGHTFIELD, one capture.
    disparity
        Schema DISPARITY, or the central view alone (t, s); the same capture.
    path
        The PNG to write.
    threads
        Cores to use; the picture does not depend on it.
    """
    Path(path).write_bytes(quicklook(one_capture(lightfield), one_capture(disparity), threads=threads).png())


def quicklook(lightfield: xr.Dataset, disparity: xr.Dataset, *, threads: int = 1) -> Canvas:
    """The sheet of `draw_quicklook`."""
    disparity = _every_view(lightfield, disparity)
    row = telling_row(disparity)
    pictures = _pictures(lightfield, disparity, threads)
    squares = {name: to_square(picture, lightfield) for name, picture in pictures.items()}
    box = shown_box(squares["centre view, everything in focus"])
    height = round(_SIDE * (box[1] - box[0]) / max(box[3] - box[2], 1))
    strip = _epi(lightfield, disparity, row)
    epi_height = _EPI_ROW * strip.sizes["u"]
    sheet = Canvas(_WIDTH, _HEAD + 3 * (height + _CAPTION + 14) + epi_height + _CAPTION + 20)
    name = lightfield["capture"].item() if "capture" in lightfield.coords else "capture"
    sheet.text(_MARGIN, 16, str(name), size=28)
    y = _HEAD
    for start in (0, 3):
        for place, (label, picture) in enumerate(list(squares.items())[start : start + 3]):
            x = _MARGIN + place * (_SIDE + _MARGIN)
            sheet.text(x, y, label)
            shown = picture[box[0] : box[1], box[2] : box[3]]
            sheet.picture(x, y + _CAPTION, _SIDE, height, np.rint(np.nan_to_num(shown) * 255).astype(np.uint8))
        y += height + _CAPTION + 14
    _draw_epi(sheet, y, strip, lightfield, row)
    below = y + epi_height + _CAPTION + 14
    right = _MARGIN + 2 * (_SIDE + _MARGIN)
    values, error = central(disparity, "disparity"), central(disparity, "disparity_std")
    beside = right, y - height - _CAPTION - 14
    _draw_map(sheet, beside, height, to_square(values, lightfield), box, robust_limits(values, 1, 99), _DISPARITY)
    limits = 0.0, max(robust_limits(error, 0, 95)[1], 0.02)
    _draw_map(sheet, (_MARGIN, below), height, to_square(error, lightfield), box, limits, _ERROR)
    columns = _camera_lines(lightfield), [*_lattice_lines(lightfield), ("", ""), *_map_lines(disparity)]
    for x, lines in zip((right - _SIDE - _MARGIN + 30, right), columns, strict=True):
        _write_text(sheet, x, below + _CAPTION, lines)
    return sheet


def _every_view(lightfield: xr.Dataset, disparity: xr.Dataset) -> xr.Dataset:
    """Disparity of every view; that of the centre for all where it alone is known."""
    if "v" in disparity["disparity"].dims:
        return disparity
    lone = disparity.drop_vars(["v", "u"], errors="ignore")
    return lone.expand_dims(v=lightfield["v"].values, u=lightfield["u"].values)


def _pictures(lightfield: xr.Dataset, disparity: xr.Dataset, threads: int) -> dict[str, FloatImage]:
    """Screen values (t, s, channel) of five pictures, all under one exposure."""
    side = max(usable_reach(lightfield), 1)
    far, near = robust_limits(central(disparity, "disparity"), 10, 90)
    views = [("left view", -side), ("centre view, everything in focus", 0), ("right view", side)]
    wanted: dict[str, tuple[xr.Dataset, int, Rule | None]] = {
        f"{label} (v = 0, u = {u})" if u else label: (disparity, u, None) for label, u in views
    }
    for label, d in (("focused near", near), ("focused far", far)):
        wanted[f"{label} (disparity {d:+.2f})"] = _plane(disparity, d), 0, _ANY_SURFACE
    found = each(lambda picture: _view(lightfield, *picture), wanted.values(), threads)
    for place, d in ((3, near), (4, far)):
        found[place] = _even_blur(found[place], central(disparity, "disparity") - d)
    shown = develop(xr.concat(found, "picture"), lightfield)
    return dict(zip(wanted, shown.transpose("picture", "t", "s", "channel").values, strict=True))


def _even_blur(picture: xr.DataArray, off: FloatImage) -> xr.DataArray:
    """Picture without the comb that blurred edges wear, for each row has its red and blue from every other view row.

    `off` is how far the scene's disparity is from that in focus; what is in focus stays as it is.
    """
    known = np.isfinite(picture.values)
    values = np.where(known, picture.values, 0)
    near = np.maximum(cv2.GaussianBlur(known.astype(np.float32), (3, 7), 0.6, sigmaY=1.2), 1e-6)
    even = cv2.GaussianBlur(values, (3, 7), 0.6, sigmaY=1.2) / near
    share = np.clip(np.abs(np.nan_to_num(off)) / _OFF_FOCUS, 0, 1)[..., None]
    return picture.copy(data=np.where(known, values + share * (even - values), np.nan).astype(np.float32))


def _plane(disparity: xr.Dataset, d: float) -> xr.Dataset:
    """Disparity `d` at every place of the central view; what the other views' is does not matter to `_ANY_SURFACE`."""
    flat = {name: disparity[name].copy(data=np.zeros(disparity[name].shape, np.float32)) for name in _MAPS}
    flat["disparity"].loc[{"v": 0, "u": 0}] = d
    return disparity.assign(flat)


def _view(lightfield: xr.Dataset, disparity: xr.Dataset, u: int, rule: Rule | None = None) -> xr.DataArray:
    views = reconstruct_views(lightfield, disparity, views={"v": [0], "u": [u]}, rule=rule)
    return views["rgb"].isel(v=0, u=0, drop=True).reset_coords(drop=True)


def _epi(lightfield: xr.Dataset, disparity: xr.Dataset, row: int) -> xr.Dataset:
    """Epipolar image of a lens row of the views v = 0 and the lines of its disparity."""
    side = max(usable_reach(lightfield), 1)
    wanted = {"v": [0], "u": list(range(-side, side + 1))}
    reach = {"t": slice(max(row - 8, 0), row + 9)}
    strip = reconstruct_views(lightfield.isel(reach), disparity.isel(reach), views=wanted, shared=False)
    return epi(strip, t=int(lightfield["t"][row]), every=_EPI_LINES)


def _draw_epi(sheet: Canvas, y: int, strip: xr.Dataset, lightfield: xr.Dataset, row: int) -> None:
    u = strip["u"].values
    sheet.text(_MARGIN, y, f"epipolar image of lens row t = {row}, u = {u[0]} ... {u[-1]} downwards, "
               "and the lines that the estimated disparity draws in it")  # fmt: skip
    shown = to_integers(develop(strip["epi"].drop_vars(["t", "v"]).rename(u="t"), lightfield))
    width = _WIDTH - 2 * _MARGIN
    wide = cv2.resize(shown, (width, shown.shape[0]), interpolation=cv2.INTER_LINEAR)
    sheet.picture(_MARGIN, y + _CAPTION, width, _EPI_ROW * len(u), np.repeat(wide, _EPI_ROW, axis=0))
    x = (strip["line"].transpose("line", "u").values - float(strip["s"][0]) + 0.5) * width / strip.sizes["s"]
    places = (np.arange(len(u)) + 0.5) * _EPI_ROW
    inside = np.isfinite(x).all(axis=1) & (x >= 0).all(axis=1) & (x < width).all(axis=1)
    sheet.lines(_MARGIN, y + _CAPTION, [np.stack([line, places], axis=1) for line in x[inside]], (230, 60, 40))


def central(disparity: xr.Dataset, name: str) -> FloatImage:
    """Central view (t, s) of a variable of a disparity dataset."""
    array = disparity[name]
    if "v" in array.dims:
        array = array.sel(v=0)
    if "u" in array.dims:
        array = array.sel(u=0)
    return np.asarray(array.transpose("t", "s").values, dtype=np.float32)


def robust_limits(values: npt.NDArray[np.floating], low: float, high: float) -> tuple[float, float]:
    """Percentiles of the finite values, at least 0.02 apart."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    first, last = (float(p) for p in np.percentile(finite, (low, high)))
    middle, half = (first + last) / 2, max((last - first) / 2, 0.01)
    return middle - half, middle + half


def telling_row(disparity: xr.Dataset) -> int:
    """Lens row in the middle half of the picture whose disparities differ most: the one for the epipolar image."""
    values = central(disparity, "disparity")
    rows = values.shape[0]
    spread = np.zeros(rows)
    for t in range(rows // 4, max(3 * rows // 4, rows // 4 + 1)):
        finite = values[t][np.isfinite(values[t])]
        if finite.size > values.shape[1] // 3:
            spread[t] = float(np.subtract(*np.percentile(finite, (92, 8))))
    return int(np.argmax(spread)) if spread.any() else rows // 2


def _draw_map(
    sheet: Canvas,
    place: tuple[int, int],
    height: int,
    square: FloatImage,
    box: tuple[int, int, int, int],
    limits: tuple[float, float],
    style: tuple[str, int],
) -> None:
    """A map on square pixels with its caption and colour bar; `style` is the caption and the OpenCV colour map."""
    (x, y), width, colours = place, _SIDE - 62, palette(style[1])
    sheet.text(x, y, style[0])
    high = round(height * width / _SIDE)
    shown = coloured(square[box[0] : box[1], box[2] : box[3]], *limits, colours)
    sheet.picture(x, y + _CAPTION, width, high, shown)
    sheet.bar(x + width + 6, y + _CAPTION, high, colours, *limits)


def _write_text(sheet: Canvas, x: int, y: int, lines: Sequence[tuple[str, str]]) -> None:
    for number, (name, value) in enumerate(lines):
        sheet.text(x, y + 25 * number, name, colour=SOFT)
        sheet.text(x + 190, y + 25 * number, value, colour=INK)


def _camera_lines(lightfield: xr.Dataset) -> list[tuple[str, str]]:
    lines = []
    for name, label, form in (
        ("camera_model", "camera", "{}"),
        ("camera_serial", "serial number", "{}"),
        ("time", "time (UTC)", "{}"),
        ("iso", "ISO", "{:.0f}"),
        ("exposure_time", "exposure time", "{:.4g} s"),
        ("f_number", "f-number", "{:.3g}"),
        ("focal_length", "focal length", "{:.4g} m"),
        ("zoom_step", "zoom, focus step", "{:.0f}"),
    ):
        value = lightfield[name].item() if name in lightfield.coords else None
        if name == "time" and value is not None:
            value = np.datetime_as_string(lightfield[name].values.astype("datetime64[s]"))
        text = form.format(value) if value not in (None, "") else "-"
        if name == "zoom_step" and "focus_step" in lightfield.coords:
            text += f", {float(lightfield['focus_step']):.0f}"
        lines.append((label, text))
    return lines


def _lattice_lines(lightfield: xr.Dataset) -> list[tuple[str, str]]:
    lattice = lattice_of(lightfield)
    return [
        ("lens pitch dh", f"{lattice.dh:.5f} px"),
        ("lens pitch dv", f"{lattice.dv:.5f} px"),
        ("rotation", f"{lattice.theta * 1e3:.5f} mrad"),
        ("lenses, views", " x ".join(f"{lightfield.sizes[dim]}" for dim in "stuv")),
    ]


def _map_lines(disparity: xr.Dataset) -> list[tuple[str, str]]:
    values, error, flags = (central(disparity, name) for name in ("disparity", "disparity_std", "flags"))
    known = np.isfinite(values)
    sure = known & (flags == 0)
    low, high = robust_limits(values, 1, 99)
    return [
        ("disparity, 1-99 %", f"{low:+.3f} ... {high:+.3f}"),
        ("lenses with disparity", f"{100 * known.mean():.1f} %"),
        ("of them without a flag", f"{100 * sure.sum() / max(known.sum(), 1):.1f} %"),
        ("median std of these", f"{np.median(error[sure]):.4f}" if sure.any() else "unknown"),
    ]
