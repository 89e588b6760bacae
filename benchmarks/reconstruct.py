"""Views from a mosaicked field: against demosaicking the raw first, and against demosaicking each view by itself.

python benchmarks/reconstruct.py [--views FOLDER] [--picture OUT.png] [CAPTURE.lfp ...]

Simulated captures always (the rules were tuned on seeds 3 to 6, 11, 12 and 31, others are reported); a folder of HCI
views through the F01's mosaic and real captures where given. A simulated pixel is the mean of 6 rays, the simulator's
default, which leaves steps at edges, and of 24, nearer to the area that a real one collects light from. What bounds a
reconstruction is told by the true disparity, by a capture without noise, and by the places near jumps of the disparity.
The picture shows the place with the most edges in the last simulated capture.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import xarray as xr
from scipy.ndimage import map_coordinates

import lfflow
import lfflow.accessor
from lfflow.formats.pfm import read_pfm
from lfflow.kernels.colour.gather import Rule, Targets, gather
from lfflow.kernels.colour.guided import fill_colours
from lfflow.kernels.colour.shrinkage import sample_noise, steady_colours
from lfflow.kernels.colour.synthesis import front_and_doubt, known_well, one_view, prepare
from lfflow.kernels.sensor.demultiplex import round_to_pixel
from lfflow.schema import lattice_of
from lfflow.simulate import Layer, Scene, rays, simulate_capture, simulate_white
from lfflow.simulate.from_views import simulate_from_views
from lfflow.simulate.optics import Optics, frame_of
from lfflow.simulate.texture import natural_texture
from lfflow.stages.depth import depth
from lfflow.stages.grid import grid_of
from lfflow.stages.picture import develop, to_integers
from lfflow.stages.radiometry import normalise
from lfflow.stages.reconstruct import reconstruct_views
from lfflow.stages.refocus import all_in_focus, refocus
from lfflow.viz.canvas import Canvas
from lfflow.viz.display import to_square

BORDER = 8
CENTRE = {"v": [0], "u": [0]}
EDGE_DIRECTED = {
    "BGGR": cv2.COLOR_BayerBGGR2RGB_EA,
    "GRBG": cv2.COLOR_BayerGRBG2RGB_EA,
    "RGGB": cv2.COLOR_BayerRGGB2RGB_EA,
    "GBRG": cv2.COLOR_BayerGBRG2RGB_EA,
}
TINTS = np.array([(0.45, 0.44, 0.42), (0.62, 0.58, 0.50), (0.18, 0.24, 0.34), (0.50, 0.26, 0.18), (0.12, 0.3, 0.1)])


def demosaicked(raw, radiance):
    """The whole frame (y, x, 3) demosaicked edge-directed."""
    counts = np.clip(radiance * 30000, 0, 65535).astype(np.uint16)
    return cv2.demosaicing(counts, EDGE_DIRECTED[str(raw["cfa_pattern"].values)]).astype(np.float32) / 30000


def flat(raw, cal):
    return normalise(raw).values / np.maximum(cal["vignetting"].values, 0.1)


def raw_first(raw, cal, lf):
    """The whole frame demosaicked, then the central view read at the exact lens centres (cubic)."""
    x, y = lattice_of(lf).centres(lf["t"].values[:, None], lf["s"].values)
    full = demosaicked(raw, flat(raw, cal))
    return cv2.remap(full, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)


def raw_first_without(raw, cal, lf, hidden):
    """Colours of the central view's own pixels; hidden ones are the mean of the four next of their colour at first."""
    radiance = np.pad(flat(raw, cal), 2, mode="reflect")
    places = lattice_of(lf).centres(lf["t"].values[:, None], lf["s"].values)
    x, y = (np.clip(round_to_pixel(place), 0, raw.sizes[dim] - 1) for place, dim in zip(places, "xy", strict=True))
    i, j = y[hidden] + 2, x[hidden] + 2
    radiance[i, j] = (radiance[i - 2, j] + radiance[i + 2, j] + radiance[i, j - 2] + radiance[i, j + 2]) / 4
    return demosaicked(raw, radiance[2:-2, 2:-2])[y, x]


