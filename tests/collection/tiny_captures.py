"""Tiny captures for the tests of the catalogue: text files for its logic, real containers for its contents."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from lfflow.errors import FormatError
from lfflow.simulate.body import BODIES, Setting
from lfflow.simulate.metadata import frame_metadata, private_metadata

TIME = np.datetime64("2013-05-01T12:00:00", "ns")


def write_text(path: Path, kind: str = "scene", text: str = "") -> Path:
    """A capture that is its kind in words; what begins with "broken" cannot be read."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{kind} {text}")
    return path


def open_text(path: str) -> xr.Dataset:
    kind, _, text = Path(path).read_text().partition(" ")
    if kind == "broken":
        raise FormatError(f"{path}: found {text!r}, expected a capture")
    return xr.Dataset(
        {"raw": (("y", "x"), np.zeros((4, 6), "uint16"))},
        coords={"kind": kind, "camera_model": "T1", "camera_serial": "A1", "iso": float(len(text)), "time": TIME},
    )


def metadata_of(camera: str, height: int, width: int, **setting: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Metadata and private metadata as the cameras write them."""
    body = BODIES[camera]
    found = frame_metadata(body, Setting(**setting), height, width, TIME)
    found["camera"]["model"] = body.model.name
    return found, private_metadata(body)


def lens_pattern(height: int, width: int, pitch: float = 10.0) -> np.ndarray:
    """Light behind a hexagonal lens array, 0 to 1: bright in the middle of a lens, dark between three."""
    y, x = np.mgrid[:height, :width].astype(float)
    rows = 2 * np.pi / (pitch * np.sqrt(3) / 2)
    columns = 2 * np.pi / pitch
    waves = np.cos(columns * x + rows / 2 * y) + np.cos(columns * x - rows / 2 * y) + np.cos(rows * y)
    return np.clip((waves + 1.5) / 4.5 * 1.6, 0.05, 1)


def frame_of(light: np.ndarray, seed: int = 0, black: float = 168, white: float = 4095) -> np.ndarray:
    """Samples of a sensor in light from 0 to 1, with photon and read noise."""
    rng = np.random.default_rng(seed)
    signal = light * (white - black)
    noisy = signal + rng.normal(0, 1, light.shape) * np.sqrt(signal / 3 + 9)
    return np.clip(np.round(noisy + black), 0, white).astype(np.uint16)


def touch_later(path: Path, seconds: float = 10) -> None:
    state = path.stat()
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + int(seconds * 1e9)))
