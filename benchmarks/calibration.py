"""Accuracy and CPU time of the calibration against known lattices: ``python benchmarks/calibration.py [size] [seeds]``.

Errors are rms distances over all lenses, pixels. The bound (Cramér-Rao) is that of somebody who knows the subimages'
shape, the fall-off, the clipping and the noise, and looks for the five numbers of the lattice alone. ``illum`` for the
size takes the whole sensor of that camera and prints the peak memory.
"""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import replace

import numpy as np

from lfflow.cameras import ILLUM
from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.centres import flatten_scene, lens_centres, measure_centres
from lfflow.kernels.equalise import equalise
from lfflow.kernels.lattice_fit import Fit, fit, jacobian, lens_indices, moved
from lfflow.kernels.likelihood import refine
from lfflow.kernels.spectrum import start
from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.simulate.optics import Optics, frame_of
from lfflow.simulate.rays import illuminate
from lfflow.simulate.sensor import Sensor

F01 = Lattice(9.93456, 9.9412, -0.0047, 3.3, 4.4)
CASES = {
    "F01": (F01, 0.0),
    "pitch 10": (Lattice(10.00861, 10.01028, 0.00143, 3.3, 4.4), 0.0),
    "turned 0.28°, rows 5e-4": (Lattice(9.93, 9.93 * 1.0005, -0.0048869, 3.3, 4.4), 0.0),
    "Illum": (Lattice(14.29, 14.297, 0.0012, 3.3, 4.4), 0.0),
    "square 20": (Lattice(20.2, 20.2, 0.01, 3.3, 4.4, "square"), 0.0),
    "F01, cat's eye 0.2": (F01, 0.2),
    "F01, cat's eye 0.6": (F01, 0.6),
    "F01, cat's eye 0.9": (F01, 0.9),
}
COLOURS = 0.7 * np.array([[0.55, 1.0], [1.0, 0.8]], np.float32)
Shape = tuple[int, int]


