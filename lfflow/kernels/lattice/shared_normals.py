"""Normal equations of what all lenses share, gathered from those of every lens (`lfflow.kernels.lattice.lens_scores`).

What belongs to a lens alone is eliminated there; the rest is chained to the common parameters and summed by blocks of
lenses, so that their scatter can be told.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from lfflow.kernels.lattice.lens_light import COLUMNS, Cell, Flags, FloatArray, FloatImage, gather_pixels
from lfflow.kernels.lattice.lens_scores import DENSE, cross_normals, dense_normals, derive, spread
from lfflow.kernels.lattice.radial import FINE


@numba.njit(nogil=True, cache=True)
def _solve_local(normal: FloatArray, right: FloatArray, local: int, size: int, ridge: float) -> float:
    """Eliminate the first `local` parameters in place (lower triangle); by how much χ² falls."""
    fall = 0.0
    for p in range(local):
        pivot = normal[p, p]
        if pivot <= ridge:
            continue
        fall += right[p] * right[p] / pivot
        for i in range(p + 1, size):
            factor = normal[i, p] / pivot
            if factor != 0.0:
                right[i] -= factor * right[p]
                for j in range(p + 1, i + 1):
                    normal[i, j] -= factor * normal[j, p]
    return fall


@numba.njit(nogil=True, cache=True)
def _half_chain(
    normal: FloatArray, right: FloatArray, local: int, move: FloatArray, weight: float, score: FloatArray
) -> FloatArray:
    """Lens's equations (lower triangle) with their rows chained to the common parameters, whose score is added to."""
    half = np.zeros((move.shape[1], normal.shape[0]))
    for i in range(move.shape[0]):
        row = local + i
        for c in range(move.shape[1]):
            factor = move[i, c] * weight
            if factor != 0.0:
                score[c] += factor * right[row]
                for j in range(local, row + 1):
                    half[c, j] += factor * normal[row, j]
                for j in range(row + 1, normal.shape[0]):
                    half[c, j] += factor * normal[j, row]
    return half


@numba.njit(nogil=True, cache=True)
def _chain(
    normal: FloatArray,
    right: FloatArray,
    local: int,
    move: FloatArray,
    weight: float,
    total: FloatArray,
    score: FloatArray,
) -> None:
    """Add a lens's equations to those of the common parameters: `move` (own, common), then the splines."""
    lens, common = move.shape
    half = _half_chain(normal, right, local, move, weight, score)
    for c in range(common):
        for i in range(lens):
            value = half[c, local + i]
            for d in range(c + 1):
                total[c, d] += value * move[i, d]
    rest = local + lens
    for p in range(rest, normal.shape[0]):
        place = common + p - rest
        score[place] += weight * right[p]
        for c in range(common):
            total[place, c] += half[c, p]
        for q in range(rest, p + 1):
            total[place, common + q - rest] += weight * normal[p, q]


@numba.njit(nogil=True, cache=True)
def gather_normals(
    image: FloatImage,
    flags: Flags,
    centres: FloatArray,
    offsets: FloatArray,
    moves: FloatArray,
    blocks: npt.NDArray[np.int64],
    cell: Cell,
    look: Any,
    local: int,
    splines: bool,
    typical: float,
    sums: Any,
    totals: FloatArray,
    scores: FloatArray,
    quality: FloatArray,
) -> None:
    """Normal equations of the parameters that the lenses share, by blocks of lenses.

    Parameters
    ----------
    moves
        Derivatives of the lens's parameters that are not its own by the common ones, (n, parameters − local, common).
    blocks
        Block of each lens, (n,).
    local
        Parameters that each lens has for itself: 1 (β) or 3 (β and γ).
    splines
        Whether the coefficients of the profiles are looked for too.
    typical
        Misfit χ² per degree of freedom of a good lens; a lens weighs less by what it has more. 0: all weigh the same.
    totals, scores, quality
        Matrices (blocks, common, common; lower triangle), scores (blocks, common), and each lens's brightness and
        misfit (n, 2), filled.
    """
    dense = local + moves.shape[1]
    second = look.splines[1, 2] > 0
    number = int(look.splines[0, 2] + look.splines[1, 2]) if splines else 0
    size = dense + number
    pixels = np.zeros((COLUMNS, int(4 * (look.f.shape[0] / FINE + 1) ** 2)))
    slopes = np.zeros((DENSE + 2, pixels.shape[1]))
    places = np.zeros((8, pixels.shape[1]), np.int64)
    shares = np.zeros((8, pixels.shape[1]))
    normal, right = np.zeros((size, size)), np.zeros(size)
    for lens in range(centres.shape[0]):
        ox, oy = offsets[lens, 0], offsets[lens, 1]
        count, bright = gather_pixels(image, flags, centres[lens, 0], centres[lens, 1], ox, oy, cell, look, pixels)
        if bright <= 0.0:
            continue
        squares, used = derive(pixels, count, bright, ox, oy, look, slopes, sums)
        normal[:], right[:] = 0.0, 0.0
        dense_normals(slopes, count, dense, normal, right)
        if splines:
            spread(pixels, slopes, count, bright, look.splines, 0, places[:4], shares[:4])
            if second:
                spread(pixels, slopes, count, bright, look.splines, 1, places[4:], shares[4:])
                for k in range(count):
                    for a in range(4, 8):
                        if places[a, k] >= 0:
                            places[a, k] += int(look.splines[0, 2])
            cross_normals(slopes, count, dense, places[: 8 if second else 4], shares, normal, right)
        fall = _solve_local(normal, right, local, size, 1e-9)
        misfit = (squares - fall) / max(used - local, 1)
        quality[lens, 0], quality[lens, 1] = bright, misfit
        weight = 1.0 if typical == 0.0 else typical / max(misfit, typical)
        if used > local + 4:
            _chain(normal, right, local, moves[lens], weight, totals[blocks[lens]], scores[blocks[lens]])
