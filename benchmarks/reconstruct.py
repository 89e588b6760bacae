"""Views from a mosaicked field: against demosaicking the raw first, and against demosaicking each view by itself.

python benchmarks/reconstruct.py [CAPTURE.lfp ...]     # simulated captures always, real ones where given
"""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np
import xarray as xr

import lfflow
from lfflow.kernels.gather import Rule, Samples, Targets, gather
from lfflow.kernels.guided import fill_colours
from lfflow.schema import lattice_of
from lfflow.simulate import simulate_capture, simulate_white
from lfflow.stages.grid import grid_of
from lfflow.stages.radiometry import normalise
from lfflow.stages.reconstruct import reconstruct_views

BORDER = 8
CENTRE = {"v": [0], "u": [0]}
EDGE_DIRECTED = {
    "BGGR": cv2.COLOR_BayerBGGR2RGB_EA,
    "GRBG": cv2.COLOR_BayerGRBG2RGB_EA,
    "RGGB": cv2.COLOR_BayerRGGB2RGB_EA,
    "GBRG": cv2.COLOR_BayerGBRG2RGB_EA,
}


def raw_first(raw, cal, lf):
    """The whole frame demosaicked edge-directed, then the central view read at the exact lens centres (cubic)."""
    shading = np.maximum(cal["vignetting"].values, 0.1)
    radiance = normalise(raw).values / shading
    full = cv2.demosaicing(
        np.clip(radiance * 30000, 0, 65535).astype(np.uint16), EDGE_DIRECTED[str(raw["cfa_pattern"].values)]
    )
    x, y = lattice_of(lf).centres(lf["t"].values[:, None], lf["s"].values)
    return cv2.remap(full.astype(np.float32) / 30000, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)


def sparse_view(lf, u=0, v=0):
    view = lf.sel(u=u, v=v)
    rgb = np.full((*view["mosaic"].shape, 3), np.nan, np.float32)
    for c in range(3):
        rgb[..., c] = np.where(view["cfa"].values == c, view["mosaic"].values, np.nan)
    return rgb


def per_view(rgb, lf):
    """A view's own samples: colour differences, then once more with neighbours weighed by the luminance (edges)."""
    x, y = grid_of(lf).places(lf["t"], lf["s"])
    first, _ = fill_colours(rgb, x, y, np.full(x.shape, np.nan, np.float32), 1.0)
    luminance = cv2.GaussianBlur(np.nan_to_num(first), (0, 0), 0.5).mean(axis=-1)
    second, _ = fill_colours(rgb, x, y, luminance.astype(np.float32), 0.05)
    return first, second


def psnr(found, truth, border=BORDER):
    cut = slice(border, -border)
    error = (np.asarray(found)[cut, cut] - np.asarray(truth)[cut, cut]) ** 2
    return -10 * np.log10(np.nanmean(error))


def simulated(seed, size):
    raw, truth = simulate_capture(height=size, width=size, seed=seed, rgb_views=[0])
    white, _ = simulate_white(height=size, width=size, seed=seed)
    cal = lfflow.calibrate(white)
    lf = lfflow.demultiplex(raw, cal).compute()
    disp = lfflow.transpose_disparity(lfflow.disparity(lf), lf).compute()
    true_disp = disp.assign(
        disparity=truth["disparity"], disparity_std=xr.zeros_like(truth["disparity"]) + np.float32(0.002)
    )
    picture = truth["rgb"].sel(rgb_v=0, rgb_u=0).values
    first, second = per_view(sparse_view(lf), lf)
    rows = {
        "raw first, edge-directed": raw_first(raw, cal, lf),
        "per view, colour differences": first,
        "per view, edge-directed": second,
        "lfflow, estimated disparity": reconstruct_views(lf, disp, views=CENTRE)["rgb"].values[0, 0],
        "lfflow, true disparity": reconstruct_views(lf, true_disp, views=CENTRE)["rgb"].values[0, 0],
    }
    print(f"simulated F01, seed {seed}, {size} px: PSNR of the centre view, dB")
    for name, rgb in rows.items():
        print(f"  {name:32} {psnr(rgb, picture):6.2f}")
    return lf, disp, rows, picture


