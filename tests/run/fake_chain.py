"""A chain of tiny, quick stages on tiny fake captures: what the batch does with them is what is tested."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import numpy as np
import xarray as xr

from lfflow.errors import FormatError
from lfflow.run.chain import Chain, Stage, StageInput
from lfflow.schema import CALIBRATION, DISPARITY, LIGHTFIELD, PARAMETERS

SIZE = 40


def write_capture(path: Path, *, seed: int, kind: str = "scene", **metadata: object) -> Path:
    """A fake capture: JSON that says what the frame holds; `behaviour` makes a stage misbehave."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"seed": seed, "kind": kind, "serial": "S1", "zoom": 100.0, "focus": 10.0, **metadata}))
    return path


def open_fake(path: str) -> xr.Dataset:
    try:
        told = json.loads(Path(path).read_text())
        seed = told["seed"]
    except (ValueError, KeyError) as error:
        raise FormatError(f"{path}: found no fake capture, expected JSON") from error
    frame = np.random.default_rng(seed).integers(0, 4096, (SIZE, SIZE)).astype("uint16")
    return xr.Dataset(
        {"raw": (("y", "x"), frame)},
        coords={
            "kind": told["kind"], "camera_serial": told["serial"], "camera_model": told.get("model", "T1"),
            "zoom_step": told["zoom"], "focus_step": told["focus"], "iso": told.get("iso", 100.0),
            "time": np.datetime64(told.get("time", "2020-01-01"), "ns"), "temperature": 20.0,
            "pixel_pitch": 1.4e-6, "lens_pitch": told.get("lens_pitch", 4.2e-6),
        },
        attrs={"behaviour": told.get("behaviour", "")},
    )  # fmt: skip


def _misbehave(raw: xr.Dataset) -> None:
    behaviour = raw.attrs.get("behaviour", "")
    if behaviour == "crash":
        os.kill(os.getpid(), signal.SIGKILL)
    if behaviour == "raise":
        raise RuntimeError("this one cannot be done")
    if behaviour.startswith("sleep"):
        time.sleep(float(behaviour.removeprefix("sleep")))


def calibrate(raw: xr.Dataset, *, gain: float = 1.0) -> xr.Dataset:
    _misbehave(raw)
    log_call("calibration", raw)
    values = raw["raw"].values
    lattice = dict(zip(PARAMETERS, (9.0 + values[0, 0] / 7000, 10.0, 0.001, 3.0, 4.0), strict=True))
    return xr.Dataset(
        {
            **lattice, "arrangement": np.uint8(0),
            "covariance": (("parameter", "parameter_b"), np.full((5, 5), np.nan)),
            "residual_rms": 0.01, "lens_count": np.int64(30), "method": np.uint8(0),
            "vignetting": (("y", "x"), (gain * values / 4095).astype("float32")),
            "pixel_flags": (("y", "x"), np.zeros(values.shape, "uint8")),
        },
        coords={"parameter": list(PARAMETERS), "y": np.arange(SIZE), "x": np.arange(SIZE)},
    )  # fmt: skip


def demultiplex(raw: xr.Dataset, cal: xr.Dataset, *, power: float = 1.0, shape=None, radius=None) -> xr.Dataset:
    _misbehave(raw)
    log_call("lightfield", raw)
    rng = np.random.default_rng(int(raw["raw"].values.sum()))
    sizes = (2 * radius + 1, 2 * radius + 1, *shape)
    mosaic = (rng.random(sizes) * float(cal["vignetting"].mean()) ** power).astype("float32")
    dims = ("v", "u", "t", "s")
    coords = {name: cal[name].variable for name in (*PARAMETERS, "arrangement")}
    return xr.Dataset(
        {
            "mosaic": (dims, mosaic), "cfa": (dims, np.full(sizes, 255, "uint8")),
            "weight": (dims, np.full(sizes, np.nan, "f4")),
        },
        coords={
            **coords, "iso": raw["iso"].variable, "time": raw["time"].variable,
            "v": np.arange(sizes[0]) - radius, "u": np.arange(sizes[1]) - radius,
            "t": np.arange(shape[0]), "s": np.arange(shape[1]),
        },
    )  # fmt: skip


def disparity(lf: xr.Dataset, *, offset: float = 0.0) -> xr.Dataset:
    log_call("disparity", lf)
    flags = xr.zeros_like(lf["cfa"])
    ds = xr.Dataset({"disparity": lf["mosaic"] - 0.5 + offset, "disparity_std": lf["mosaic"] * 0.1, "flags": flags})
    return ds.drop_vars(["iso", "time"], errors="ignore")


def log_call(stage: str, ds: xr.Dataset) -> None:
    """One line per computation, so that tests can count them across processes."""
    log = os.environ.get("FAKE_CHAIN_LOG")
    if log:
        with Path(log).open("a") as stream:
            stream.write(f"{stage} {ds['capture'].item()}\n")


def _calibration(given: StageInput) -> xr.Dataset:
    return calibrate(given.raw, **given.parameters.get("calibration", {}))


def _lightfield(given: StageInput) -> xr.Dataset:
    place = {"shape": (given.grid.rows, given.grid.columns), "radius": given.grid.radius}
    return demultiplex(given.raw, given.results["calibration"], **place, **given.parameters.get("lightfield", {}))


def _disparity(given: StageInput) -> xr.Dataset:
    return disparity(given.results["lightfield"], **given.parameters.get("disparity", {}))


FAKE = Chain(
    open_fake,
    (
        Stage("calibration", 1, CALIBRATION, (), _calibration, {"calibration": "fake_chain:calibrate"}),
        Stage("lightfield", 1, LIGHTFIELD, ("calibration",), _lightfield, {"lightfield": "fake_chain:demultiplex"}),
        Stage("disparity", 1, DISPARITY, ("lightfield",), _disparity, {"disparity": "fake_chain:disparity"}),
    ),
)
