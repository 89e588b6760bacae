"""One picture per capture: views, an epipolar image, disparity and error map."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.schema import lattice_of
from lfflow.viz.display import (
    LENS_PIXELS,
    FloatImage,
    graded_radiance,
    one_capture,
    outer_view,
    shown_box,
    to_square,
    to_srgb,
    view_colours,
)

_INK, _PAPER, _EMPTY = "#22262b", "#ffffff", "#c9ccd1"
_EPI_HEIGHT = 12


def draw_quicklook(lightfield: xr.Dataset, disparity: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Draw a capture as a PNG: left, centre and right view, an epipolar image, disparity and its error.

    Parameters
    ----------
    lightfield
        Schema LIGHTFIELD, one capture.
    disparity
        Schema DISPARITY, or the central view alone (t, s); the same capture.
    path
        The PNG to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = quicklook_figure(one_capture(lightfield), one_capture(disparity))
    FigureCanvasAgg(figure).print_png(os.fspath(path), pil_kwargs={"compress_level": 3})  # type: ignore[no-untyped-call]


def quicklook_figure(lightfield: xr.Dataset, disparity: xr.Dataset) -> Any:
    """Matplotlib figure of `draw_quicklook`; no global state is touched."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 11.6), dpi=100, facecolor=_PAPER)
    grid = figure.add_gridspec(
        3, 3, height_ratios=(1, 0.26, 1), left=0.02, right=0.98, top=0.93, bottom=0.03, hspace=0.13, wspace=0.09
    )
    side = outer_view(lightfield)
    colours = {u: view_colours(lightfield, 0, u) for u in (-side, 0, side)}
    white = _white(colours[0], lightfield)
    row = telling_row(disparity)
    squares = {u: to_square(colours[u], lightfield) for u in colours}
    box = shown_box(squares[0])
    for place, (u, label) in enumerate(zip((-side, 0, side), ("left", "centre", "right"), strict=True)):
        axes = figure.add_subplot(grid[0, place])
        axes.imshow(to_srgb(squares[u], lightfield, white=white))
        _crop(axes, box)
        _title(axes, f"{label} view (v = 0, u = {u})")
        if u == 0:
            place_y = (row + 0.5) * lattice_of(lightfield).row_pitch * LENS_PIXELS
            axes.axhline(place_y, color="#ffffff", linewidth=0.7, linestyle=(0, (6, 6)))
    _draw_epi(figure.add_subplot(grid[1, :]), lightfield, row, white)
    _draw_maps(figure, grid, lightfield, disparity, box)
    _write_text(figure.add_subplot(grid[2, 2]), lightfield, disparity)
    name = lightfield["capture"].item() if "capture" in lightfield.coords else "capture"
    figure.suptitle(str(name), x=0.022, y=0.975, ha="left", fontsize=20, color=_INK, fontweight="bold")
    return figure


def _white(colours: FloatImage, lightfield: xr.Dataset) -> float:
    """Level that is shown as white: the brightest but for half a percent."""
    graded = graded_radiance(colours, lightfield)
    return float(np.nanpercentile(graded, 99.5)) if np.isfinite(graded).any() else 1.0


def central(disparity: xr.Dataset, name: str) -> FloatImage:
    """Central view (t, s) of a variable of a disparity dataset."""
    array = disparity[name]
    if "v" in array.dims:
        array = array.sel(v=0)
    if "u" in array.dims:
        array = array.sel(u=0)
    return np.asarray(array.transpose("t", "s").values)


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


def _draw_epi(axes: Any, lightfield: xr.Dataset, row: int, white: float) -> None:
    """Lens row `row` of the views v = 0, one above the other, u growing downwards."""
    strip = lightfield.isel(t=slice(row, row + 1))
    shown = [int(u) for u in lightfield["u"].values if abs(int(u)) <= outer_view(lightfield)]
    lines = np.concatenate([view_colours(strip, 0, u) for u in shown])
    lines = np.stack([_filled(line) for line in lines])
    picture = np.repeat(to_srgb(lines, lightfield, white=white), _EPI_HEIGHT, axis=0)
    axes.imshow(picture, aspect="auto", interpolation="nearest")
    _title(axes, f"epipolar image of lens row t = {row}, u = {shown[0]} … {shown[-1]} downwards")


