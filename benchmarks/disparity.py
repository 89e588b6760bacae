"""Disparity on mosaicked views against the truth: simulated F01 captures, and matching after demosaicking the raw.

python benchmarks/disparity.py [--size 1200] [--seeds 1 2] [--scene natural|hard|colourful] [--camera f01|illum]
    [--iso 100] [--fusions] [--several] [--pictures FOLDER]
python benchmarks/disparity.py --views FOLDER [--smaller 2]
python benchmarks/disparity.py CAPTURE.lfp ...

The second resamples HCI views through the F01's mosaic and matches the same pixels in full colour (METHOD 10.5). The
third tells what whole captures cost.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import xarray as xr

import lfflow
from lfflow.formats.pfm import read_pfm
from lfflow.kernels.colour.guided import fill_colours
from lfflow.kernels.mosaicked.fusion import FUSIONS, trimmed_sum
from lfflow.kernels.mosaicked.levelling import without_strangers
from lfflow.kernels.mosaicked.match_field import Matching, even_noise, first_pass, further_passes
from lfflow.kernels.mosaicked.mosaic_field import MosaicField, mosaic_field
from lfflow.kernels.mosaicked.subpixel import minimum
from lfflow.schema import lattice_of, lattice_variables
from lfflow.simulate import Scene, natural_scene, simulate_capture, simulate_from_views, simulate_white
from lfflow.simulate.body import BODIES, Setting
from lfflow.simulate.texture import natural_texture
from lfflow.stages.demultiplex import demultiplex
from lfflow.stages.disparity import disparity
from lfflow.stages.grid import grid_of
from lfflow.stages.transpose import transpose_disparity
from lfflow.stages.view_matching import disparity_of_views

Image = npt.NDArray[np.float32]
PAIRS = [(a, 0) for a in (-4, -2, 2, 4)]
BORDER = 6
HEAD = (
    "| seed, {} | bad(0.1) % | … near edges % | bad(0.03) % | … near edges % | median | CPU s |\n"
    "|---|---|---|---|---|---|---|"
)
SATURATED = np.array([(0.7, 0.02, 0.02), (0.02, 0.55, 0.02), (0.02, 0.02, 0.7), (0.65, 0.6, 0.02), (0.6, 0.02, 0.6)])
"""Linear sRGB of the leaves in the textures of a colourful scene: all edges are edges of colour."""
BAYER = {"BGGR": cv2.COLOR_BayerRG2RGB, "RGGB": cv2.COLOR_BayerBG2RGB, "GRBG": cv2.COLOR_BayerGB2RGB,
         "GBRG": cv2.COLOR_BayerGR2RGB}  # fmt: skip
"""OpenCV names a pattern by the second row and column."""


def ideal_calibration(white: xr.Dataset, truth: xr.Dataset) -> xr.Dataset:
    """Calibration with the true lattice, so that only the matching is measured."""
    light = white["raw"].to_numpy().astype(np.float32) - float(white["black_level"].mean())
    for row in (0, 1):
        for column in (0, 1):
            light[row::2, column::2] /= np.percentile(light[row::2, column::2], 99.5)
    return xr.Dataset(
        {
            **lattice_variables(lattice_of(truth)),
            "vignetting": (("y", "x"), np.clip(light, 0.01, 1)),
            "pixel_flags": (("y", "x"), np.zeros(light.shape, dtype=np.uint8)),
        }
    )


def demosaicked(raw: xr.Dataset, cal: xr.Dataset) -> list[xr.Dataset]:
    """One field a colour, from the raw frame after flat-fielding and bilinear demosaicking (as most tools do)."""
    black = float(raw["black_level"].mean())
    flat = (raw["raw"].to_numpy() - black) / cal["vignetting"].to_numpy()
    rgb = cv2.cvtColor(np.clip(flat + black, 0, 65535).astype(np.uint16), BAYER[str(raw["cfa_pattern"].item())])
    even = cal.assign(vignetting=cal["vignetting"] * 0 + 1)
    keep = demultiplex(raw, cal)["weight"]
    fields = []
    for colour in range(3):
        one = raw.assign(raw=(("y", "x"), rgb[..., colour]))
        field = demultiplex(one, even)
        field["cfa"] = xr.where(field["cfa"] == 255, field["cfa"], np.uint8(1))
        fields.append(field.assign(weight=keep))
    return fields


def four_pairs(fields: list[xr.Dataset]) -> Image:
    """The same pairs, blocks and fusion for both ways of matching, without second pass or regularisation."""
    labels = np.arange(-0.75, 0.76, 0.125)
    costs = sum(lfflow.pair_costs(field, pairs=PAIRS, hypotheses=labels).to_numpy() for field in fields)
    return minimum(trimmed_sum(np.asarray(costs)), labels)[0]


def demosaicked_views(lf: xr.Dataset) -> list[xr.Dataset]:
    """One field a colour, from every view demosaicked by itself: weighted means that do not cross its edges."""
    gains = lf["white_balance"].to_numpy().astype(np.float32)
    x, y = grid_of(lf).places(lf["t"], lf["s"])
    mosaic, cfa = (lf[name].transpose("v", "u", "t", "s").to_numpy() for name in ("mosaic", "cfa"))
    rgb = np.full((*mosaic.shape, 3), np.nan, dtype=np.float32)
    for j, i in np.argwhere((cfa < 3).any(axis=(2, 3))):
        own = np.where(cfa[j, i][..., None] == np.arange(3), mosaic[j, i][..., None], np.float32(np.nan)) * gains
        found, _ = fill_colours(own, x, y, np.full(x.shape, np.nan, np.float32), 1.0)
        for _ in range(4):
            luminance = cv2.GaussianBlur(np.nan_to_num(found), (0, 0), 0.5).mean(axis=-1)
            found, _ = fill_colours(own, x, y, luminance.astype(np.float32), 0.03)
        rgb[j, i] = found / gains
    there = np.where((cfa < 3)[..., None] & np.isfinite(rgb), np.uint8(1), np.uint8(255))
    dims = ("v", "u", "t", "s")
    return [lf.transpose(*dims, ...).assign(mosaic=(dims, rgb[..., c]), cfa=(dims, there[..., c])) for c in range(3)]


def whole_chain(fields: list[xr.Dataset]) -> Image:
    """The library's own chain on demosaicked fields: each sample then counts in all three colours."""
    options = Matching()
    whole = [field_of(field) for field in fields]
    level = [without_strangers(field._replace(mosaic=even_noise(field))) for field in whole]
    together = level[0]._replace(
        mosaic=np.concatenate([field.mosaic for field in level], axis=1),
        cfa=np.concatenate([np.where(field.cfa < 3, np.uint8(c), field.cfa) for c, field in enumerate(level)], axis=1),
        weight=np.concatenate([field.weight for field in level], axis=1),
        u=np.concatenate([field.u for field in level]),
    )
    return further_passes(together, first_pass(level, options), options)[0]