def leave_out(lf, disp, share=0.1, seed=0):
    """PSNR per colour of samples of the central view that were hidden, read where they were taken (with ρ)."""
    rng = np.random.default_rng(seed)
    own = lf.sel(u=0, v=0)
    usable = (own["cfa"].values < 3) & (own["weight"].values > 0.3)
    hidden = usable & (rng.random(usable.shape) < share)
    field = lf.copy(deep=True)
    at = np.flatnonzero(lf["v"].values == 0)[0], np.flatnonzero(lf["u"].values == 0)[0]
    field["cfa"].values[at][hidden] = 255
    mosaic, colour = own["mosaic"].values, own["cfa"].values
    _, edge = per_view(sparse_view(field), field)
    rgb = predicted(field, disp)
    out = {}
    for name, picture in (("per view, edge-directed", edge), ("lfflow", rgb)):
        errors = [picture[..., c][hidden & (colour == c)] - mosaic[hidden & (colour == c)] for c in range(3)]
        out[name] = [-10 * np.log10(np.nanmean(e**2)) for e in errors]
    return out


def predicted(lf, disp):
    """Central view at the places where its samples were taken: aperture (0, 0) + ρ."""
    lattice = lattice_of(lf)
    cx, cy = lattice.centres(lf["t"].values[:, None], lf["s"].values)
    rho = np.stack([np.floor(cx + 0.5) - cx, np.floor(cy + 0.5) - cy]).astype(np.float32)
    v, u = np.meshgrid(lf["v"], lf["u"], indexing="ij")
    keep = (lf["cfa"].values != 255).any(axis=(2, 3))
    fields = [lf[n].values[keep] for n in ("mosaic", "weight")]
    samples = Samples(
        *fields, disp["disparity"].values[keep], lf["cfa"].values[keep], rho,
        np.stack([u[keep], v[keep]], 1).astype(np.float32), np.array([lattice.row_pitch, 0.5, 0], np.float32),
    )  # fmt: skip
    x, y = grid_of(lf).places(lf["t"], lf["s"])
    own = disp.sel(u=0, v=0)
    std = np.nan_to_num(own["disparity_std"].values, nan=0.1)
    rgb, _ = gather(samples, Targets(x, y, rho[0], rho[1], own["disparity"].values, std), Rule())
    return fill_colours(rgb, x, y, own["disparity"].values, 0.06)[0]


def timed(lf, disp):
    reconstruct_views(lf, disp, views=CENTRE)
    for name, views in (("one view", CENTRE), ("all views", None)):
        start = time.process_time()
        reconstruct_views(lf, disp, views=views)
        print(f"  {name:32} {time.process_time() - start:6.2f} CPU s, lenses {lf.sizes['t']} × {lf.sizes['s']}")


def main() -> None:
    for seed in (3, 4):
        lf, disp, _, _ = simulated(seed, 1240)
        for name, values in leave_out(lf, disp).items():
            print(f"  10 % left out, {name:24} R {values[0]:.2f}  G {values[1]:.2f}  B {values[2]:.2f} dB")
    timed(lf, disp)
    for path in sys.argv[1:]:
        raw = xr.open_dataset(path, engine="lfp")
        lf = lfflow.demultiplex(raw, lfflow.calibrate(raw)).compute()
        disp = lfflow.transpose_disparity(lfflow.disparity(lf), lf).compute()
        print(path)
        for name, values in leave_out(lf, disp).items():
            print(f"  10 % left out, {name:24} R {values[0]:.2f}  G {values[1]:.2f}  B {values[2]:.2f} dB")
        timed(lf, disp)


if __name__ == "__main__":
    main()