def per_view(lf, u=0, v=0, rounds=4):
    """A view from its own samples: balanced colour differences, neighbours weighed by the luminance found before."""
    view = lf.sel(u=u, v=v)
    gains = lf["white_balance"].values.astype(np.float32)
    here = view["cfa"].values[..., None] == np.arange(3)
    rgb = np.where(here, view["mosaic"].values[..., None], np.float32(np.nan)) * gains
    x, y = grid_of(lf).places(lf["t"], lf["s"])
    found, _ = fill_colours(rgb, x, y, np.full(x.shape, np.nan, np.float32), 1.0)
    for _ in range(rounds):
        luminance = cv2.GaussianBlur(np.nan_to_num(found), (0, 0), 0.5).mean(axis=-1)
        found, _ = fill_colours(rgb, x, y, luminance.astype(np.float32), 0.03)
    return found / gains


def psnr(found, truth, where=None, border=BORDER):
    cut = slice(border, -border)
    error = (np.asarray(found)[cut, cut] - np.asarray(truth)[cut, cut]) ** 2
    return -10 * np.log10(np.nanmean(error if where is None else error[where[cut, cut]]))


def report(title, rows, truth, jumps=None):
    print(title)
    for name, rgb in rows.items():
        parts = (
            ""
            if jumps is None
            else f"   near jumps {psnr(rgb, truth, jumps):6.2f}, else {psnr(rgb, truth, ~jumps):6.2f}"
        )
        print(f"  {name:42} {psnr(rgb, truth):6.2f}{parts}")


def near_jumps(disparity):
    """Places within two lenses of a jump of the disparity (t, s)."""
    square = np.ones((3, 3), np.uint8)
    jumps = cv2.dilate(disparity, square) - cv2.erode(disparity, square) > 0.05
    return cv2.dilate(jumps.astype(np.uint8), square) > 0


