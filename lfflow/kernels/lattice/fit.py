"""Algorithm 1 of the seed (6.2.2): the lattice that a set of centres lies on, robust to missing and false ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.lattice.spectrum import from_matrix
from lfflow.lattice import Lattice

FloatArray = npt.NDArray[np.float64]
ROUNDS = 30
ENOUGH = 12000
"""Algorithm 1 runs on about so many centres; the last steps, from its lattice, on all."""
BLOCKS = 16
"""Blocks along each side of the sensor."""
WORST_RMS = 0.16
"""Largest rms residual in lens pitches; centres without a lattice have 0.3."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A lattice and how well the centres lie on it.

    Parameters
    ----------
    lattice
        The five parameters.
    covariance
        Of (dh, dv, theta, cx, cy), shape (5, 5), pixels and radians.
    rms
        Root mean square distance of the used centres from the lattice, pixels.
    count
        Number of centres used.
    """

    lattice: Lattice
    covariance: FloatArray
    rms: float
    count: int


def lens_indices(lattice: Lattice, centres: FloatArray) -> FloatArray:
    """K = round[T⁻¹(c − C)] (seed 6.9), shape (n, 2)."""
    t, s = lattice.nearest(centres[:, 0], centres[:, 1])
    k1 = s - t // 2 if lattice.arrangement == "hexagonal" else s
    return np.stack([k1, t], axis=1).astype(float)


def jacobian(lattice: Lattice, k: FloatArray) -> FloatArray:
    """Derivatives of the centres of lenses k (n, 2) by (dh, dv, theta, cx, cy), shape (2, n, 5)."""
    cos, sin = np.cos(lattice.theta), np.sin(lattice.theta)
    grid = k @ Lattice(1, 1, 0, 0, 0, lattice.arrangement).matrix.T
    gx, gy = grid.T
    px, py = lattice.dh * gx, lattice.dv * gy
    one, zero = np.ones_like(gx), np.zeros_like(gx)
    return np.stack(
        [
            np.stack([cos * gx, -sin * gy, -sin * px - cos * py, one, zero], axis=1),
            np.stack([sin * gx, cos * gy, cos * px - sin * py, zero, one], axis=1),
        ]
    )


def algorithm_one(centres: FloatArray, start: Lattice) -> tuple[Lattice, npt.NDArray[np.bool_]]:
    """The seed's iteration of rounding and least squares, over a disc that grows from the middle to all centres.

    Returns
    -------
    lattice, used
        And which centres it rests on: those that lie nearer than 4 robust standard deviations.
    """
    middle = np.median(centres, axis=0)
    distance = np.hypot(*(centres - middle).T)
    radius = max(8 * start.dh, 0.1 * float(distance.max()))
    lattice, used = start, np.ones(len(centres), bool)
    previous: tuple[float, ...] = ()
    for _ in range(ROUNDS):
        within = distance <= radius
        lattice, near = _round_and_solve(centres[within], lattice)
        used = np.zeros(len(centres), bool)
        used[within] = near
        now = (lattice.dh, lattice.dv, lattice.theta, lattice.cx, lattice.cy)
        if within.all() and np.allclose(now, previous, rtol=0, atol=1e-10) if previous else False:
            break
        previous = now
        radius *= 1.8
    return lattice, used


def _round_and_solve(centres: FloatArray, lattice: Lattice) -> tuple[Lattice, npt.NDArray[np.bool_]]:
    k = lens_indices(lattice, centres)
    extended = np.column_stack([k, np.ones(len(k))])
    x, y = _place(lattice, k)
    used = near_enough(np.hypot(centres[:, 0] - x, centres[:, 1] - y))
    if used.sum() < 8:
        raise LatticeNotFoundError(f"only {int(used.sum())} subimages were found")
    solution = np.linalg.solve(extended[used].T @ extended[used], extended[used].T @ centres[used])
    return from_matrix(solution[:2].T, lattice.arrangement, *map(float, solution[2])), used


def near_enough(distance: FloatArray) -> npt.NDArray[np.bool_]:
    """Which distances are no outliers: below 4 standard deviations of a plane normal error with the same median."""
    return np.asarray(distance <= 4 * max(float(np.median(distance)) / 1.1774, 1e-9))


def _place(lattice: Lattice, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    x, y = (k @ lattice.matrix.T + (lattice.cx, lattice.cy)).T
    return x, y


def fit(centres: FloatArray, start: Lattice, shape: tuple[int, int], grid: tuple[int, int] | None = None) -> Fit:
    """Lattice of a set of centres with its covariance.

    Parameters
    ----------
    centres
        (n, 2) as (x, y), sensor pixels.
    start
        Initial estimate.
    shape
        Sensor rows and columns: the result is numbered for it (`Lattice.anchored`).
    grid
        Rows and columns (t, s) of the numbering; by default those of the lattice itself.

    Raises
    ------
    LatticeNotFoundError
        Fewer than 8 centres, or centres that lie on no lattice.
    """
    if len(centres) < 8:
        raise LatticeNotFoundError(f"only {len(centres)} subimages were found: the picture is too dark or too flat")
    sample = centres[:: max(1, len(centres) // ENOUGH)]
    lattice, _ = algorithm_one(sample, start)
    lattice = lattice.anchored(*shape, grid)
    for measured in (sample, sample, centres):
        k = lens_indices(lattice, measured)
        residual = measured - np.stack(_place(lattice, k), axis=1)
        used = near_enough(np.hypot(*residual.T))
        design = jacobian(lattice, k[used]).reshape(-1, 5)
        normal = design.T @ design
        step = np.asarray(np.linalg.solve(normal, design.T @ residual[used].T.ravel()), dtype=np.float64)
        lattice = moved(lattice, step)
    residual = centres[used] - np.stack(_place(lattice, k[used]), axis=1)
    squares = float((residual**2).sum())
    rms = float(np.sqrt(squares / used.sum()))
    if rms > WORST_RMS * lattice.dh:
        raise LatticeNotFoundError(
            f"the subimages lie on no lattice (rms residual {rms:.2f} px at pitch {lattice.dh:.2f} px): the picture is "
            "too dark, too flat or too blurred"
        )
    scores = (jacobian(lattice, k[used]) * residual.T[:, :, None]).sum(axis=0)
    inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    covariance = block_covariance(inverse, scores, centres[used], shape)
    return Fit(lattice, covariance, rms, int(used.sum()))


def block_covariance(
    inverse: FloatArray, scores: FloatArray, centres: FloatArray, shape: tuple[int, int], blocks: int = BLOCKS
) -> FloatArray:
    """Covariance of a solution by the scatter of the scores (n, p) of the lenses, those of a block summed first.

    What neighbours have in common, such as a scene's edge, counts once a block and not once a lens.
    """
    column, row = (np.clip(centres[:, axis] * blocks // shape[1 - axis], 0, blocks - 1) for axis in (0, 1))
    block = (row * blocks + column).astype(np.int64)
    sums = np.stack([np.bincount(block, score, blocks**2) for score in scores.T])
    return np.asarray(inverse @ (sums @ sums.T) @ inverse, dtype=np.float64)


def moved(lattice: Lattice, step: FloatArray) -> Lattice:
    """Lattice with the parameters (dh, dv, theta, cx, cy) changed by `step`."""
    dh, dv, theta, cx, cy = (float(value) for value in step)
    return Lattice(
        lattice.dh + dh, lattice.dv + dv, lattice.theta + theta, lattice.cx + cx, lattice.cy + cy, lattice.arrangement
    )