def field_of(lf: xr.Dataset) -> MosaicField:
    """Arrays of a light field in memory."""
    mosaic, cfa, weight = (lf[name].transpose("v", "u", "t", "s").to_numpy() for name in ("mosaic", "cfa", "weight"))
    axes = (lf["v"].to_numpy(), lf["u"].to_numpy(), lf["t"].to_numpy(), lf["s"].to_numpy())
    return mosaic_field(mosaic, cfa, weight, axes, lattice_of(lf))


def score(name: str, found: Image, truth: Image, edge: npt.NDArray[np.bool_], seconds: float) -> None:
    """Print a row of the table."""
    inner = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    known = np.isfinite(truth[inner])
    error, near = np.abs(found - truth)[inner][known], edge[inner][known]
    bad, rough = ~(error <= 0.1), ~(error <= 0.03)
    print(
        f"| {name} | {100 * bad.mean():.2f} | {100 * bad[near].mean():.2f} | {100 * rough.mean():.2f} "
        f"| {100 * rough[near].mean():.2f} | {np.nanmedian(error):.4f} | {seconds:.2f} |"
    )


def within(out: xr.Dataset, wanted: Image) -> None:
    """Print the share of the errors within one and two standard deviations, by what the flags say of a place."""
    inner = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    found, std, flags = (out[name].to_numpy()[inner] for name in ("disparity", "disparity_std", "flags"))
    ratio = np.abs(found - wanted[inner]) / std
    known = np.isfinite(ratio)
    beside, plain = (flags & 8) > 0, (flags & 2) > 0
    kinds = {"all": flags >= 0, "valid": flags == 0, "low texture": plain, "beside a step": beside & ~plain}
    print(
        "; ".join(
            f"{name} ({(kind & known).sum() / known.sum():.2f}) {(ratio[kind & known] < 1).mean():.3f} "
            f"{(ratio[kind & known] < 2).mean():.3f}"
            for name, kind in kinds.items()
            if (kind & known).any()
        )
    )


