"""What a simulated camera writes beside its samples: a container's JSON, and a raw dataset's coordinates."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from lfflow.conventions import CHANNELS, SITES
from lfflow.schema import RAW
from lfflow.simulate.body import Body, Setting


def frame_metadata(body: Body, setting: Setting, height: int, width: int, time: np.datetime64) -> dict[str, Any]:
    """Frame metadata with the keys of the camera's own files."""
    sensor = body.sensor
    mosaic = {"tile": "r,gr:gb,b", "upperLeftPixel": body.upper_left}
    r, g, b = body.white_balance
    return {
        "type": "lightField",
        "image": {
            "width": width,
            "height": height,
            "orientation": 1,
            "representation": "rawPacked",
            "rawDetails": {
                "pixelFormat": {
                    "rightShift": 0,
                    "black": dict.fromkeys(SITES, round(sensor.black)),
                    "white": dict.fromkeys(SITES, round(sensor.white)),
                },
                "pixelPacking": {"endianness": body.endianness, "bitsPerPixel": body.bits},
                "mosaic": mosaic,
            },
            "color": {
                "ccmRgbToSrgbArray": list(body.color_matrix),
                "gamma": body.gamma,
                "applied": {},
                "whiteBalanceGain": {"r": r, "gr": g, "gb": g, "b": b},
            },
            "modulationExposureBias": 0,
            "limitExposureBias": 0,
        },
        "devices": {**_devices(body, setting, time), "sensor": _sensor(body, setting, mosaic)},
        "modes": {"creative": "auto"},
        "camera": {"make": "Lytro, Inc.", "model": model_name(body, height, width), "firmware": "lfflow simulate"},
    }


def model_name(body: Body, height: int, width: int) -> str:
    """Model of a body, "simulated" where the sensor is not that model's: its light fields have another shape."""
    return body.model.name if (height, width) == (body.model.height, body.model.width) else "simulated"


def private_metadata(body: Body) -> dict[str, Any]:
    """Metadata that the camera keeps apart: serial numbers."""
    return {
        "camera": {"serialNumber": body.serial},
        "devices": {"sensor": {"sensorSerial": f"0x{body.seed & 0xFFFFFFFF:08x}"}},
    }


def _sensor(body: Body, setting: Setting, mosaic: dict[str, str]) -> dict[str, Any]:
    return {
        "bitsPerPixel": body.bits,
        "mosaic": mosaic,
        "iso": setting.iso,
        "analogGain": dict.fromkeys(SITES, setting.iso / body.base_iso),
        "pixelPitch": body.pixel_pitch,
    }


def _devices(body: Body, setting: Setting, time: np.datetime64) -> dict[str, Any]:
    return {
        "clock": {"zuluTime": f"{np.datetime_as_string(time, unit='ms')}Z"},
        "lens": {
            "infinityLambda": 7.0,
            "focalLength": body.focal_length(setting),
            "zoomStep": setting.zoom_step,
            "focusStep": setting.focus_step,
            "fNumber": body.f_number,
            "temperature": 28.675750732421875,
            "temperatureAdc": 2776,
            "zoomStepperOffset": 0,
            "focusStepperOffset": 0,
            "exitPupilOffset": {"z": body.exit_pupil_offset(setting)},
        },
        "ndfilter": {"exposureBias": 0},
        "shutter": {
            "mechanism": "sensorOpenApertureClose",
            "frameExposureDuration": setting.exposure_time,
            "pixelExposureDuration": setting.exposure_time,
        },
        "soc": {"temperature": 30.941009521484375, "temperatureAdc": 3203},
        "accelerometer": {"sampleArray": []},
        "mla": {
            "tiling": "hexUniformRowMajor",
            "lensPitch": body.lens_pitch,
            "rotation": body.metadata_rotation,
            "defectArray": [],
            "config": "com.lytro.mla.3",
            "scaleFactor": {"x": 1.0, "y": body.scale_y},
            "sensorOffset": dict(zip("xyz", body.offset, strict=True)),
        },
    }


def raw_dataset(
    samples: np.ndarray, body: Body, setting: Setting, *, capture: str, kind: str, time: np.datetime64
) -> xr.Dataset:
    """Samples (y, x) as the engine "lfp" gives them, with the coordinates of schema RAW."""
    height, width = samples.shape
    metadata = frame_metadata(body, setting, height, width, time)
    lens, mla = metadata["devices"]["lens"], metadata["devices"]["mla"]
    scalars = {
        "capture": capture,
        "kind": kind,
        "cfa_pattern": body.sensor.pattern,
        "orientation": np.int64(1),
        "camera_model": model_name(body, height, width),
        "camera_serial": body.serial,
        "time": time.astype("datetime64[ns]"),
        "iso": float(setting.iso),
        "exposure_time": setting.exposure_time,
        "f_number": body.f_number,
        "focal_length": lens["focalLength"],
        "zoom_step": float(setting.zoom_step),
        "focus_step": float(setting.focus_step),
        "infinity_lambda": lens["infinityLambda"],
        "exit_pupil_offset": lens["exitPupilOffset"]["z"],
        "temperature": lens["temperature"],
        "pixel_pitch": body.pixel_pitch,
        "lens_pitch": body.lens_pitch,
        "mla_rotation": body.metadata_rotation,
        "mla_scale_x": mla["scaleFactor"]["x"],
        "mla_scale_y": body.scale_y,
        "mla_offset_x": body.offset[0],
        "mla_offset_y": body.offset[1],
        "mla_offset_z": body.offset[2],
        "gamma": body.gamma,
    }
    coords: dict[str, Any] = {name: ((), value) for name, value in scalars.items()}
    coords |= {
        "y": np.arange(height, dtype=np.int64),
        "x": np.arange(width, dtype=np.int64),
        "site": list(SITES),
        "channel": list(CHANNELS),
        "black_level": ("site", np.full(4, body.sensor.black)),
        "white_level": ("site", np.full(4, body.sensor.white)),
        "white_balance": ("channel", np.array(body.white_balance)),
        "color_matrix": (("channel", "channel_in"), np.array(body.color_matrix).reshape(3, 3)),
    }
    return RAW.annotate(xr.Dataset({"raw": (("y", "x"), samples)}, coords, {"metadata": json.dumps(metadata)}))
