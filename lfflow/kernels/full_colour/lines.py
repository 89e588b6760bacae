"""All views of a field, scaled to their noise and padded for lines of disparity up to the largest."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from lfflow.kernels.full_colour.field import ViewField
from lfflow.kernels.full_colour.spline import smoothed
from lfflow.kernels.threads import each

FloatArray = npt.NDArray[np.float32]

_LUMINANCE = np.float32(0.15)
"""Most that the luminance counts against the detail: it carries gloss, which is no noise but moves weak texture."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Views that places are read in.

    Parameters
    ----------
    views
        (view, layer, t, s) padded by `margin`; they differ by about 1 where they show the same.
    centre
        (layer, t, s) the central view as the spline shows it, not padded.
    u, v
        (view,) float32 offsets.
    threads
        Cores to use.
    """

    views: FloatArray
    centre: FloatArray
    u: FloatArray
    v: FloatArray
    margin: int
    threads: int


def lines_of(field: ViewField, scale: FloatArray, largest: float, threads: int) -> Lines:
    """Lines up to |disparity| `largest` through detail and luminance times `scale` (layer,), the latter bounded."""
    scale = np.array([scale[0], min(scale[1], _LUMINANCE * scale[0])], dtype=np.float32)
    margin = field.margin(largest)
    rows, columns = field.shape
    views = np.empty((len(field.u), len(scale), rows + 2 * margin, columns + 2 * margin), dtype=np.float32)

    def pad(q: int) -> None:
        for c, layer in enumerate(field.layers[q]):
            views[q, c] = cv2.copyMakeBorder(layer * scale[c], margin, margin, margin, margin, cv2.BORDER_REPLICATE)

    each(pad, range(len(field.u)), threads)
    centre = smoothed(field.layers[field.centre] * scale[:, None, None])
    return Lines(views, centre, field.u.astype(np.float32), field.v.astype(np.float32), margin, threads)
