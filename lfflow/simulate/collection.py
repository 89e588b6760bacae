"""A folder of simulated files: white image, captures, and the truth in a zarr store beside them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from lfflow.simulate.body import BODIES, Body, Setting
from lfflow.simulate.capture import simulate_capture, simulate_white
from lfflow.simulate.metadata import private_metadata

TRUTH = "truth.zarr"
RGB_VIEWS = (-4, 0, 4)
"""View offsets whose radiance is kept; disparity is kept for every view."""
FOCUS, FOCUS_REACH = 582.0, (-200, 400)
"""Focus step of captures, and how far from it they go when the zoom varies too."""
ISO_STEPS = (80.0, 100.0, 125.0, 200.0)


def simulate_collection(
    out: str | Path,
    captures: int = 3,
    seed: int = 0,
    camera: str | Body = "f01",
    *,
    zooms: int = 1,
    focuses: int = 1,
    scene: str = "natural",
    height: int | None = None,
    width: int | None = None,
    **options: Any,
) -> list[Path]:
    """Write white images and captures as the camera's files, with their truth.

    Files: ``WHITE_0001.lfp`` (one for each zoom and focus), ``IMG_0001.lfp`` and on, and ``truth.zarr`` with a group
    per file: the scalars of the lattice; for captures also disparity(v, u, t, s) of every view and, in the subgroup
    ``views``, rgb(v, u, t, s, channel) of nine views.

    Parameters
    ----------
    out
        Folder; made when missing.
    captures
        Number of captures.
    seed
        Source of all chance; one seed gives the same bytes everywhere.
    camera
        "f01", "illum" or a `Body`.
    zooms
        Number of zoom settings that the captures take in turn. With more than one, the pitch varies as 1 + f/Z.
    focuses
        Number of focus settings, over which the white images of each zoom are spread; one: that of a capture.
    scene
        Kind of the scenes: "natural" or "hard" (`simulate_capture`).
    height, width
        Sensor size, pixels; the camera's by default.
    options
        Passed to `simulate_capture` and `simulate_white`: ``optics``, ``noise``.

    Returns
    -------
    list of Path
        The files, white images first.
    """
    body = BODIES[camera] if isinstance(camera, str) else camera
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    settings = settings_of(body, captures, seed, zooms)
    size: dict[str, Any] = {"height": height, "width": width, "seed": seed, "camera": body}
    files = []
    for number, setting in enumerate(white_settings(body, settings, zooms, focuses)):
        name = f"WHITE_{number + 1:04d}"
        raw, truth = simulate_white(setting=setting, capture=name, **size, **options)
        files.append(write_capture(folder, raw, body))
        _write_truth(folder / TRUTH, truth, ("vignetting",))
    for number, setting in enumerate(settings):
        name = f"IMG_{number + 1:04d}"
        raw, truth, views = _capture(setting, name, {"scene": scene, **size, **options})
        files.append(write_capture(folder, raw, body))
        _write_truth(folder / TRUTH, truth, ())
        views.to_zarr(folder / TRUTH, group=f"{name}/views", mode="w", zarr_format=3, consolidated=False)
    return files


def _capture(setting: Setting, name: str, options: dict[str, Any]) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """Raw frame, truth with the disparity of all views, and the radiance of some."""
    raw, truth = simulate_capture(setting=setting, capture=name, rgb_views=RGB_VIEWS, **options)
    views = truth[["rgb"]].rename({"rgb_v": "v", "rgb_u": "u"}).drop_vars("capture")
    views["channel"] = np.array(views["channel"].values, dtype=np.dtypes.StringDType())
    return raw, truth.drop_dims(["rgb_v", "rgb_u", "channel"]), views


def settings_of(body: Body, captures: int, seed: int, zooms: int) -> list[Setting]:
    """Setting of every capture: zooms in turn from the wide end on, focus and sensitivity by chance."""
    steps = _zoom_steps(body, zooms)
    settings = []
    for number in range(captures):
        rng = np.random.default_rng([seed, 3, number])
        iso = ISO_STEPS[int(rng.integers(len(ISO_STEPS)))]
        focus = FOCUS + (round(float(rng.uniform(*FOCUS_REACH))) if zooms > 1 else 0)
        settings.append(Setting(steps[number % zooms], focus, iso, round(float(iso) / 80 / 60, 6)))
    return settings


def white_settings(body: Body, settings: list[Setting], zooms: int, focuses: int) -> list[Setting]:
    """Settings of the white images: those of the first captures, or a grid of `zooms` × `focuses`."""
    if focuses == 1:
        return [
            replace(settings[n % len(settings)] if settings else Setting(), iso=body.base_iso) for n in range(zooms)
        ]
    reach = np.linspace(*FOCUS_REACH, focuses)
    return [
        Setting(zoom, FOCUS + round(float(shift)), body.base_iso)
        for zoom in _zoom_steps(body, zooms)
        for shift in reach
    ]


def _zoom_steps(body: Body, zooms: int) -> list[int]:
    wide, tele = body.wide[0], body.tele[0]
    return [round(wide + (tele - wide) * i / max(zooms, 2)) for i in range(zooms)]


def write_capture(folder: Path, raw: xr.Dataset, body: Body) -> Path:
    """Write a raw dataset as the camera's container, named after its capture."""
    from lfflow.formats.lfp import write_lfp

    path = folder / f"{raw['capture'].item()}.lfp"
    white = raw["kind"].item() == "white"
    write_lfp(path, raw["raw"].values, json.loads(raw.attrs["metadata"]), private_metadata(body), white=white)
    return path


def _write_truth(store: Path, truth: xr.Dataset, leave_out: tuple[str, ...]) -> None:
    name = str(truth["capture"].item())
    kept = truth.drop_vars(["capture", *leave_out])
    encoding: dict[str, Any] = {}
    for variable in ("disparity",):
        if variable in kept:
            encoding[variable] = {"chunks": (1, kept.sizes["u"], kept.sizes["t"], kept.sizes["s"])}
    kept.to_zarr(store, group=name, mode="w", zarr_format=3, consolidated=False, encoding=encoding)


def open_truth(folder: str | Path, capture: str) -> xr.Dataset:
    """Truth of one file of a simulated folder; its radiance is in ``open_truth(folder, "IMG_0001/views")``."""
    truth: xr.Dataset = xr.open_zarr(Path(folder) / TRUTH, group=capture, zarr_format=3, consolidated=False)
    return truth
