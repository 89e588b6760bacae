"""A view split into fine detail and what remains, so that light that moves with the viewpoint does not move depth.

Gloss and soft shading change slowly over a surface but differ between views by more than the noise; texture does not.
The bilateral filter keeps the edges of objects in the base, so that they do not reach into the detail around them.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

_SPACE, _DIAMETER = 3.0, 7
_CONTRAST = 0.05


def detail_and_base(view: FloatArray, out: FloatArray) -> None:
    """Fill `out` (2, t, s) with the bilateral detail of a view (t, s, channel) in 0..1, and its luminance itself."""
    channels = view.shape[-1]
    luminance = cv2.transform(view, np.full((1, channels), 1 / channels, dtype=np.float32)).reshape(view.shape[:-1])
    base = cv2.bilateralFilter(luminance, _DIAMETER, _CONTRAST, _SPACE)
    np.subtract(luminance, base, out=out[0])
    out[1] = luminance
