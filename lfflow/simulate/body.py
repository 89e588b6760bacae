"""Simulated cameras: one unit of a model, with its own lens array, zoom, focus and colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lfflow.cameras import F01, ILLUM, CameraModel
from lfflow.lattice import Lattice
from lfflow.simulate.sensor import Sensor


@dataclass(frozen=True, slots=True)
class Setting:
    """How one capture is taken.

    Parameters
    ----------
    zoom_step, focus_step
        Positions of the motors.
    iso
        Sensitivity; the electrons that make the white level fall with it.
    exposure_time
        Seconds.
    """

    zoom_step: float = 981.0
    focus_step: float = 582.0
    iso: float = 100.0
    exposure_time: float = 1 / 60


@dataclass(frozen=True, slots=True)
class Body:
    """One unit of a camera model.

    Parameters
    ----------
    model
        Camera model.
    serial, seed
        Serial number, and the seed of its sensor's defects.
    pixel_pitch, lens_pitch
        Metres.
    rotation, metadata_rotation
        True rotation of the lens array and what the metadata say, radians.
    scale_y
        Ratio of the vertical and the horizontal pitch.
    offset
        Offset of the lens array on the sensor (x, y) and its distance from it (z), metres.
    wide, tele
        (zoom step, focal length in metres) at the ends of the zoom.
    pupil
        Distance of the exit pupil from the lens array at the wide end, metres.
    f_number
        Of the main lens.
    base_iso
        Sensitivity at which the whole well is used.
    color_matrix
        Camera RGB (white balanced, linear) to linear sRGB, row by row.
    white_balance
        Gain of R, G, B.
    gamma
        Exponent of the display curve.
    sensor
        Sensor at `base_iso`.
    bits, endianness, upper_left
        How its files pack the samples, and the site of the first pixel.
    """

    model: CameraModel
    serial: str
    seed: int
    lens_pitch: float
    rotation: float
    metadata_rotation: float
    scale_y: float
    offset: tuple[float, float, float]
    wide: tuple[float, float]
    tele: tuple[float, float]
    pupil: float
    f_number: float
    base_iso: float
    color_matrix: tuple[float, ...]
    white_balance: tuple[float, float, float]
    gamma: float
    sensor: Sensor
    bits: int
    endianness: str
    upper_left: str
    pixel_pitch: float = 1.4e-6

    def focal_length(self, setting: Setting) -> float:
        """Focal length of the main lens, metres: geometric in the zoom step."""
        share = (setting.zoom_step - self.wide[0]) / (self.tele[0] - self.wide[0])
        return self.wide[1] * float((self.tele[1] / self.wide[1]) ** share)

    def exit_pupil_offset(self, setting: Setting) -> float:
        """Distance Z of the exit pupil from the lens array, metres; grows with the zoom and a little with the focus."""
        return self.pupil + 0.9 * (self.focal_length(setting) - self.wide[1]) + 4e-7 * (setting.focus_step - 582)

    def lattice(self, setting: Setting, height: int | None = None, width: int | None = None) -> Lattice:
        """Lattice of the subimages: the lens array projected from the exit pupil, pitch · (1 + f/Z).

        The optical axis meets the middle of the sensor, about which the projection magnifies; the rotation stays.
        """
        height, width = height or self.model.height, width or self.model.width
        magnification = 1 + self.offset[2] / self.exit_pupil_offset(setting)
        pitch = self.lens_pitch / self.pixel_pitch * magnification
        return Lattice(
            dh=pitch,
            dv=pitch * self.scale_y,
            theta=self.rotation,
            cx=(width - 1) / 2 + self.offset[0] / self.pixel_pitch * magnification,
            cy=(height - 1) / 2 + self.offset[1] / self.pixel_pitch * magnification,
        ).anchored(height, width)

    def sensor_at(self, setting: Setting) -> Sensor:
        """Sensor at the sensitivity of a setting."""
        s = self.sensor
        full_well = s.full_well * self.base_iso / setting.iso
        return Sensor(s.pattern, s.black, s.white, full_well, s.read_noise, s.hot_share, s.dead_share)

    def to_camera(self, colours: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """Linear sRGB (..., 3) as the sensor sees it: before white balance and colour matrix."""
        inverse = np.linalg.inv(np.array(self.color_matrix).reshape(3, 3))
        return np.asarray(colours @ inverse.T / np.array(self.white_balance), dtype=np.float64)


F01_BODY = Body(
    model=F01,
    serial="A303134643",
    seed=303134643,
    lens_pitch=1.4e-5,
    rotation=0.00143,
    metadata_rotation=0.0013489649863913655,
    scale_y=1.0002111196517944,
    offset=(-2.7138671874999998e-06, 5.660156011581421e-07, 2.5e-05),
    wide=(981.0, 0.00645),
    tele=(100.0, 0.0516),
    pupil=0.0265,
    f_number=1.91,
    base_iso=80.0,
    color_matrix=(3.1115827560424805, -1.9393929243087769, -0.172189861536026, -0.3629055917263031, 1.6408803462982178,
                  -0.27797481417655945, 0.078967012465000153, -1.1558042764663696, 2.0768373012542725),
    white_balance=(1.0, 1.1171875, 1.72265625),
    gamma=0.41666001081466675,
    sensor=Sensor(),
    bits=12,
    endianness="big",
    upper_left="b",
)  # fmt: skip

ILLUM_BODY = Body(
    model=ILLUM,
    serial="B5143909630",
    seed=143909630,
    lens_pitch=2e-5,
    rotation=-0.00052,
    metadata_rotation=-0.00055235880427062511,
    scale_y=0.99998736381530762,
    offset=(-1.117852207244141e-05, -1.0289267038388061e-06, 4.0599999920232221e-05),
    wide=(982.0, 0.0095),
    tele=(-1040.0, 0.0776),
    pupil=0.046,
    f_number=2.11,
    base_iso=80.0,
    color_matrix=(2.4827811717987061, -1.1018080711364746, -0.38097298145294189, -0.36761483550071716,
                  1.6667767763137817, -0.29916191101074219, -0.18722048401832581, -0.73317205905914307,
                  1.9203925132751465),
    white_balance=(1.288, 1.0, 1.361),
    gamma=0.4,
    sensor=Sensor(pattern="GRBG", black=64.0, white=1023.0),
    bits=10,
    endianness="little",
    upper_left="gr",
)  # fmt: skip

BODIES = {"f01": F01_BODY, "illum": ILLUM_BODY}
