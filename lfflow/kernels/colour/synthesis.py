"""Views of one capture out of its samples: what is prepared once, and what each view takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from lfflow.distortion import STRAIGHT, Distortion
from lfflow.kernels.colour.gather import Gathered, Rule, Samples, Targets, gather
from lfflow.kernels.colour.guided import fill_colours
from lfflow.kernels.colour.shrinkage import sample_noise, steady_colours
from lfflow.kernels.colour.surface_colour import STEP, read_surface, steepness, surface_places
from lfflow.kernels.colour.warp import read_disparity
from lfflow.kernels.sensor.demultiplex import residuals
from lfflow.lattice import Lattice

Array = npt.NDArray[Any]

_UNKNOWN_STD = np.float32(0.1)
"""Deviation where none is known, and the largest: beyond it nothing in the picture tells one disparity from another."""
_CAUTION = np.float32(2.0)
"""Deviations by which a disparity is taken to be wrong."""
_JUMP = np.float32(0.8)
"""Share of a jump of the disparity between neighbouring lenses that counts as doubt: they mix two surfaces."""
_EDGE = np.float32(0.08)
"""Jump above which a lens is taken to see the edge of the nearer surface beside it."""
_FRONT = np.float32(0.75)
"""Share of that surface's disparity along which such a lens's light is followed."""
_DIM = 0.5
"""Views with less than this share of the brightest view's weight give little but noise and are left out."""
_UNSURE = 8.0
"""Variance, in units of a sample's, of what a doubtful disparity makes of the centre's colours in another view, above
which that gathers for itself."""
_WEAK = np.float32(0.06)
"""Share of all weight below which a colour is taken from the places around: near disparity 3/2 whole rows of an F01 see
no red, or no blue."""
_LEAST = np.float32(0.02)
"""Weight that no colour is known with."""
_DARK = np.float32(0.02)
_READ_WEIGHT = 20.0
"""Number of samples that a colour read on the centre's surfaces is taken to rest on."""
_NEAR = 29
"""Where a view gathers for itself, it looks at so many views around it, for there the disparity is in doubt."""


class Capture(NamedTuple):
    """Samples of one capture and the maps of its views (V, U, T, S).

    Parameters
    ----------
    samples
        Its samples; view (i, j) is number ``i·U + j``.
    v, u
        Offsets of the views.
    disparity, std
        Maps of every view.
    """

    samples: Samples
    v: Array
    u: Array
    disparity: Array
    std: Array


class Surface(NamedTuple):
    """Planes (rows, columns, colour, 3) of the colours seen from the centre; disparity, `steepness`, guesses."""

    planes: Array
    disparity: Array
    steep: Array
    guessed: Array


def prepare(
    fields: Sequence[Array], axes: Sequence[Array], lattice: Lattice, distortion: Distortion = STRAIGHT
) -> Capture:
    """Capture of the fields (v, u, t, s) mosaic, cfa, weight, disparity and its standard deviation.

    `axes` are the coordinates v, u, t, s. Views much dimmer than the brightest take no part in others.
    """
    mosaic, cfa, weight, disparity = (np.ascontiguousarray(field) for field in fields[:4])
    v, u, t, s = axes
    at_v, at_u = np.meshgrid(v, u, indexing="ij")
    light = np.nanmean(np.where(cfa[..., ::7, ::7] < 3, weight[..., ::7, ::7], 0), axis=(2, 3))
    value, confidence, own, colour = (f.reshape(-1, *f.shape[2:]) for f in (mosaic, weight, disparity, cfa))
    samples = Samples(
        value,
        confidence,
        own,
        colour,
        np.stack(residuals(lattice, t, s, distortion)).astype(np.float32),
        np.stack([at_u.ravel(), at_v.ravel()], axis=1).astype(np.float32),
        np.flatnonzero(light > _DIM * light.max()),
        np.array([lattice.row_pitch, lattice.row_offset(1), int(t[0]) % 2], dtype=np.float32),
    )
    return Capture(samples, np.asarray(v), np.asarray(u), disparity, fields[4])


def front_and_doubt(disparity: Array, std: Array, geometry: Array) -> tuple[Array, Array]:
    """Disparity along which a lens's light moves from view to view, and its standard deviation, both (t, s).

    A lens on an edge sees two surfaces, in shares that stay the same in the other views along the disparity of the
    nearer one, for that is the one whose edge it is. The deviation is raised by the jump.
    """
    known = np.isfinite(disparity)
    square = np.ones((3, 3), np.uint8)
    filled = np.where(known, disparity, np.float32(-9e9))
    high, low = cv2.dilate(filled, square), cv2.erode(np.where(known, disparity, np.float32(9e9)), square)
    jump = np.where(high >= low, high - low, 0)
    error = _CAUTION * np.minimum(np.where(np.isfinite(std), std, _UNKNOWN_STD), _UNKNOWN_STD)
    doubt = np.hypot(error, _JUMP * jump).astype(np.float32)
    above = _highest_beside(filled, geometry) - disparity
    return np.where(known & (above > _EDGE), disparity + _FRONT * above, disparity), doubt


def _highest_beside(field: Array, geometry: Array) -> Array:
    """Largest value of each lens and its nearest neighbours: six in the brick layout, four in the square one."""
    if not geometry[1]:
        return np.asarray(cv2.dilate(field, np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)))
    left = np.array([[1, 1, 0], [1, 1, 1], [1, 1, 0]], np.uint8)
    out = np.asarray(cv2.dilate(field, left))
    shifted = slice(1 - int(geometry[2]), None, 2)
    out[shifted] = cv2.dilate(field, left[:, ::-1].copy())[shifted]
    return out


