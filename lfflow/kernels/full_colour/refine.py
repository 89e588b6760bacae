"""Disparity below the step of the search: Gauss–Newton over all views that see a place, joined by a smooth surface."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from lfflow.kernels.full_colour.line_fit import normal_equations
from lfflow.kernels.full_colour.lines import Lines
from lfflow.kernels.full_colour.visibility import seen_by
from lfflow.kernels.surface import fit_surface, square_axes
from lfflow.kernels.threads import bands, each

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]

_APART = np.float32(4)
"""Residual, in units of the noise, at which a view counts a quarter."""
_REACH = np.float32(0.15)
"""Longest step; beyond it the views are not linear in the disparity."""
_HIDES = np.float32(0.1)
_JUMP, _EDGE = 0.03, 0.015
"""Second difference, and change of the picture, at which the surface may break."""
_DOUBT = 3
"""Squared standard deviations of what a neighbourhood tells that are no break."""


class Refined(NamedTuple):
    """The surface (t, s) and what the views say of each place by themselves.

    Parameters
    ----------
    disparity, own
        (t, s) of the surface, and of the place alone.
    information
        (t, s) 1/variance of `own`.
    residual
        (t, s) mean squared difference of the views to their mean; its median is `noise`.
    """

    disparity: FloatArray
    own: FloatArray
    information: FloatArray
    residual: FloatArray
    noise: float


def _fit(
    lines: Lines, disparity: FloatArray, noise: float, views: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Step, curvature and mean squared residual (t, s) at the present disparity, by some of the views."""
    u, v = lines.u[views], lines.v[views]
    graded = (u % 2 == 0) & (v % 2 == 0)
    seen = np.empty((len(views), *disparity.shape), dtype=np.bool_)
    sums = np.empty((3, *disparity.shape), dtype=np.float32)
    tolerance = _APART * np.float32(noise)

    def look(q: int) -> None:
        seen[q] = seen_by(disparity, u[q], v[q], _HIDES)

    def band(span: tuple[int, int]) -> None:
        normal_equations(lines.views, views, seen, disparity, u, v, graded, span, lines.margin, tolerance, sums)

    each(look, range(len(views)), lines.threads)
    each(band, bands(disparity.shape[0]), lines.threads)
    curvature, slope, residual = sums
    step = np.clip(slope / np.maximum(curvature, np.float32(1e-12)), -_REACH, _REACH)
    return step.astype(np.float32), curvature, residual


def around(values: FloatArray) -> FloatArray:
    """Mean over 5 × 5 places, none below 0, where the running sums of the blur may leave it."""
    return np.maximum(cv2.blur(values, (5, 5)), np.float32(0))


def _thinned(lines: Lines) -> IntArray:
    """Every other view, as on a chessboard: near enough for a step that another follows."""
    return np.flatnonzero((lines.u + lines.v) % 2 == 0)


def refine(lines: Lines, guide: FloatArray, start: FloatArray, *, stiffness: float, rounds: int) -> Refined:
    """Surface through the disparities at which all views agree.

    Parameters
    ----------
    guide
        (t, s, channel) picture of the central view.
    start
        (t, s), right to less than half the finest texture over the largest view offset.
    stiffness
        `lfflow.kernels.surface.fit_surface`.
    rounds
        Steps, at least one.
    """
    noise = 0.5
    disparity = np.asarray(start, dtype=np.float32)
    axes = square_axes(len(disparity))
    for left in reversed(range(rounds)):
        views = np.arange(len(lines.u)) if left == 0 else _thinned(lines)
        step, curvature, residual = _fit(lines, disparity, noise, views)
        noise = max(float(np.median(residual)), 1e-9)
        information = (curvature / np.maximum(residual, noise)).astype(np.float32)
        own: FloatArray = disparity + step
        told = information * np.float32(0.5)
        jump = np.sqrt(_JUMP**2 + _DOUBT / (25 * around(told) + 1)).astype(np.float32)
        disparity = fit_surface(own, told, disparity, guide, axes, stiffness=stiffness, jump=jump, edge=_EDGE,
                                rounds=2)  # fmt: skip
    return Refined(disparity, own, information, residual, noise)