def draw(path: Path, wanted: Image, maps: list[Image]) -> None:
    """Picture of the true disparity and the maps side by side, below them their errors (white: beyond 0.1)."""
    low, high = np.nanmin(wanted), np.nanmax(wanted)

    def coloured(values: Image, start: float, end: float, colours: int) -> npt.NDArray[np.uint8]:
        grey = np.nan_to_num(np.clip((values - start) / (end - start), 0, 1) * 255).astype(np.uint8)
        return np.asarray(cv2.applyColorMap(cv2.resize(grey, None, fx=3, fy=3, interpolation=0), colours), np.uint8)

    upper = [coloured(one, low, high, cv2.COLORMAP_TURBO) for one in (wanted, *maps)]
    lower = [coloured(np.abs(one - wanted), 0, 0.1, cv2.COLORMAP_HOT) for one in (wanted, *maps)]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack([np.hstack(upper), np.hstack(lower)]))


def simulated(
    size: int, seed: int, scene: str, camera: str = "f01", iso: float = 100
) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """Raw frame, ideal calibration and truth of a capture."""
    seen = colourful_scene(size, seed) if scene == "colourful" else scene
    raw, truth = simulate_capture(height=size, width=size, seed=seed, scene=seen, camera=camera, rgb_views=[0],
                                  setting=Setting(iso=iso))  # fmt: skip
    white, _ = simulate_white(height=size, width=size, seed=seed, camera=camera)
    return raw, ideal_calibration(white, truth), truth


def capture(
    size: int, seed: int, scene: str, camera: str = "f01", iso: float = 100
) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset, Image, npt.NDArray[np.bool_]]:
    """Raw frame, ideal calibration, light field, true disparity of the central view and where it has an edge near."""
    raw, cal, truth = simulated(size, seed, scene, camera, iso)
    wanted = truth["disparity"].sel(u=0, v=0).to_numpy()
    filled = np.nan_to_num(wanted)
    high, low = cv2.dilate(filled, np.ones((7, 7))), cv2.erode(filled, np.ones((7, 7)))
    return raw, cal, demultiplex(raw, cal).load(), wanted, (high - low) > 0.1


def colourful_scene(size: int, seed: int) -> Scene:
    """A natural scene whose textures are leaves of saturated colours."""
    rng = np.random.default_rng(seed)
    layers = natural_scene(rng, size / 20).layers
    textures = [natural_texture(rng, 512, SATURATED[rng.permutation(len(SATURATED))[:4]]) for _ in layers]
    pairs = zip(layers, textures, strict=True)
    return Scene(tuple(replace(layer, texture=texture) for layer, texture in pairs), name="colourful")


def compare_fusions(size: int, seeds: list[int], scene: str) -> None:
    """One row for each fusion and capture, everything else at its default."""
    print(HEAD.format("fusion"))
    for seed in seeds:
        _, _, lf, wanted, edge = capture(size, seed, scene)
        for fusion in FUSIONS:
            start = time.process_time()
            found = disparity(lf, fusion=fusion)["disparity"].to_numpy()
            score(f"{seed}, {fusion}", found, wanted, edge, time.process_time() - start)