def surface_of(capture: Capture, shape: tuple[int, int], rule: Rule) -> Surface:
    """Colours seen from the central view, on the grid of `shape` (`lfflow.kernels.colour.surface_colour`)."""
    x, y = surface_places(shape)
    targets, _ = _targets(capture, x, y, 0.0, 0.0, on_lenses=False)
    known = np.flatnonzero(np.isfinite(targets.disparity))
    found = _whole(gather(capture.samples, Targets(*(field[known] for field in targets)), rule), known, shape)
    planes, disparity = found.planes, targets.disparity.reshape(shape)
    noise = sample_noise(planes[..., 0], found.weight, found.variance)
    colours = known_well(found)
    unknown = np.isnan(colours)
    colours, guessed = fill_colours(colours, x, y, disparity, rule.tolerance)
    planes[..., 0] = steady_colours(colours, found.weight, noise, (STEP, STEP))
    like = planes[..., 1:2, 1:] * (planes[..., :1] / np.maximum(planes[..., 1:2, :1], _DARK))
    planes[..., 1:] = np.where(unknown[..., None], like, planes[..., 1:])
    steep = steepness(planes[:, :, 1, 0], found.variance[..., 1], noise)
    return Surface(planes, disparity, steep, guessed)


def known_well(found: Gathered) -> Array:
    """The colours (..., 3) that were gathered, NaN where they rest on next to nothing."""
    least = np.maximum(_WEAK * found.weight.sum(axis=-1, keepdims=True), _LEAST)
    weak = found.weight < least
    return np.where(weak, np.float32(np.nan), found.planes[..., 0])


def _whole(found: Gathered, known: Array, shape: tuple[int, ...]) -> Gathered:
    """What was gathered at the `known` places of a picture, as pictures; the rest is NaN, with no weight."""
    out = []
    for field, rest in zip(found, (np.nan, 0, np.nan), strict=True):
        whole = np.full((math.prod(shape), *field.shape[1:]), rest, dtype=np.float32)
        whole[known] = field
        out.append(whole.reshape(*shape, *field.shape[1:]))
    return Gathered(*out)


def one_view(
    capture: Capture,
    surface: Surface | None,
    x: Array,
    y: Array,
    view: tuple[float, float],
    rule: Rule,
    *,
    on_lenses: bool,
) -> tuple[Array, Array, Array, Array]:
    """Colours (I, J, 3), bits of what was filled, disparity and its doubt (I, J) at the places of the view (v, u).

    With a `surface`, what it knows is read there; without, or where it does not, the samples are gathered anew.
    `on_lenses` says that the places (I, J) are those of the lenses.
    """
    v, u = view
    targets, disparity = _targets(capture, x, y, v, u, on_lenses=on_lenses)
    samples = capture.samples
    own = np.flatnonzero((samples.aperture == (u, v)).all(axis=1))
    used = np.union1d(samples.used, own)
    rgb, guessed = np.full((x.size, 3), np.nan, dtype=np.float32), np.zeros(x.size, dtype=np.uint8)
    if surface is not None:
        read_surface(*surface, targets, rule.tolerance, _UNSURE, rgb, guessed)
        from_view = np.hypot(samples.aperture[used, 0] - u, samples.aperture[used, 1] - v)
        used = np.sort(used[np.argsort(from_view, kind="stable")[:_NEAR]])
    samples = samples._replace(used=used)
    rest = np.flatnonzero(np.isnan(rgb[:, 0]) & np.isfinite(targets.disparity))
    found = gather(samples, Targets(*(field[rest] for field in targets)), rule)
    noise = sample_noise(found.planes[..., 0], found.weight, found.variance)
    weight = np.full((x.size, 3), _READ_WEIGHT, dtype=np.float32)
    rgb[rest] = known_well(found)
    weight[rest] = found.weight
    anew = np.zeros(x.size, dtype=bool)
    anew[rest] = True
    rgb, bits = fill_colours(rgb.reshape(*x.shape, 3), x, y, disparity, rule.tolerance)
    rgb = steady_colours(rgb, weight.reshape(rgb.shape), noise, _pitch(x, y), anew.reshape(x.shape))
    return rgb, bits | guessed.reshape(x.shape), disparity, targets.doubt.reshape(x.shape)


def _pitch(x: Array, y: Array) -> tuple[float, float]:
    """Distance of two rows and of two columns."""
    return float(y[1, 0] - y[0, 0]) if len(y) > 1 else 1.0, float(x[0, 1] - x[0, 0]) if x.shape[1] > 1 else 1.0


def _targets(capture: Capture, x: Array, y: Array, v: float, u: float, *, on_lenses: bool) -> tuple[Targets, Array]:
    """Targets at (x, y) of the view (v, u) by the nearest view's map, and the disparity that the map gives there."""
    near = int(np.argmin(np.abs(capture.v - v))), int(np.argmin(np.abs(capture.u - u)))
    disparity, geometry = capture.disparity[near], capture.samples.geometry
    front, doubt = front_and_doubt(disparity, capture.std[near], geometry)
    beside = u - float(capture.u[near[1]]), v - float(capture.v[near[0]])
    if not on_lenses or beside != (0.0, 0.0):
        disparity, front = (read_disparity(field, x, y, *beside, geometry) for field in (disparity, front))
        doubt = read_disparity(doubt, x, y, 0.0, 0.0, geometry)
    one = np.ones(x.size, dtype=np.float32)
    offset = one * np.float32(u), one * np.float32(v)
    return Targets(x.ravel(), y.ravel(), *offset, front.ravel(), doubt.ravel()), disparity
