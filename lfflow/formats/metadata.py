"""The cameras' JSON (METHOD B.3) as typed values: what is needed must be there, what is optional may be missing.

Both generations are read: F01 (``image.rawDetails``) and Illum (``image.pixelPacking``, ``pixelFormat`` and ``ccm``).
An optional value that is missing or of the wrong type is NaN, NaT or ""; the JSON itself is kept verbatim.

``pixelFormat.rightShift`` is 0 in every file seen. As its name says, samples are shifted right by it after unpacking
(16-bit copies hold the 12 bits of an F01 shifted left by 4, METHOD B.2); black and white are levels of shifted samples,
and levels that do not fit into the bits that are left are refused.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from lfflow.conventions import CHANNELS, SITES
from lfflow.formats.bounded_json import Json, at, finite_number
from lfflow.formats.errors import LimitError, MetadataError, UnsupportedError
from lfflow.formats.layout import MAX_SAMPLES, PACKINGS, FrameLayout, Packing

_TILE = "r,gr:gb,b"
_PATTERNS = {"r": "RGGB", "gr": "GRBG", "gb": "GBRG", "b": "BGGR"}
MODELS = {"ILLUM": "B01"}
_TIME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d)[:_](\d\d)[:_](\d\d(?:\.\d{1,9})?)Z?")
_YEARS = ("1678", "2261")
_NUMBERS: dict[str, tuple[tuple[str, ...], ...]] = {
    "iso": (("devices", "sensor", "iso"), ("image", "iso")),
    "exposure_time": (
        ("devices", "shutter", "pixelExposureDuration"),
        ("devices", "shutter", "frameExposureDuration"),
    ),
    "f_number": (("devices", "lens", "fNumber"),),
    "focal_length": (("devices", "lens", "focalLength"),),
    "zoom_step": (("devices", "lens", "zoomStep"),),
    "focus_step": (("devices", "lens", "focusStep"),),
    "infinity_lambda": (("devices", "lens", "infinityLambda"),),
    "exit_pupil_offset": (("devices", "lens", "exitPupilOffset", "z"),),
    "temperature": (("devices", "lens", "temperature"),),
    "pixel_pitch": (("devices", "sensor", "pixelPitch"),),
    "lens_pitch": (("devices", "mla", "lensPitch"),),
    "mla_rotation": (("devices", "mla", "rotation"),),
    "mla_scale_x": (("devices", "mla", "scaleFactor", "x"),),
    "mla_scale_y": (("devices", "mla", "scaleFactor", "y"),),
    "mla_offset_x": (("devices", "mla", "sensorOffset", "x"),),
    "mla_offset_y": (("devices", "mla", "sensorOffset", "y"),),
    "mla_offset_z": (("devices", "mla", "sensorOffset", "z"),),
    "gamma": (("image", "color", "gamma"),),
}


@dataclass(frozen=True, slots=True)
class FrameMetadata:
    """What the JSON says about a frame: how its samples lie in the file, and its coordinates (name → dims, value)."""

    layout: FrameLayout
    kind: str
    coords: dict[str, tuple[tuple[str, ...], Any]]


def frame_metadata(metadata: Json, private: Json, tags: Json, path: str) -> FrameMetadata:
    """Typed metadata of one sensor frame.

    Parameters
    ----------
    metadata, private
        The frame's JSON and the part with the serial number ({} where there is none).
    tags
        The camera's own tags ("com.lytro.tags").
    path
        The file, for messages.

    Raises
    ------
    MetadataError
        If size, packing, mosaic, black or white level are missing or impossible.
    UnsupportedError
        If the packing or the mosaic is of a kind that lfflow cannot read.
    LimitError
        If the frame is larger than any sensor.
    """
    image = at(metadata, "image")
    details = at(image, "rawDetails") or image
    packing = _packing(details, path)
    shift = _shift(details, packing.bits, path)
    layout = FrameLayout(_size(image, "height", path), _size(image, "width", path), packing, shift)
    if layout.height * layout.width > MAX_SAMPLES:
        found = f"{layout.width} × {layout.height} pixels"
        raise LimitError(path, "image size", found, f"at most {MAX_SAMPLES} pixels")
    black, white = _levels(details, packing.bits - shift, path)
    model = _text(metadata, "camera", "model")
    gains = [finite_number(at(image, "color", "whiteBalanceGain", site)) for site in SITES]
    kind = "dark" if at(tags, "darkFrame") is True else "white" if at(tags, "modulationFrame") is True else "scene"
    orientation = at(image, "orientation")
    coords: dict[str, tuple[tuple[str, ...], Any]] = {
        "kind": ((), kind),
        "cfa_pattern": ((), _pattern(metadata, details, path)),
        "site": (("site",), list(SITES)),
        "black_level": (("site",), black),
        "white_level": (("site",), white),
        "orientation": ((), np.int64(orientation if orientation in range(1, 9) else 1)),
        "camera_model": ((), MODELS.get(model, model)),
        "camera_serial": ((), _text(private, "camera", "serialNumber") or _text(metadata, "camera", "serialNumber")),
        "time": ((), _time(at(metadata, "devices", "clock", "zuluTime"))),
        "channel": (("channel",), list(CHANNELS)),
        "white_balance": (("channel",), np.array([gains[0], (gains[1] + gains[2]) / 2, gains[3]])),
        "color_matrix": (("channel", "channel_in"), _matrix(image)),
    }
    for name, places in _NUMBERS.items():
        found_numbers = (finite_number(at(metadata, *place)) for place in places)
        coords[name] = ((), np.float64(next((number for number in found_numbers if not math.isnan(number)), math.nan)))
    return FrameMetadata(layout, kind, coords)


def _size(image: Any, name: str, path: str) -> int:
    value = at(image, name)
    if not _is_int(value) or not 0 < value <= MAX_SAMPLES:
        raise MetadataError(path, f"image.{name}", _shown(value), "a number of pixels")
    return int(value)


def _packing(details: Any, path: str) -> Packing:
    bits, order = at(details, "pixelPacking", "bitsPerPixel"), at(details, "pixelPacking", "endianness")
    if bits is None or order is None:
        raise MetadataError(path, "pixelPacking", _shown(at(details, "pixelPacking")), "bitsPerPixel and endianness")
    packing = PACKINGS.get((bits, order)) if _is_int(bits) and isinstance(order, str) else None
    if packing is None:
        known = ", ".join(f"{known_bits} {known_order}" for known_bits, known_order in PACKINGS)
        raise UnsupportedError(path, "pixelPacking", f"{_shown(bits)} bits {_shown(order)}", f"one of {known}")
    return packing


def _shift(details: Any, bits: int, path: str) -> int:
    shift = at(details, "pixelFormat", "rightShift")
    if shift is None:
        return 0
    if not _is_int(shift) or not 0 <= shift < bits:
        raise MetadataError(path, "pixelFormat.rightShift", _shown(shift), f"a number of bits, 0 … {bits - 1}")
    return int(shift)


def _levels(details: Any, bits: int, path: str) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    levels = [[finite_number(at(details, "pixelFormat", name, site)) for site in SITES] for name in ("black", "white")]
    black, white = np.array(levels)
    if not (np.all(black >= 0) and np.all(white > black) and np.all(white < 1 << bits)):
        found = _shown(at(details, "pixelFormat"))
        raise MetadataError(path, "pixelFormat", found, f"black and white levels, 0 ≤ black < white < {1 << bits}")
    return black, white


def _pattern(metadata: Json, details: Any, path: str) -> str:
    mosaic = at(details, "mosaic") or at(metadata, "devices", "sensor", "mosaic")
    corner = at(mosaic, "upperLeftPixel")
    if mosaic is None or not isinstance(corner, str):
        raise MetadataError(path, "mosaic", _shown(mosaic), "tile and upperLeftPixel")
    if at(mosaic, "tile") != _TILE or corner not in _PATTERNS:
        raise UnsupportedError(path, "mosaic", _shown(mosaic), f"tile {_TILE} from one of {', '.join(_PATTERNS)}")
    return _PATTERNS[corner]


def _matrix(image: Any) -> np.ndarray[Any, Any]:
    values = at(image, "color", "ccmRgbToSrgbArray") or at(image, "color", "ccm")
    if not isinstance(values, list) or len(values) != 9:
        return np.full((3, 3), np.nan)
    return np.array([finite_number(value) for value in values]).reshape(3, 3)


def _time(value: Any) -> np.datetime64:
    match = _TIME.fullmatch(value) if isinstance(value, str) else None
    if match is None or not _YEARS[0] < value[:4] < _YEARS[1]:
        return np.datetime64("NaT", "ns")
    try:
        return np.datetime64(":".join(match.groups()), "ns")
    except ValueError:
        return np.datetime64("NaT", "ns")


def _text(document: Json, *keys: str) -> str:
    value = at(document, *keys)
    return value if isinstance(value, str) else ""


def _is_int(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