def compare_sources(size: int, seeds: list[int], scene: str, camera: str) -> None:
    """The maps of all views from that of the centre, and from those of two and four more views fused with it."""
    print("| seed, maps of | centre, bad(0.1) % | all views | … what the centre hides | CPU s |\n|---|---|---|---|---|")
    for seed in seeds:
        raw, cal, truth = simulated(size, seed, scene, camera)
        lf = demultiplex(raw, cal).load()
        wanted = truth["disparity"].sel(v=lf["v"], u=lf["u"]).to_numpy()
        known = np.isfinite(wanted)
        known[..., :BORDER, :], known[..., -BORDER:, :] = False, False
        known[..., :BORDER], known[..., -BORDER:] = False, False
        places = [(0, 0), (-2, 0), (2, 0), (0, -2), (0, 2)]
        start = time.process_time()
        maps = [disparity(lf, u=u, v=v) for u, v in places]
        each = (time.process_time() - start) / len(maps)
        middle = np.asarray((lf["v"] == 0) & (lf["u"] == 0))[..., None, None] & known
        own = transpose_disparity(maps[0], lf)
        hidden = ((own["flags"] & 24) == 24).to_numpy() & known & ~middle
        for count in (1, 3, 5):
            start = time.process_time()
            found = transpose_disparity(maps[:count], lf)["disparity"].to_numpy()
            seconds = time.process_time() - start + count * each
            bad = ~(np.abs(found - wanted) <= 0.1)
            shares = " | ".join(f"{100 * bad[kind].mean():.2f}" for kind in (middle, known, hidden))
            print(f"| {seed}, {count} | {shares} | {seconds:.2f} |")


def smaller_views(folder: Path, times: int) -> tuple[xr.Dataset, Image]:
    """Views with the values of their files and the true disparity of the central one, both `times` smaller."""
    views = xr.open_dataset(folder, engine="views").load()
    truth = read_pfm(next(folder.glob("gt_disp*.pfm")))
    size = views.sizes["s"] // times, views.sizes["t"] // times
    values = views["rgb"].transpose("v", "u", "t", "s", "channel").to_numpy()
    small = np.array([[cv2.resize(view, size, interpolation=cv2.INTER_AREA) for view in row] for row in values])
    rgb = (("v", "u", "t", "s", "channel"), small)
    middle = cv2.resize(truth, size, interpolation=cv2.INTER_NEAREST) / times
    return xr.Dataset({"rgb": rgb}, {"v": views["v"], "u": views["u"]}), middle.astype(np.float32)


