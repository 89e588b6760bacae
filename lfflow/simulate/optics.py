"""How light reaches a sensor pixel: the lens array's subimages, and the rays that one pixel gathers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lfflow.lattice import Lattice
from lfflow.simulate.rays import Frame, Profile


@dataclass(frozen=True, slots=True)
class Optics:
    """Subimages and the area that a pixel integrates over.

    Parameters
    ----------
    aperture
        Radius of a subimage (half of the light) in units of half a lens pitch.
    softness
        Half width of its soft edge, sensor pixels.
    droop
        Share of the light that is lost from the middle of a subimage to its edge.
    falloff
        Share of the light that is lost from the middle of the field to its corners.
    cat_eye
        How far a second aperture clips the subimages in the corners, as a share of their radius; 0 is none. It moves
        the subimages' centroids away from the lens centres, as a real main lens does.
    rays
        Number of rays a pixel averages over its own area and over its lens; 1 is the chief ray alone.
    fill
        Side of the square of the lens that gathers light, lens pitches.
    crosstalk
        Share of its signal that a pixel loses to its four neighbours.
    """

    aperture: float = 0.94
    softness: float = 0.8
    droop: float = 0.25
    falloff: float = 0.35
    cat_eye: float = 0.0
    rays: int = 6
    fill: float = 0.9
    crosstalk: float = 0.0

    def profile(self, lattice: Lattice, height: int, width: int) -> Profile:
        """Subimage profile in the units of the kernels."""
        radius = self.aperture * lattice.dh / 2
        second = radius * (1.0 + 0.15 * self.cat_eye)
        return Profile(
            radius=radius,
            softness=self.softness,
            droop=self.droop,
            cat_eye=radius * self.cat_eye,
            cat_eye_radius=second,
            falloff=self.falloff,
            half_diagonal=float(np.hypot(height, width)) / 2 / lattice.dh,
        )

    def ray_offsets(self) -> npt.NDArray[np.float64]:
        """Offsets (n, 4) of the rays of one pixel: place on its lens (lens pitches), place on the pixel (pixels).

        A low-discrepancy set that is symmetric about the chief ray, so that nothing is shifted; the same for every
        pixel, so that averaging over it is a linear filter of the light field.
        """
        if self.rays == 1:
            return np.zeros((1, 4))
        if self.rays % 2:
            raise ValueError(f"rays must be 1 or even, not {self.rays}")
        # Powers of the root of x^5 = x + 1: the additive sequence of lowest discrepancy in four dimensions.
        steps = 1.1673039782614187 ** -np.arange(1.0, 5.0)
        half = (0.5 + np.arange(1, self.rays // 2 + 1)[:, None] * steps) % 1.0 - 0.5
        area = np.array([self.fill, self.fill, 1.0, 1.0])
        return np.asarray(np.concatenate([half, -half]) * area, dtype=np.float64)


def frame_of(lattice: Lattice, height: int, width: int) -> Frame:
    """Lattice on a sensor in the units of the kernels; the scene's origin is the middle of the sensor."""
    cos, sin = float(np.cos(lattice.theta)), float(np.sin(lattice.theta))
    x, y = (width - 1) / 2 - lattice.cx, (height - 1) / 2 - lattice.cy
    return Frame(
        cos=cos,
        sin=sin,
        dh=lattice.dh,
        dv=lattice.dv,
        cx=lattice.cx,
        cy=lattice.cy,
        hexagonal=lattice.arrangement == "hexagonal",
        origin_x=(cos * x + sin * y) / lattice.dh,
        origin_y=(-sin * x + cos * y) / lattice.dh,
    )