def draw_crops(file, rows, jumps, lf, side=44):
    """The same part of every picture beside each other, where most jumps of the disparity are."""
    busy = cv2.boxFilter(jumps.astype(np.float32), -1, (side, side), borderType=cv2.BORDER_CONSTANT)[
        side:-side, side:-side
    ]
    t, s = np.unravel_index(np.argmax(busy), busy.shape)
    top, left = 2 * (t + side // 2), 2 * (s + side // 2)
    shown = [xr.DataArray(to_square(rgb.astype(np.float32), lf), dims=("t", "s", "channel")) for rgb in rows.values()]
    pictures = to_integers(develop(xr.concat([p.isel(t=slice(top, top + 2 * side), s=slice(left, left + 2 * side))
                                              for p in shown], "row"), lf))  # fmt: skip
    sheet = Canvas(len(rows) * 372 + 10, 410)
    for place, (name, picture) in enumerate(zip(rows, pictures, strict=True)):
        sheet.text(10 + 372 * place, 8, name)
        large = cv2.resize(picture, (362, 362), interpolation=cv2.INTER_NEAREST)
        sheet.picture(10 + 372 * place, 34, 362, 362, large)
    Path(file).write_bytes(sheet.png())


def simulated(seed, size, rays, picture_file=None):
    optics = Optics(rays=rays)
    raw, truth = simulate_capture(height=size, width=size, seed=seed, rgb_views=[-3, 0, 4], optics=optics)
    white, _ = simulate_white(height=size, width=size, seed=seed, optics=optics)
    cal = lfflow.calibrate(white)
    lf = lfflow.demultiplex(raw, cal).compute()
    disp = lfflow.transpose_disparity(lfflow.disparity(lf), lf).compute()
    clean, _ = simulate_capture(
        height=size, width=size, seed=seed, rgb_views=[0], views=[0], optics=optics, noise=False
    )
    quiet = lfflow.demultiplex(clean, cal).compute()
    std = xr.zeros_like(truth["disparity"]) + np.float32(0.01)
    true_disp = disp.assign(disparity=truth["disparity"], disparity_std=std)
    rows = {
        "raw first, edge-directed": raw_first(raw, cal, lf),
        "per view, edge-directed": per_view(lf),
        "lfflow, estimated disparity": reconstruct_views(lf, disp, views=CENTRE)["rgb"].values[0, 0],
        "lfflow, true disparity": reconstruct_views(lf, true_disp, views=CENTRE)["rgb"].values[0, 0],
        "raw first, no noise": raw_first(clean, cal, quiet),
        "lfflow, true disparity, no noise": reconstruct_views(quiet, true_disp, views=CENTRE)["rgb"].values[0, 0],
    }
    picture = truth["rgb"].sel(rgb_v=0, rgb_u=0).values
    report(f"simulated F01, seed {seed}, {size} px, {rays} rays a pixel: PSNR of the centre view, dB", rows, picture,
           near_jumps(truth["disparity"].sel(u=0, v=0).values))  # fmt: skip
    if picture_file:
        jumps = np.abs(np.diff(truth["disparity"].sel(u=0, v=0).values, axis=1, append=np.nan)) > 0.1
        draw_crops(picture_file, rows | {"truth": picture}, jumps, lf)
    outer = {"v": [-3], "u": [4]}
    rows = {
        "view (-3, 4), gathered for itself": reconstruct_views(lf, disp, views=outer, shared=False)["rgb"].values[0, 0],
        "view (-3, 4), surfaces shared": reconstruct_views(lf, disp, views=outer, shared=True)["rgb"].values[0, 0],
    }
    report("  an outer view", rows, truth["rgb"].sel(rgb_v=-3, rgb_u=4).values)
    return raw, cal, lf, disp


def shrunk(folder, times=0):
    """Views and central disparity so many times smaller; 0: that no disparity exceeds the F01's range of ±1."""
    views = xr.open_dataset(folder, engine="views").load()
    disparity = read_pfm(next(Path(folder).glob("gt_disp*.pfm")))
    times = times or int(np.ceil(np.abs(disparity).max()))
    size = views.sizes["s"] // times, views.sizes["t"] // times
    linear = views["rgb"].transpose("v", "u", "t", "s", "channel").values ** 2.2
    small = [[cv2.resize(view, size, interpolation=cv2.INTER_AREA) for view in row] for row in linear]
    middle = cv2.resize(disparity, size, interpolation=cv2.INTER_NEAREST) / times
    rgb = (("v", "u", "t", "s", "channel"), np.array(small, np.float32))
    return xr.Dataset({"rgb": rgb}, {"v": views["v"], "u": views["u"]}), xr.DataArray(middle, dims=("t", "s")), times


def through_the_mosaic(folder, times=0):
    """HCI views through the F01's mosaic."""
    views, centre, times = shrunk(folder, times)
    raw, truth = simulate_from_views(views, centre)
    lattice = lattice_of(truth)
    _, white = simulate_white(lattice, height=raw.sizes["y"], width=raw.sizes["x"], noise=False)
    lf = lfflow.demultiplex(raw, white.rename(defects="pixel_flags")).compute()
    disp = lfflow.transpose_disparity(lfflow.disparity(lf), lf).compute()
    std = xr.full_like(truth["disparity"], 0.01)
    own = xr.Dataset({"disparity": truth["disparity"], "disparity_std": std, "flags": (0 * std).astype("uint8")})
    true = lfflow.transpose_disparity(own.assign_coords(t=lf["t"], s=lf["s"]), lf)
    x, y = grid_of(lf).places(lf["t"], lf["s"])
    first = replace(lattice, cx=lattice.dh / 2, cy=lattice.dv / 2)  # the numbering of the views' own pixels
    at = first.nearest(*lattice_of(lf).centres(lf["t"].values[:, None], lf["s"].values))
    row, column = at[0] * lattice.row_pitch, at[1] + lattice.row_offset(at[0])
    view = views["rgb"].sel(u=0, v=0).values
    picture = np.stack([map_coordinates(view[..., c], (row, column), order=3, mode="nearest") for c in range(3)], -1)
    rows = {"raw first, edge-directed": raw_first(raw, white, lf), "per view, edge-directed": per_view(lf)}
    for name, found in (("estimated disparity", disp), ("true disparity", true)):
        fields = [lf[n].values for n in ("mosaic", "cfa", "weight")]
        fields += [found[n].values for n in ("disparity", "disparity_std")]
        capture = prepare(fields, [lf[n].values for n in ("v", "u", "t", "s")], lattice_of(lf))
        rows[f"lfflow, {name}"] = one_view(capture, None, x, y, (0.0, 0.0), Rule(), on_lenses=True)[0]
    inside = (row > 3) & (row < views.sizes["t"] - 4) & (column > 3) & (column < views.sizes["s"] - 4)
    report(
        f"{Path(folder).name}, {times} times smaller, through the F01's mosaic, dB",
        rows,
        np.where(inside[..., None], picture, np.nan),
    )


def one_plane(disparity, seed, size=900):
    """Capture of one natural texture on a plane, with its calibration and scene."""
    rng = np.random.default_rng(seed)
    texture = natural_texture(rng, 512, TINTS, roughness=1.1)
    scene = Scene([Layer(texture, disparity, angle=0.4)])
    raw, truth = simulate_capture(scene=scene, height=size, width=size, seed=seed, rgb_views=[0])
    white, _ = simulate_white(height=size, width=size, seed=seed)
    lf = lfflow.demultiplex(raw, lfflow.calibrate(white)).compute()
    disp = lfflow.transpose_disparity(lfflow.disparity(lf), lf).compute()
    return scene, lf, disp, truth


def super_resolution(disparity, seed, scale=2.0, size=900):
    scene, lf, disp, _ = one_plane(disparity, seed, size)
    pictures = {k: reconstruct_views(lf, disp, views=CENTRE, scale=k)["rgb"].isel(v=0, u=0) for k in (1.0, scale)}
    frame = frame_of(lattice_of(lf), size, size)

    def truth_at(rgb, pitch):
        y, x = np.meshgrid(rgb["t"] / pitch - frame.origin_y, rgb["s"] / pitch - frame.origin_x, indexing="ij")
        out = np.empty((*x.shape, 3), np.float32)
        rays.view_radiance(out, x, y, 0.0, 0.0, scene.arrays(), Optics(rays=24).ray_offsets())
        return out

    def enlarged(picture):
        y, x = np.meshgrid(pictures[scale]["t"] / scale, pictures[scale]["s"] / scale, indexing="ij")
        return cv2.remap(picture, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)

    rows = {
        "bicubic of lfflow at scale 1": enlarged(pictures[1.0].values),
        "bicubic of the true view": enlarged(truth_at(pictures[1.0], 1.0)),
        f"lfflow at scale {scale:g}": pictures[scale].values,
    }
    report(f"scale {scale:g}, plane at disparity {disparity}, seed {seed}, dB", rows, truth_at(pictures[scale], scale))


def refocused(disparity, seed):
    _, lf, disp, truth = one_plane(disparity, seed)
    views = reconstruct_views(lf, disp)
    cut = {"t": slice(10, -10), "s": slice(10, -10)}
    sharp = truth["rgb"].sel(rgb_v=0, rgb_u=0).isel(cut)
    picture = refocus(views, disparity).isel(cut)
    centre = views["rgb"].sel(u=0, v=0).isel(cut)
    whole = float((sharp.diff("s") ** 2).mean())
    everywhere = all_in_focus(views).isel(cut)
    energies = [float((one.diff("s") ** 2).mean()) / whole for one in (picture, everywhere, centre)]
    print(f"refocus to a plane at {disparity}, seed {seed}: gradient energy / that of the true view")
    print(f"  refocused {energies[0]:.3f}, all in focus {energies[1]:.3f}, centre view {energies[2]:.3f}")


def metres(seed, size=1240, focus=0.8):
    """Depth of a simulated capture with known optics: error in units of its stated deviation."""
    raw, truth = simulate_capture(height=size, width=size, seed=seed, rgb_views=[0], views=[0])
    white, _ = simulate_white(height=size, width=size, seed=seed)
    lf = lfflow.demultiplex(raw, lfflow.calibrate(white)).compute()
    disp = lfflow.disparity(lf).compute()
    found = depth(disp, focus_distance=focus)
    true = depth(disp.assign(disparity=truth["disparity"].sel(u=0, v=0, drop=True)), focus_distance=focus)
    score = np.abs((found["depth"] - true["depth"]) / found["depth_std"]).values[BORDER:-BORDER, BORDER:-BORDER]
    score = score[np.isfinite(score)]
    shares = [100 * float((score < k).mean()) for k in (1, 2, 3)]
    print(f"depth, seed {seed}, focused at {focus} m: median {float(found['depth'].median()):.2f} m, "
          f"stated deviation {float(found['depth_std'].median()):.3f} m")  # fmt: skip
    print(
        f"  within 1, 2, 3 deviations: {shares[0]:.1f} %, {shares[1]:.1f} %, {shares[2]:.1f} % (normal: 68, 95, 99.7)"
    )


def leave_out(raw, cal, lf, disp, share=0.1, seed=0):
    """PSNR per colour of samples of the central view that were hidden, read where they were taken (with ρ)."""
    rng = np.random.default_rng(seed)
    own = lf.sel(u=0, v=0)
    usable = (own["cfa"].values < 3) & (own["weight"].values > 0.3)
    hidden = usable & (rng.random(usable.shape) < share)
    field = lf.copy(deep=True)
    at = np.flatnonzero(lf["v"].values == 0)[0], np.flatnonzero(lf["u"].values == 0)[0]
    field["cfa"].values[at][hidden] = 255
    mosaic, colour = own["mosaic"].values, own["cfa"].values
    rows = {"raw first, edge-directed": raw_first_without(raw, cal, lf, hidden)}
    rows |= {"per view, edge-directed": per_view(field), "lfflow": predicted(field, disp)}
    for name, picture in rows.items():
        errors = [picture[..., c][hidden & (colour == c)] - mosaic[hidden & (colour == c)] for c in range(3)]
        red, green, blue = (-10 * np.log10(np.nanmean(e**2)) for e in errors)
        print(f"  10 % left out, {name:24} R {red:.2f}  G {green:.2f}  B {blue:.2f} dB")


def predicted(lf, disp):
    """Central view at the places where its samples were taken: aperture (0, 0) + ρ."""
    fields = [lf[n].values for n in ("mosaic", "cfa", "weight")]
    fields += [disp[n].values for n in ("disparity", "disparity_std")]
    samples = prepare(fields, [lf[n].values for n in ("v", "u", "t", "s")], lattice_of(lf)).samples
    x, y = grid_of(lf).places(lf["t"], lf["s"])
    own = disp.sel(u=0, v=0)
    d = own["disparity"].values
    rho = (field.ravel() for field in samples.residual)
    followed = front_and_doubt(d, own["disparity_std"].values, samples.geometry)
    targets = Targets(x.ravel(), y.ravel(), *rho, *(f.ravel() for f in followed))
    found = gather(samples, targets, Rule())
    noise = sample_noise(found.planes[..., 0], found.weight, found.variance)
    rgb, weight = (field.reshape(*x.shape, 3) for field in (known_well(found), found.weight))
    rgb, _ = fill_colours(rgb, x, y, d, 0.06)
    return steady_colours(rgb, weight, noise, (y[1, 0] - y[0, 0], 1.0))


def timed(lf, disp):
    small = {"t": slice(0, 40)}
    reconstruct_views(lf.isel(small), disp.isel(small))
    inner = dict.fromkeys("vu", range(-4, 5))
    for name, views in (("one view", CENTRE), ("81 views", inner)):
        start = time.process_time()
        reconstruct_views(lf, disp, views=views)
        print(f"  {name:32} {time.process_time() - start:6.2f} CPU s, lenses {lf.sizes['t']} × {lf.sizes['s']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", nargs="*")
    parser.add_argument("--views", help="folder of views")
    parser.add_argument("--picture", help="PNG of colour fringes at edges")
    parser.add_argument("--seeds", type=int, nargs="*", default=[41, 71, 72])
    given = parser.parse_args()
    for seed in given.seeds:
        for rays_of_a_pixel in (6, 24):
            found = simulated(seed, 1240, rays_of_a_pixel, given.picture)
        leave_out(*found)
    for number, disparity in enumerate((0.31, -0.23)):
        super_resolution(disparity, 20 + number)
        refocused(disparity, 20 + number)
    for seed in given.seeds:
        metres(seed)
    for times in (0, 2) if given.views else ():
        through_the_mosaic(given.views, times)
    for path in given.captures:
        raw = xr.open_dataset(path, engine="lfp")
        cal = lfflow.calibrate(raw)
        lf = lfflow.demultiplex(raw, cal).compute()
        disp = lfflow.transpose_disparity(lfflow.disparity(lf), lf).compute()
        print(path)
        leave_out(raw, cal, lf, disp)
        timed(lf, disp)


if __name__ == "__main__":
    main()
