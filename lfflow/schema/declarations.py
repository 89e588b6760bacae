"""What lfflow's datasets hold: the declarations of raw frames, calibrations, light fields, disparities and views."""

from __future__ import annotations

from lfflow.schema.spec import Schema, Variable, scalars

_SENSOR = (
    Variable("y", ("y",), "int64", "sensor row", "pixel", axis=True),
    Variable("x", ("x",), "int64", "sensor column", "pixel", axis=True),
)
_VIEWS = (
    Variable("v", ("v",), "int64", "view offset down", "pixel", axis=True),
    Variable("u", ("u",), "int64", "view offset to the right", "pixel", axis=True),
)
_LENSES = (
    Variable("t", ("t",), "int64", "lens row", "1", axis=True),
    Variable("s", ("s",), "int64", "lens column in the brick layout", "1", axis=True),
)
_BEND_AXES = (
    Variable("axis", ("axis",), "string", "direction on the sensor: x right, y down", axis=True, required=False),
    Variable("term", ("term",), "int64", "0: half the sensor; then the terms of `lfflow.distortion`", axis=True,
             required=False),
)  # fmt: skip


def _distortion(*, coordinate: bool) -> Variable:
    return Variable(
        "distortion", ("axis", "term"), "float64", "bend of the lattice: displacement of the centres from it", "pixel",
        coordinate=coordinate, required=False,
    )  # fmt: skip


_CHANNEL = (Variable("channel", ("channel",), "string", "colour channel", axis=True, required=False),)

_LATTICE = (
    ("dh", "horizontal lens pitch", "pixel"),
    ("dv", "vertical lens pitch", "pixel"),
    ("theta", "rotation of the lens array", "radian"),
    ("cx", "sensor column of the centre of lens (t=0, s=0)", "pixel"),
    ("cy", "sensor row of the centre of lens (t=0, s=0)", "pixel"),
)
ARRANGEMENT_FLAGS = {"hexagonal": 0, "square": 1}


def _arrangement(*, coordinate: bool) -> Variable:
    return Variable(
        "arrangement", (), "uint8", "arrangement of the lenses", flags=ARRANGEMENT_FLAGS, coordinate=coordinate
    )


_CAMERA_TEXT = tuple(
    Variable(name, (), "string", text, coordinate=True, required=False)
    for name, text in (
        ("camera_model", "camera model"),
        ("camera_serial", "serial number of the camera"),
    )
)
_TIME = (Variable("time", (), "datetime64[ns]", "time of the exposure (UTC)", "", coordinate=True, required=False),)
_OPTICS = tuple(
    Variable(name, (), "float64", text, units, coordinate=True, required=False)
    for name, text, units in (
        ("iso", "sensitivity (ISO)", "1"),
        ("exposure_time", "exposure time", "s"),
        ("f_number", "f-number of the main lens", "1"),
        ("focal_length", "focal length of the main lens", "m"),
        ("zoom_step", "position of the zoom motor", "1"),
        ("focus_step", "position of the focus motor", "1"),
        ("infinity_lambda", "refocus parameter of infinity", "1"),
        ("exit_pupil_offset", "distance of the exit pupil from the lens array", "m"),
        ("temperature", "temperature of the lens", "degC"),
        ("pixel_pitch", "pixel pitch of the sensor", "m"),
        ("lens_pitch", "pitch of the lens array", "m"),
        ("mla_rotation", "rotation of the lens array by the camera's metadata", "radian"),
        ("mla_scale_x", "scale factor of the lens array, x", "1"),
        ("mla_scale_y", "scale factor of the lens array, y", "1"),
        ("mla_offset_x", "offset of the lens array on the sensor, x", "m"),
        ("mla_offset_y", "offset of the lens array on the sensor, y", "m"),
        ("mla_offset_z", "distance of the lens array from the sensor", "m"),
    )
)
_COLOUR = (
    Variable("white_balance", ("channel",), "float64", "gain of each channel", coordinate=True, required=False),
    Variable(
        "color_matrix", ("channel", "channel_in"), "float64", "linear camera RGB to linear sRGB", coordinate=True,
        required=False,
    ),
    Variable("gamma", (), "float64", "exponent of the display curve", coordinate=True, required=False),
)  # fmt: skip

RAW = Schema(
    "raw",
    1,
    "One sensor frame as the camera wrote it.",
    (
        *_SENSOR,
        Variable("raw", ("y", "x"), "uint16", "raw sensor sample", "count"),
        Variable("kind", (), "string", "scene, white or dark", coordinate=True),
        Variable("cfa_pattern", (), "string", "colours of the top-left 2×2 sensor pixels, row by row", coordinate=True),
        Variable("site", ("site",), "string", "site of the Bayer tile", axis=True),
        Variable("black_level", ("site",), "float64", "black level", "count", coordinate=True),
        Variable("white_level", ("site",), "float64", "white level", "count", coordinate=True),
        Variable("orientation", (), "int64", "EXIF orientation", coordinate=True, required=False),
        *_CAMERA_TEXT,
        *_TIME,
        *_OPTICS,
        *_CHANNEL,
        *_COLOUR,
    ),
)

