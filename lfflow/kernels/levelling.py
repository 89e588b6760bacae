"""Views brought to the brightness of the central one, where gloss and soft shading move with the viewpoint.

What a view differs by from the completed picture, along a first disparity and smoothed over several lenses, is no
texture: it is light that changes with the direction. Left in, it pulls the matching of weak texture to wherever the
picture's own slopes make up for it.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np
import numpy.typing as npt

from lfflow.conventions import CFA_NONE
from lfflow.kernels.mosaic_field import MosaicField
from lfflow.kernels.refine import read_picture
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]


def levelled(
    field: MosaicField,
    picture: FloatArray,
    disparity: FloatArray,
    *,
    limit: float,
    least: float,
    sigma: float = 3.0,
    threads: int = 1,
) -> MosaicField:
    """Field whose samples have lost their view's smooth difference to `picture` (3, t, s) along `disparity` (t, s).

    Parameters
    ----------
    limit
        Difference, in units of the mosaic, beyond which a sample hardly counts: it may show another surface.
    least
        Smooth difference that is taken off by half; less may be what noise and texture make.
    sigma
        Gaussian over which the difference is smoothed, lens pitches.
    """
    padded = np.pad(np.moveaxis(picture, 0, -1), ((1, 1), (1, 1), (0, 0)), mode="edge").astype(np.float32)
    start = np.ascontiguousarray(disparity, dtype=np.float32)
    mosaic = field.mosaic.copy()

    def one_view(at: tuple[int, int]) -> None:
        j, i = at
        total = np.zeros((2, *disparity.shape), dtype=np.float32)
        place = np.float32(field.u[i]), np.float32(field.v[j])
        view = field.mosaic[j, i], field.cfa[j, i], field.weight[j, i]
        _differences(view, place, field.rho, field.offset, np.float32(field.row_pitch), padded, start,
                     np.float32(limit), total)  # fmt: skip
        smooth, weight = (cv2.GaussianBlur(one, (0, 0), sigma, sigmaY=sigma / field.row_pitch) for one in total)
        smooth /= np.maximum(weight, np.float32(1e-4))
        square = smooth * smooth
        mosaic[j, i] -= smooth * square / (square + np.float32(least**2))
        mosaic[j, i][field.cfa[j, i] == CFA_NONE] = 0

    each(one_view, field.views(), threads)
    return field._replace(mosaic=mosaic)


@numba.njit(nogil=True, cache=True, fastmath={"contract", "nsz"})
def _differences(view, place, rho, offset, pitch, padded, disparity, limit, total):  # type: ignore[no-untyped-def]
    """Add to (2, t, s), at the places of the view's own samples, their differences and weights."""
    mosaic, cfa, confidence = view
    u, v = place
    rows, columns = disparity.shape
    one, half = np.float32(1), np.float32(0.5)
    narrow = one / (limit * limit)
    for t in range(rows):
        for s in range(columns):
            d = disparity[t, s]
            if np.isnan(d):
                continue
            row = int(np.floor(np.float32(t) - d * v / pitch + half))
            if row < 1 or row >= rows - 1:
                continue
            column = int(np.floor(np.float32(s) + offset[t] - d * u - offset[row] + half))
            if column < 1 or column >= columns - 2 or cfa[row, column] == CFA_NONE:
                continue
            x = np.float32(column) + offset[row] + d * (u + rho[0, row, column])
            y = np.float32(row) + d * (v + rho[1, row, column]) / pitch
            r = mosaic[row, column] - read_picture(padded, offset, x, y, cfa[row, column])[0]
            robust = one / (one + r * r * narrow)
            w = confidence[row, column] * robust * robust
            total[0, row, column] += w * r
            total[1, row, column] += w
