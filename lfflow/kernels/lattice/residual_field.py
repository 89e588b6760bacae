"""How far the measured subimage centres lie from their lattice, over the sensor, and whether a smooth bend explains it.

The residuals are averaged in cells. A polynomial of their place, of the lowest degree that the cells ask for, is a bend
of the lattice if it is significant and large enough to matter. Significance is told by F-tests against the scatter of
the cells themselves, which holds what the noise of single centres does not: beats of the colour pattern, dirt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lfflow.distortion import DEGREE, STRAIGHT, Distortion, products
from lfflow.kernels.lattice.fit import jacobian, lens_indices, moved
from lfflow.kernels.lattice.lens_state import State
from lfflow.kernels.lattice.light_centres import measure_lenses
from lfflow.lattice import Lattice

FloatArray = npt.NDArray[np.float64]

LENSES_A_CELL = 50
MOST_CELLS = 24
FEWEST_LENSES = 10
OUTLIER = 4.0
DEGREES = (3, DEGREE)
ROUNDS = 4
"""A lens that lies off its lattice is found in steps, each from where the bend found so far puts it."""
CHANCE = 1e-6
"""Largest probability that a straight lattice shows as much."""
SMALLEST_BEND = 0.015
"""Smallest rms of a bend that is worth a correction, pixels: below it no sample changes its place in the aperture by
what the rounding of centres (0.29 px) would let one notice, and imperfections of the centres look alike."""


@dataclass(frozen=True, slots=True)
class ResidualField:
    """Mean residual of the centres in each cell of the sensor; arrays (rows, columns), pixels.

    Parameters
    ----------
    x, y
        Mean place of the cell's lenses.
    dx, dy
        Mean residual, right and down; NaN where a cell holds too few lenses.
    std
        Standard deviation of either mean, from the scatter of the centres within the cell.
    count
        Lenses used.
    """

    x: FloatArray
    y: FloatArray
    dx: FloatArray
    dy: FloatArray
    std: FloatArray
    count: npt.NDArray[np.int64]

    @property
    def excess(self) -> float:
        """χ² per cell and direction: 1 where the field holds nothing but the noise of the centres."""
        return float(np.nanmean((self.dx**2 + self.dy**2) / (2 * self.std**2)))


@dataclass(frozen=True, slots=True)
class Bend:
    """The smooth part of a residual field.

    Parameters
    ----------
    lattice
        The straight part, refitted together with the bend.
    distortion
        Displacement from it; straight where the field does not ask for one.
    rms
        Root mean square of the bend over the cells, pixels, whether it is significant or not.
    chance
        Probability that a straight lattice shows as much.
    """

    lattice: Lattice
    distortion: Distortion
    rms: float
    chance: float


def unjudged(lattice: Lattice) -> Bend:
    """Say nothing of a bend: a scene displaces the measured centres by more than any lens array, and as smoothly."""
    return Bend(lattice, STRAIGHT, float("nan"), float("nan"))


def judge(image: npt.NDArray[np.float32], flags: npt.NDArray[np.uint8], state: State) -> Bend:
    """Smooth bend that the lenses of a white image show, each by its own light.

    Parameters
    ----------
    image
        White image with equal gains of the Bayer sites, shape (y, x).
    flags
        Pixels to leave out, where not 0.
    state
        Lattice and lenses of the image (`lfflow.kernels.lattice.likelihood.refine`).
    """
    shape, found = (image.shape[0], image.shape[1]), unjudged(state.lattice)
    for _ in range(ROUNDS):
        centres, _ = measure_lenses(image, flags, replace(state, lattice=found.lattice), found.distortion)
        measured = centres[np.isfinite(centres[:, 0])]
        found = bend(found.lattice, residual_field(found.lattice, measured, shape), shape)
        if found.distortion.straight:
            break
    return found


def residual_field(lattice: Lattice, centres: FloatArray, shape: tuple[int, int]) -> ResidualField:
    """Residuals of the centres (n, 2), as (x, y), in cells of about `LENSES_A_CELL` lenses or more."""
    places = _places(lattice, lens_indices(lattice, centres))
    residual = centres - places
    cells = int(np.clip(np.sqrt(len(centres) / LENSES_A_CELL), 1, MOST_CELLS))
    column, row = (np.clip((places[:, a] * cells / shape[1 - a]).astype(int), 0, cells - 1) for a in (0, 1))
    cell = row * cells + column
    used = np.ones(len(centres), bool)
    for _ in range(3):
        count = np.bincount(cell, used, cells**2)
        mean = _means(cell, residual, used, cells**2)
        off = np.hypot(*(residual - mean[cell]).T)
        used = off <= OUTLIER * max(float(np.median(off[used])) / 1.1774, 1e-9)
    spread = np.bincount(cell, used * off**2, cells**2) / np.maximum(2 * (count - 1), 1)
    x, y = _means(cell, places, used, cells**2).T
    grid, full = (cells, cells), count >= FEWEST_LENSES
    dx, dy = np.where(full, mean.T, np.nan)
    std = np.where(full, np.sqrt(spread / np.maximum(count, 1)), np.nan)
    x, y, dx, dy, std = (array.reshape(grid) for array in (x, y, dx, dy, std))
    return ResidualField(x, y, dx, dy, std, count.astype(np.int64).reshape(grid))


def _places(lattice: Lattice, k: FloatArray) -> FloatArray:
    return np.asarray(k @ lattice.matrix.T + (lattice.cx, lattice.cy), dtype=np.float64)


def _means(cell: npt.NDArray[np.int64], values: FloatArray, used: npt.NDArray[np.bool_], cells: int) -> FloatArray:
    count = np.maximum(np.bincount(cell, used, cells), 1)
    return np.stack([np.bincount(cell, used * column, cells) / count for column in values.T], axis=1)


def bend(lattice: Lattice, field: ResidualField, shape: tuple[int, int]) -> Bend:
    """Smooth bend of a lattice, straight where the field does not ask for one.

    Parameters
    ----------
    lattice
        From which the residuals were taken.
    field
        Its `residual_field`.
    shape
        Sensor rows and columns.
    """
    known = np.isfinite(field.dx)
    x, y = field.x[known], field.y[known]
    shift = np.stack([field.dx[known], field.dy[known]], axis=1)
    half = np.array([shape[1] - 1, shape[0] - 1]) / 2
    rigid = _design(x, y, half, 1)
    designs = [rigid, *(_design(x, y, half, degree) for degree in DEGREES)]
    designs = [design for design in designs if 2 * design.shape[1] <= len(x)]
    if len(designs) < 2:
        return Bend(lattice, STRAIGHT, 0.0, 1.0)
    chance = min(_probability(rigid, design, shift) for design in designs[1:])
    while len(designs) > 2 and _probability(designs[-2], designs[-1], shift) > CHANCE:
        del designs[-1]
    solution = _solve(designs[-1], shift)
    rms = _rms(designs[-1][:, 3:] @ solution[3:])
    if chance > CHANCE or rms < SMALLEST_BEND:
        return Bend(lattice, STRAIGHT, rms, chance)
    straightened, step = _straightened(lattice, x, y, rigid @ solution[:3])
    onto_x, onto_y = x + step[:, 0], y + step[:, 1]
    terms = _solve(_design(onto_x, onto_y, half, DEGREES[len(designs) - 2]), shift - step)
    numbers = STRAIGHT.numbers.copy()
    numbers[:, 0] = half
    numbers[:, 1 : len(terms)] = terms[1:].T
    straightened = moved(straightened, np.array([0.0, 0.0, 0.0, *terms[0]]))
    return Bend(straightened, Distortion(numbers), rms, chance)


def _design(x: FloatArray, y: FloatArray, half: FloatArray, degree: int) -> FloatArray:
    """1 and the products of `lfflow.distortion.TERMS` up to a degree at places (n,), shape (n, 1 + terms)."""
    return np.column_stack([np.ones_like(x), products(x, y, half, degree)])


def _solve(design: FloatArray, values: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(design, values, rcond=None)[0], dtype=np.float64)


def _rms(shift: FloatArray) -> float:
    return float(np.sqrt((shift**2).sum(axis=1).mean()))


def _probability(narrow: FloatArray, wide: FloatArray, values: FloatArray) -> float:
    """Chance that the columns that `wide` has beyond `narrow` explain so much of noise (F-test, both directions)."""
    from scipy.stats import f

    left, least = (float(((values - design @ _solve(design, values)) ** 2).sum()) for design in (narrow, wide))
    more, free = 2 * (wide.shape[1] - narrow.shape[1]), 2 * (len(values) - wide.shape[1])
    return float(f.sf((left - least) / more / max(least / free, 1e-300), more, free))


def _straightened(lattice: Lattice, x: FloatArray, y: FloatArray, shift: FloatArray) -> tuple[Lattice, FloatArray]:
    """Lattice moved by the shifts (n, 2) of the places (x, y) as far as its five parameters can; how far that is."""
    k = np.stack([x - lattice.cx, y - lattice.cy], axis=1) @ np.linalg.inv(lattice.matrix).T
    design = jacobian(lattice, k)
    step = _solve(design.reshape(-1, 5), shift.T.reshape(-1, 1))[:, 0]
    return moved(lattice, step), np.asarray((design @ step).T, dtype=np.float64)