def _filled(line: FloatImage) -> FloatImage:
    """Values (s, channel) with gaps filled along s, for looking at."""
    filled = line.copy()
    for channel in range(line.shape[1]):
        known = np.flatnonzero(np.isfinite(line[:, channel]))
        if known.size:
            filled[:, channel] = np.interp(np.arange(line.shape[0]), known, line[known, channel])
    return filled


def _crop(axes: Any, box: tuple[int, int, int, int]) -> None:
    y0, y1, x0, x1 = box
    axes.set_xlim(x0 - 0.5, x1 - 0.5)
    axes.set_ylim(y1 - 0.5, y0 - 0.5)


def _draw_maps(
    figure: Any, grid: Any, lightfield: xr.Dataset, disparity: xr.Dataset, box: tuple[int, int, int, int]
) -> None:
    values, error = central(disparity, "disparity"), central(disparity, "disparity_std")
    maps = (
        (values, robust_limits(values, 1, 99), "turbo", "disparity, lens pitches per view step"),
        (error, (0.0, max(robust_limits(error, 0, 95)[1], 0.02)), "magma", "standard deviation of the disparity"),
    )
    for place, (field, (low, high), colours, label) in enumerate(maps):
        axes = figure.add_subplot(grid[2, place])
        axes.set_facecolor(_EMPTY)
        square = to_square(field.astype(np.float32), lightfield)
        drawn = axes.imshow(np.ma.masked_invalid(square), cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        _title(axes, label)
        _crop(axes, box)
        bar = figure.colorbar(drawn, ax=axes, fraction=0.04, pad=0.015, extend="both")
        bar.ax.tick_params(labelsize=9, colors=_INK)
        bar.outline.set_visible(False)


def _title(axes: Any, text: str) -> None:
    axes.set_title(text, fontsize=11, color=_INK, loc="left", pad=5)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)


def _write_text(axes: Any, lightfield: xr.Dataset, disparity: xr.Dataset) -> None:
    axes.axis("off")
    lines = [*_camera_lines(lightfield), ("", ""), *_lattice_lines(lightfield), ("", ""), *_map_lines(disparity)]
    for number, (name, value) in enumerate(lines):
        y = 0.97 - number * 0.052
        axes.text(0.06, y, name, fontsize=11, color="#6a7078", va="top", transform=axes.transAxes)
        axes.text(0.46, y, value, fontsize=11, color=_INK, va="top", transform=axes.transAxes)


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
        text = form.format(value) if value not in (None, "") else "–"
        if name == "zoom_step" and "focus_step" in lightfield.coords:
            text += f", {float(lightfield['focus_step']):.0f}"
        lines.append((label, text))
    return lines


def _lattice_lines(lightfield: xr.Dataset) -> list[tuple[str, str]]:
    lattice = lattice_of(lightfield)
    return [
        ("lens pitch dh", f"{lattice.dh:.5f} px"),
        ("lens pitch dv", f"{lattice.dv:.5f} px"),
        ("rotation θ", f"{lattice.theta * 1e3:.5f} mrad"),
        ("lenses, views", " × ".join(f"{lightfield.sizes[dim]}" for dim in "stuv")),
    ]


def _map_lines(disparity: xr.Dataset) -> list[tuple[str, str]]:
    values, error = central(disparity, "disparity"), central(disparity, "disparity_std")
    known = np.isfinite(values)
    low, high = robust_limits(values, 1, 99)
    median = float(np.median(error[np.isfinite(error)])) if np.isfinite(error).any() else float("nan")
    return [
        ("disparity, 1–99 %", f"{low:+.3f} … {high:+.3f}"),
        ("lenses with disparity", f"{100 * known.mean():.1f} %"),
        ("median std", f"{median:.4f}"),
    ]
