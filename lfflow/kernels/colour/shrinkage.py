"""Colours of a picture with less noise: shrunk towards the line on which the colours around them lie.

Detail is common to the colours (METHOD 9), noise is not: a colour rests on a few samples of its own. Around a place the
colours of a surface scatter along one line of the colour space, from dark to light or from one paint to another, and
what is off that line is mostly noise. So what lies along the line is kept, and what lies beside it is shrunk by the
share of its variance that is noise: the linear estimate of least error, after Lee, Digital image enhancement and noise
filtering by use of local statistics, IEEE PAMI 2, 1980.
"""

from __future__ import annotations

from typing import Any

import cv2
import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

_F = np.float32
_REACH = 2.0
"""Half the side of the window, lens pitches."""
_LEAST_WEIGHT = _F(0.05)
_LEVEL = _F(0.01)
"""Radiance below which photons are no longer what the noise comes from."""
_QUIET = 0.3
"""Quantile of the places whose scatter is taken for noise: elsewhere it is detail, edges, other paints."""
_SKIP = 5
"""One of so many places is judged."""
_SHARE = _F(0.6)
"""Share of a window that must be known for its scatter to be judged."""
_NOTHING = 1e-9
"""Variance / value that is no noise but rounding."""
_TURNS = 4
"""Steps of the power iteration for the direction of the line."""


def sample_noise(rgb: Array, weight: Array, variance: Array) -> float:
    """Variance / value of one sample, from how the samples of a colour scatter in the quiet places.

    The arguments are float32 (..., 3): values, and `lfflow.kernels.colour.gather.Gathered`'s weight and variance.
    """
    with np.errstate(invalid="ignore"):
        scatter, count, value = (field.reshape(-1, 3)[::_SKIP] for field in (variance, weight, rgb))
        ratio = (scatter * count / np.maximum(value, _LEVEL)).ravel()
    ratio = ratio[np.isfinite(ratio)]
    return float(np.quantile(ratio, _QUIET)) if ratio.size else 0.0


def steady_colours(
    rgb: Array, weight: Array, noise: float, pitch: tuple[float, float], where: Array | None = None
) -> Array:
    """Picture with the noise beside the colour lines taken out.

    Parameters
    ----------
    rgb
        float32 (I, J, 3); places with a NaN stay as they are and tell nothing.
    weight
        float32 (I, J, 3): number of samples that a colour rests on.
    noise
        Variance / value of a sample, `sample_noise`; less is taken where the colours scatter less.
    pitch
        Distance of two rows and two columns, lens pitches.
    where
        bool (I, J): the places to change; all by default.
    """
    known = np.asarray(np.isfinite(rgb).all(axis=-1))
    if not known.any():
        return rgb
    rows, columns = (2 * max(int(_REACH / step + 0.5), 1) + 1 for step in pitch)
    sums = cv2.blur(_products(rgb, weight, known), (columns, rows), borderType=cv2.BORDER_REFLECT_101)
    noise = min(noise, _scatter_of_ratios(sums))
    return (
        np.asarray(_shrink(rgb, weight, known if where is None else known & where, sums, _F(noise)))
        if noise > _NOTHING
        else rgb
    )


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _products(rgb: Array, weight: Array, known: Array) -> Array:
    """What a window sums, (I, J, 13): presence, colours, products of two colours, inverse weight."""
    out = np.zeros((rgb.shape[0], rgb.shape[1], 13), dtype=np.float32)
    for i in range(rgb.shape[0]):
        for j in range(rgb.shape[1]):
            if not known[i, j]:
                continue
            red, green, blue = rgb[i, j, 0], rgb[i, j, 1], rgb[i, j, 2]
            here = out[i, j]
            here[0], here[1], here[2], here[3] = _F(1), red, green, blue
            here[4], here[5], here[6] = red * red, green * green, blue * blue
            here[7], here[8], here[9] = red * green, red * blue, green * blue
            for c in range(3):
                here[10 + c] = _F(1) / max(weight[i, j, c], _LEAST_WEIGHT)
    return out


def _scatter_of_ratios(sums: Array) -> float:
    """Variance × weight / value, from how far the ratios of two colours scatter in the quiet windows."""
    judged = sums.reshape(-1, sums.shape[-1])[::_SKIP]
    judged = judged[judged[:, 0] > _SHARE]
    here = judged / judged[:, :1]
    mean = np.maximum(here[:, 1:4], _LEVEL)
    variance = (here[:, 4:7] - here[:, 1:4] ** 2) / mean**2
    expected = here[:, 10:13] / mean
    ratios = []
    for product, a, b in ((7, 0, 1), (9, 1, 2)):
        together = (here[:, product] - here[:, 1 + a] * here[:, 1 + b]) / (mean[:, a] * mean[:, b])
        ratios.append((variance[:, a] + variance[:, b] - 2 * together) / (expected[:, a] + expected[:, b]))
    return max(float(np.quantile(np.concatenate(ratios), _QUIET)), 0.0) if len(here) else 0.0


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _shrink(rgb: Array, weight: Array, where: Array, sums: Array, noise: Any) -> Array:
    out = rgb.copy()
    mean, scale = np.empty(3, dtype=np.float32), np.empty(3, dtype=np.float32)
    off, line, turned = np.empty(3, dtype=np.float32), np.empty(3, dtype=np.float32), np.empty(3, dtype=np.float32)
    own = np.empty(3, dtype=np.float32)
    for i in range(rgb.shape[0]):
        for j in range(rgb.shape[1]):
            if not where[i, j]:
                continue
            here = sums[i, j]
            per = _F(1) / here[0]
            length = _F(0)
            for c in range(3):
                mean[c] = here[1 + c] * per
                scale[c] = np.sqrt(noise * max(mean[c], _LEVEL) * here[10 + c] * per)
                off[c] = (rgb[i, j, c] - mean[c]) / scale[c]
                own[c] = here[0] / (max(weight[i, j, c], _LEAST_WEIGHT) * here[10 + c])
                line[c] = max(mean[c], _LEVEL) / scale[c]
            xx = (here[4] * per - mean[0] * mean[0]) / (scale[0] * scale[0])
            yy = (here[5] * per - mean[1] * mean[1]) / (scale[1] * scale[1])
            zz = (here[6] * per - mean[2] * mean[2]) / (scale[2] * scale[2])
            xy = (here[7] * per - mean[0] * mean[1]) / (scale[0] * scale[1])
            xz = (here[8] * per - mean[0] * mean[2]) / (scale[0] * scale[2])
            yz = (here[9] * per - mean[1] * mean[2]) / (scale[1] * scale[2])
            for _ in range(_TURNS):
                turned[0] = xx * line[0] + xy * line[1] + xz * line[2]
                turned[1] = xy * line[0] + yy * line[1] + yz * line[2]
                turned[2] = xz * line[0] + yz * line[1] + zz * line[2]
                length = np.sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2])
                for c in range(3):
                    line[c] = turned[c] / max(length, _F(1e-12))
            beside = max((xx + yy + zz - length) * _F(0.5) - _F(1), _F(0))
            along, full = _F(0), _F(0)
            for c in range(3):
                along += line[c] * off[c] / own[c]
                full += line[c] * line[c] / own[c]
            along /= max(full, _F(1e-12))
            for c in range(3):
                left = (off[c] - along * line[c]) * beside / (beside + own[c])
                out[i, j, c] = mean[c] + scale[c] * (along * line[c] + left)
    return out
