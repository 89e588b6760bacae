"""Scores and CPU seconds on folders of HCI views, beside OpenCV's StereoSGBM on two pairs in the same run.

python benchmarks/hci.py FOLDER... [--noise 3]      # each with gt_disp_lowres.pfm; noise in % of the range

`benchmarks/rooms.py` renders more such folders, with what HCI scenes that are not at hand are hard for.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
import xarray as xr

from lfflow.formats.pfm import read_pfm
from lfflow.formats.views import open_views
from lfflow.stages.scores import scores
from lfflow.stages.view_matching import disparity_of_views

BLOCK = 5


def _pair(centre: np.ndarray, other: np.ndarray, baseline: int, low: float, high: float) -> np.ndarray:
    start = int(np.floor(low * baseline)) - 1
    count = int(np.ceil((high * baseline - start + 2) / 16)) * 16
    matcher = cv2.StereoSGBM_create(
        start, count, BLOCK, 8 * 3 * BLOCK**2, 32 * 3 * BLOCK**2, 1, 0, 0, 0, 0, cv2.STEREO_SGBM_MODE_HH
    )
    pad = ((0, 0), (count, count), (0, 0))
    found = matcher.compute(np.pad(centre, pad, mode="edge"), np.pad(other, pad, mode="edge")).astype(np.float32) / 16
    found = found[:, count:-count]
    return np.where(found < start, np.nan, found / baseline)


def stereo_sgbm(rgb: np.ndarray, low: float, high: float) -> np.ndarray:
    """Centre against the views u = 4 and u = −4 (both mirrored); the farther value where the two disagree."""
    bytes_ = np.round(rgb * 255).astype(np.uint8)
    centre = bytes_[4, 4]
    right = _pair(centre, bytes_[4, 8], 4, low, high)
    left = _pair(np.ascontiguousarray(centre[:, ::-1]), np.ascontiguousarray(bytes_[4, 0, :, ::-1]), 4, low, high)[
        :, ::-1
    ]
    agree = np.abs(right - left) < 0.1
    fused = np.where(agree, (right + left) / 2, np.fmin(right, left))
    holes = np.isnan(fused).astype(np.uint8)
    return np.where(holes, np.nanmedian(fused), fused) if holes.any() else fused


def noisy(views: xr.Dataset, percent: float) -> xr.Dataset:
    """Views with Gaussian noise of `percent` of the range, in 8 bit again."""
    if percent == 0:
        return views
    noise = np.random.default_rng(0).normal(0, percent / 100, views["rgb"].shape)
    rgb = (np.round(np.clip(views["rgb"] + noise, 0, 1) * 255) / 255).astype(np.float32)
    return views.assign(rgb=rgb)


def main(folders: list[Path], noise: float) -> None:
    cv2.setNumThreads(1)
    print(f"{'scene':12} {'method':14} {'BP.07':>7} {'BP.03':>7} {'BP.01':>7} {'MSEx100':>8} {'Q25':>6} {'CPU s':>6}")
    for folder in folders:
        views = noisy(open_views(folder).load(), noise)
        truth = xr.DataArray(read_pfm(folder / "gt_disp_lowres.pfm"), dims=("t", "s"))
        low, high = float(truth.min()), float(truth.max())
        disparity_of_views(views.isel(t=slice(0, 64), s=slice(0, 64)))  # compiles
        rgb = views["rgb"].transpose("v", "u", "t", "s", "channel").to_numpy()
        methods = {
            "lfflow": lambda views=views: disparity_of_views(views)["disparity"],
            "StereoSGBM x2": lambda rgb=rgb, low=low, high=high: xr.DataArray(
                stereo_sgbm(rgb, low, high), dims=("t", "s")
            ),
        }
        for name, method in methods.items():
            start = time.process_time()
            found = method()
            seconds = time.process_time() - start
            s = scores(found, truth)
            print(
                f"{folder.name:12} {name:14} {s['badpix_007']:7.2f} {s['badpix_003']:7.2f} {s['badpix_001']:7.2f} "
                f"{s['mse_100']:8.3f} {s['q25']:6.2f} {seconds:6.2f}"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--noise", type=float, default=0.0)
    given = parser.parse_args()
    main(given.folders, given.noise)