def lens_of_pixel(lf: xr.Dataset, shape: tuple[int, int]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Row and column (t, s), in the arrays of `lf`, of the lens nearest to every pixel of views of `shape`."""
    lattice = lattice_of(lf)
    down, right = np.mgrid[: shape[0], : shape[1]] * lattice.dh
    cos, sin = np.cos(lattice.theta), np.sin(lattice.theta)
    t, s = lattice.nearest(cos * right - sin * down + lattice.dh / 2, sin * right + cos * down + lattice.dv / 2)
    return t - int(lf["t"][0]), s - int(lf["s"][0])


def through_the_mosaic(folder: Path, times: int) -> None:
    """BadPix(0.07) on the same pixels in full colour and through the mosaic, without and with the camera's noise."""
    views, truth = smaller_views(folder, times)
    inner = (slice(15, -15), slice(15, -15))
    print(f"{folder.name}, {times} times smaller, disparity {truth.min():.2f} … {truth.max():.2f}, {truth.shape}")
    print("| matched | BadPix(0.07) % | … in full colour | MSE × 100 | median | CPU s |\n|---|---|---|---|---|---|")
    for noise in (False, True):
        full = np.nan
        for name in ("full colour", "mosaic"):
            if name == "mosaic":
                raw, at = simulate_from_views(views, xr.DataArray(truth, dims=("t", "s")), noise=noise)
                lattice = lattice_of(at)
                _, white = simulate_white(lattice, height=raw.sizes["y"], width=raw.sizes["x"], noise=False)
                lf = lfflow.demultiplex(raw, white.rename(defects="pixel_flags")).compute()
                start = time.process_time()
                found = disparity(lf)["disparity"].to_numpy()[lens_of_pixel(lf, truth.shape)]
            else:
                seen = noisy(views) if noise else views
                start = time.process_time()
                found = disparity_of_views(seen)["disparity"].to_numpy()
            seconds = time.process_time() - start
            error = np.abs(found - truth)[inner]
            bad = 100 * float((~(error <= 0.07)).mean())
            full = bad if name == "full colour" else full
            print(
                f"| {name}, {'the noise of F01 pixels' if noise else 'no noise'} | {bad:.2f} | {bad / full:.2f} "
                f"| {100 * np.nanmean(error**2):.2f} | {np.nanmedian(error):.4f} | {seconds:.2f} |"
            )


def noisy(views: xr.Dataset) -> xr.Dataset:
    """Views whose every value has the noise of a pixel of the F01's sensor."""
    sensor = BODIES["f01"].sensor_at(Setting())
    counts = sensor.digitise(views["rgb"].to_numpy(), np.random.default_rng(0)).astype(np.float32)
    return views.assign(rgb=(views["rgb"].dims, (counts - sensor.black) / (sensor.white - sensor.black)))


def cost_of(path: Path) -> None:
    """CPU seconds of the central map and of those of all views, best of three."""
    raw = xr.open_dataset(path, engine="lfp").load()
    lf = lfflow.demultiplex(raw, lfflow.calibrate(raw)).load()
    times = []
    for _ in range(3):
        start = time.process_time()
        central = disparity(lf)
        middle = time.process_time()
        transpose_disparity(central, lf)
        times.append((time.process_time() - start, middle - start))
    whole, first = min(times)
    lenses, views = lf.sizes["t"] * lf.sizes["s"], lf.sizes["u"] * lf.sizes["v"]
    print(f"{path.name}, {lenses} lenses: central map {first:.2f} CPU s, with all {views} views {whole:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1200)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--scene", default="natural")
    parser.add_argument("--camera", default="f01", choices=["f01", "illum"])
    parser.add_argument("--iso", type=float, default=100, help="sensitivity: the noise grows with it")
    parser.add_argument("--fusions", action="store_true", help="compare every fusion on the same captures instead")
    parser.add_argument("--several", action="store_true", help="fuse the maps of several views instead")
    parser.add_argument("--views", type=Path, help="folder of HCI views: through the mosaic against full colour")
    parser.add_argument(
        "--smaller", type=int, default=2, help="shrink the views so that the aperture shows their range"
    )
    parser.add_argument("--pictures", type=Path, help="folder for a picture of the maps and their errors, one a seed")
    parser.add_argument("captures", type=Path, nargs="*", help="whole captures, to tell what they cost")
    options = parser.parse_args()
    if options.captures:
        for path in options.captures:
            cost_of(path)
        return
    if options.views:
        through_the_mosaic(options.views, options.smaller)
        return
    if options.fusions:
        compare_fusions(options.size, options.seeds, options.scene)
        return
    if options.several:
        compare_sources(options.size, options.seeds, options.scene, options.camera)
        return
    print(HEAD.format("method"))
    for seed in options.seeds:
        raw, cal, lf, wanted, edge = capture(options.size, seed, options.scene, options.camera, options.iso)
        maps = []
        for name, fields in (("demosaicked first", demosaicked(raw, cal)), ("mosaicked", [lf])):
            start = time.process_time()
            maps.append(four_pairs(fields))
            score(f"{seed}, {name}, four pairs", maps[-1], wanted, edge, time.process_time() - start)
        for name, ready in (("the raw", demosaicked(raw, cal)), ("each view", demosaicked_views(lf))):
            start = time.process_time()
            maps.append(whole_chain(ready))
            score(f"{seed}, whole chain after demosaicking {name}", maps[-1], wanted, edge, time.process_time() - start)
        start = time.process_time()
        out = disparity(lf)
        maps.append(out["disparity"].to_numpy())
        score(f"{seed}, lfflow: whole chain on the mosaic", maps[-1], wanted, edge, time.process_time() - start)
        start = time.process_time()
        transpose_disparity(out, lf)
        print(f"| {seed}, all {lf.sizes['u'] * lf.sizes['v']} views | | | | | | {time.process_time() - start:.2f} |")
        print(f"{seed}, share within 1 and 2 std: ", end="")
        within(out, wanted)
        if options.pictures:
            draw(options.pictures / f"{options.scene}_{seed}.png", wanted, maps)


if __name__ == "__main__":
    main()
