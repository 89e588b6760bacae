"""Metadata as the cameras write them, at any sensor size; shared by the tests and the fuzzer."""

from __future__ import annotations

from typing import Any

PRIVATE = {"camera": {"serialNumber": "A202110453"}, "devices": {"sensor": {"sensorSerial": "0x7096E34F554BDE10"}}}


def metadata_of(
    camera: str, height: int, width: int, bits: int | None = None, corner: str | None = None
) -> dict[str, Any]:
    bits = bits or {"f01": 12, "illum": 10}[camera]
    order = {8: "big", 10: "little", 12: "big", 16: "little"}[bits]
    black, white = (168, 4095) if bits == 12 else (8, (1 << bits) - 1)
    sites = ("r", "gr", "gb", "b")
    mosaic = {"tile": "r,gr:gb,b", "upperLeftPixel": corner or {"f01": "b", "illum": "gr"}[camera]}
    details = {
        "pixelFormat": {"rightShift": 0, "black": dict.fromkeys(sites, black), "white": dict.fromkeys(sites, white)},
        "pixelPacking": {"endianness": order, "bitsPerPixel": bits},
        "mosaic": mosaic,
    }
    matrix = [2.25, -0.91, -0.34, -0.56, 1.72, -0.16, -0.59, -1.32, 2.91]
    gains = {"r": 1.0, "gr": 1.1171875, "gb": 1.1171875, "b": 1.72265625}
    lens = {"zoomStep": 981, "focusStep": 582, "fNumber": 1.91, "focalLength": 0.00645, "infinityLambda": 7, "temperature": 28.5, "exitPupilOffset": {"z": 10000}}  # fmt: skip  # noqa: E501
    mla = {
        "tiling": "hexUniformRowMajor", "lensPitch": 1.38986e-05, "rotation": 0.00193,
        "scaleFactor": {"x": 1, "y": 1.0005}, "sensorOffset": {"x": -2.7e-06, "y": 5.66e-07, "z": 2.5e-05},
    }  # fmt: skip
    image: dict[str, Any] = {"width": width, "height": height, "orientation": 1}
    devices = {
        "clock": {"zuluTime": "2012-08-15T04:47:08.000Z"},
        "sensor": {"bitsPerPixel": bits, "mosaic": mosaic, "iso": 200, "pixelPitch": 1.4e-06},
        "lens": lens, "mla": mla, "shutter": {"pixelExposureDuration": 0.0143, "frameExposureDuration": 0.0143},
    }  # fmt: skip
    if camera == "f01":
        image |= {"representation": "rawPacked", "rawDetails": details}
        image["color"] = {"ccmRgbToSrgbArray": matrix, "gamma": 0.41666, "whiteBalanceGain": gains}
        return {"type": "lightField", "image": image, "devices": devices, "camera": {"model": "F01"}}
    image |= {**details, "iso": 122, "color": {"ccm": matrix, "whiteBalanceGain": gains}}
    del devices["sensor"]["iso"]
    return {"image": image, "devices": devices, "camera": {"model": "ILLUM", "make": "Lytro, Inc."}}