def light_of(lattice: Lattice, shape: Shape, cat_eye: float = 0.0) -> np.ndarray:
    """Levels of a white image without noise."""
    light = np.empty(shape, np.float32)
    illuminate(light, 0, frame_of(lattice, *shape), Optics(cat_eye=cat_eye).profile(lattice, *shape))
    return light * np.tile(COLOURS, (shape[0] // 2, shape[1] // 2))


def white_image(lattice: Lattice, size: int, seed: int, cat_eye: float = 0.0) -> np.ndarray:
    return Sensor().digitise(light_of(lattice, (size, size), cat_eye), np.random.default_rng(seed))


def fast_path(raw: np.ndarray, *, black: float = 168.0, scene: bool = False) -> tuple[np.ndarray, Fit]:
    """Equalised image, and the lattice of the subimages' peaks."""
    image, _ = equalise(raw, np.full((2, 2), black))
    guess = start(image)
    flat = flatten_scene(image, guess.dh) if scene else image
    return image, fit(measure_centres(flat, guess), guess, raw.shape)


def bound(lattice: Lattice, size: int, cat_eye: float = 0.0) -> float:
    """Cramér-Rao bound of the rms over all lenses, by differences of the forward model itself on a smaller sensor.

    Information grows with the area for the origin and with its square for pitch and rotation, so that the rms distance
    over the lenses falls with the side of the sensor.
    """
    small = min(size, 1000)
    lattice = lattice.anchored(small, small)
    middle = light_of(lattice, (small, small), cat_eye)
    variance = Sensor().noise_std(middle) ** 2
    steps = np.array([1e-4, 1e-4, 1e-5, 1e-2, 1e-2])
    slopes = []
    for index, step in enumerate(steps):
        change = np.eye(5)[index] * step
        sides = [light_of(moved(lattice, sign * change), (small, small), cat_eye) for sign in (1, -1)]
        slope = ((sides[0] - sides[1]) / (2 * step)).astype(float)
        # Pixels that change their lens jump; the model of the information is its smooth part.
        slopes.append(slope[2:-2, 2:-2].ravel())
    root = 1 / np.sqrt(variance[2:-2, 2:-2].ravel())
    design = np.stack(slopes, axis=1) * root[:, None]
    covariance = np.linalg.inv(design.T @ design)
    centres = lens_centres(lattice, small, small, 0.0)
    motion = jacobian(lattice, lens_indices(lattice, centres))
    return float(np.sqrt(np.einsum("anp,pq,anq->", motion, covariance, motion) / len(centres))) * small / size


def measure(lattice: Lattice, cat_eye: float, shape: Shape, seed: int) -> list[float]:
    """Errors and CPU seconds of the peaks, the fast path and the maximum likelihood, and the latter's χ²."""
    raw = Sensor().digitise(light_of(lattice, shape, cat_eye), np.random.default_rng(seed))
    begin = time.process_time()
    image, peaks = fast_path(raw)
    middle = time.process_time()
    fast, _ = refine(image, peaks, precise=False)
    end = time.process_time()
    best, _ = refine(image, peaks)
    last = time.process_time()
    x, y = lattice.centres(*lattice.nearest(best.lattice.cx, best.lattice.cy))
    truth = replace(lattice, cx=float(x), cy=float(y))
    error = np.array([getattr(best.lattice, n) - getattr(truth, n) for n in ("dh", "dv", "theta", "cx", "cy")])
    errors = [found.lattice.distance_to(lattice, *shape) for found in (peaks, fast, best)]
    return [*errors, end - begin, last - end, middle - begin, float(error @ np.linalg.solve(best.covariance, error))]


def self_calibration(size: int, seed: int) -> tuple[float, float, float]:
    """Error, stated deviation of the rms, and CPU seconds on a natural scene without white image."""
    from lfflow.simulate import simulate_capture

    raw, _ = simulate_capture(F01, height=size, width=size, seed=seed, views=[0])
    begin = time.process_time()
    image, _ = equalise(raw["raw"].values, np.full((2, 2), float(raw["black_level"][0])))
    guess = start(image)
    flat = flatten_scene(image, guess.dh)
    found, _ = refine(image, fit(measure_centres(flat, guess), guess, image.shape), scene=flat)
    end = time.process_time()
    motion = jacobian(found.lattice, lens_indices(found.lattice, lens_centres(found.lattice, size, size, 0.0)))
    stated = np.sqrt(np.einsum("anp,pq,anq->", motion, found.covariance, motion) / motion.shape[1])
    return found.lattice.distance_to(F01, size, size), float(stated), end - begin


def random_white(rng: np.random.Generator) -> tuple[Lattice, np.ndarray]:
    """White image of a random lattice with a signal to noise ratio of 10 or more at the peaks of the subimages."""
    pitch = float(np.exp(rng.uniform(np.log(6), np.log(60))))
    size = int(np.clip(14 * pitch, 360, 840)) // 2 * 2
    turn = np.radians(rng.uniform(-3, 3))
    place = rng.uniform(0, size, 2)
    lattice = Lattice(pitch, pitch * rng.uniform(0.995, 1.005), float(turn), *place, str(rng.choice(ARRANGEMENTS)))
    optics = Optics(rng.uniform(0.7, 1), 0.08 * pitch, rng.uniform(0, 0.4), rng.uniform(0, 0.6))
    light = np.empty((size, size), np.float32)
    illuminate(light, 0, frame_of(lattice, size, size), optics.profile(lattice, size, size))
    colours = np.tile(rng.uniform(0.3, 1, (2, 2)), (size // 2, size // 2))
    noise = 0.1 * colours * rng.uniform(0.1, 1) * rng.standard_normal((size, size))
    return lattice, np.rint(2000 * (light * colours + noise) + 400).clip(0, 4095).astype(np.uint16)


def starts(count: int, seed: int) -> None:
    """Find `count` random lattices without any prior knowledge; print those that are missed."""
    missed, errors, seconds = 0, [], time.process_time()
    for draw in range(count):
        truth, raw = random_white(np.random.default_rng([seed, draw]))
        try:
            image, peaks = fast_path(raw, black=400.0)
            found, _ = refine(image, peaks)
            error = found.lattice.distance_to(truth, *raw.shape) / truth.dh
        except LatticeNotFoundError as reason:
            found, error = None, np.inf
            print(f"draw {draw}: {reason}", flush=True)
        errors.append(error)
        if found is None or found.lattice.arrangement != truth.arrangement or error > 0.02:
            missed += 1
            print(f"draw {draw}: {truth} missed by {error:.3f} pitches", flush=True)
    half, most = np.quantile(errors, [0.5, 0.95])
    print(
        f"{count} random lattices, seed {seed}: {missed} missed; error {half:.1e} pitches for half of them, {most:.1e} "
        f"for 95 %; {(time.process_time() - seconds) / count:.2f} CPU s each"
    )


def main(size: int, seeds: int) -> None:
    measure(F01, 0.6, (400, 400), 0)
    print(f"{size}×{size}, mean of {seeds} seeds; χ² has 5 degrees of freedom")
    print(
        f"{'':<24} {'peaks':>8} {'fast':>8} {'likely':>8} {'bound':>8} {'/bound':>6} {'fast s':>6} {'+ s':>5} {'χ²':>6}"
    )
    for name, (lattice, cat_eye) in CASES.items():
        rows = [measure(lattice, cat_eye, (size, size), seed) for seed in range(seeds)]
        peaks, fast, best, first, more, _, chi = np.mean(rows, axis=0)
        least = bound(lattice, size, cat_eye)
        print(
            f"{name:<24} {peaks:8.5f} {fast:8.5f} {best:8.5f} {least:8.5f} {best / least:6.2f} "
            f"{first:6.2f} {more:5.2f} {chi:6.1f}",
            flush=True,
        )
    found = np.array([self_calibration(min(size, 1600), seed) for seed in range(seeds)])
    print("natural scenes, by themselves: error {:.5f} px, stated {:.5f} px, {:.2f} CPU s".format(*found.mean(axis=0)))


def whole_illum() -> None:
    lattice, cat_eye = CASES["Illum"]
    for clip in (cat_eye, 0.6):
        row = measure(lattice, clip, (ILLUM.height, ILLUM.width), 0)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"Illum {ILLUM.width}×{ILLUM.height}, cat's eye {clip:.1f}: peaks {row[0]:.5f}, fast {row[1]:.5f}, "
            f"likelihood {row[2]:.5f} px; {row[3]:.2f} and {row[4]:.2f} CPU s; peak memory {memory:.1f} GiB"
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["illum"]:
        whole_illum()
    elif sys.argv[1:2] == ["starts"]:
        starts(int(sys.argv[2]) if len(sys.argv) > 2 else 200, int(sys.argv[3]) if len(sys.argv) > 3 else 0)
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 3280, int(sys.argv[2]) if len(sys.argv) > 2 else 3)