METHOD_FLAGS = {"white": 0, "self": 1}
PIXEL_FLAGS = {"hot": 1, "dead": 2, "saturated": 4}

CALIBRATION = Schema(
    "calibration",
    2,
    "Where the lenses are and how they shade, from a white image or from the picture itself.",
    (
        *_SENSOR,
        Variable("parameter", ("parameter",), "string", "lattice parameter", axis=True),
        *scalars(_LATTICE, coordinate=False),
        _arrangement(coordinate=False),
        Variable(
            "covariance", ("parameter", "parameter_b"), "float64", "covariance of dh, dv, theta, cx, cy (own units)"
        ),
        Variable("residual_rms", (), "float64", "rms distance of the measured centres from the lattice", "pixel"),
        Variable("lens_count", (), "int64", "number of lenses used"),
        Variable("method", (), "uint8", "what the lattice was measured on", flags=METHOD_FLAGS),
        *_BEND_AXES,
        _distortion(coordinate=False),
        Variable(
            "distortion_rms",
            (),
            "float64",
            "rms of the smooth bend of the measured centres, corrected or not",
            "pixel",
            required=False,
        ),
        Variable(
            "distortion_chance", (), "float64", "probability that a straight lattice shows as much", required=False
        ),
        Variable("vignetting", ("y", "x"), "float32", "relative illumination, 1 at its peak", keep_bits=12),
        Variable("pixel_flags", ("y", "x"), "uint8", "sensor pixels not to be used", flags=PIXEL_FLAGS, flag_bits=True),
    ),
)

LIGHTFIELD = Schema(
    "lightfield",
    2,
    "Mosaicked light field: every sensor pixel at its view and lens, no colour mixed.",
    (
        *_VIEWS,
        *_LENSES,
        Variable("mosaic", ("v", "u", "t", "s"), "float32", "radiance, 0 black level, 1 white level", keep_bits=12),
        Variable(
            "cfa", ("v", "u", "t", "s"), "uint8", "colour of the sample",
            flags={"red": 0, "green": 1, "blue": 2, "no_sample": 255},
        ),
        Variable("weight", ("v", "u", "t", "s"), "float32", "confidence by vignetting, 0 to 1", keep_bits=7),
        Variable("view_usable", ("v", "u"), "bool", "view with a median weight that is not negligible",
                 coordinate=True, required=False),
        *scalars(_LATTICE, coordinate=True),
        _arrangement(coordinate=True),
        *_BEND_AXES,
        _distortion(coordinate=True),
        Variable("orientation", (), "int64", "EXIF orientation", coordinate=True, required=False),
        Variable("white_image", (), "string", "white image of the calibration", coordinate=True, required=False),
        Variable("white_distance", (), "float64", "zoom and focus steps to the white image", coordinate=True,
                 required=False),
        *_CAMERA_TEXT,
        *_TIME,
        *_OPTICS,
        *_CHANNEL,
        *_COLOUR,
    ),
)  # fmt: skip

DISPARITY_FLAGS = {"no_data": 1, "low_texture": 2, "saturated": 4, "occluded": 8, "filled": 16}

DISPARITY = Schema(
    "disparity",
    1,
    "Disparity of every view, with its standard deviation.",
    (
        *_VIEWS,
        *_LENSES,
        Variable("disparity", ("v", "u", "t", "s"), "float32", "disparity, lens pitches per view step", keep_bits=14),
        Variable(
            "disparity_std", ("v", "u", "t", "s"), "float32", "standard deviation of the disparity", keep_bits=7
        ),
        Variable("flags", ("v", "u", "t", "s"), "uint8", "state of the disparity", flags=DISPARITY_FLAGS,
                 flag_bits=True),
        *scalars(_LATTICE, coordinate=True),
        _arrangement(coordinate=True),
    ),
)  # fmt: skip

VIEWS = Schema(
    "views",
    1,
    "Full-colour views on the square grid.",
    (
        *_VIEWS,
        *_LENSES,
        *_CHANNEL,
        Variable("rgb", ("v", "u", "t", "s", "channel"), "float32", "linear radiance of each channel", keep_bits=12),
    ),
)

SCHEMAS = {schema.name: schema for schema in (RAW, CALIBRATION, LIGHTFIELD, DISPARITY, VIEWS)}
