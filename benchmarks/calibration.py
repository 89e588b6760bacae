"""Accuracy and CPU time of the calibration: ``python benchmarks/calibration.py [size] [seeds] [first seed]``.

Errors are rms distances over all lenses, pixels. The bound (Cramér-Rao) is that of somebody who knows the subimages'
shape, the fall-off, the clipping and the noise, and looks for the five numbers of the lattice alone. ``illum`` for the
size takes the whole sensor of that camera and prints the peak memory; ``starts [count] [seed]`` looks for random
lattices without any prior knowledge.
"""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import replace

import numpy as np

from lfflow.cameras import ILLUM
from lfflow.errors import LatticeNotFoundError
from lfflow.kernels.lattice.centres import flatten_scene, lens_centres, measure_centres
from lfflow.kernels.lattice.fit import Fit, fit, jacobian, lens_indices, moved
from lfflow.kernels.lattice.likelihood import refine
from lfflow.kernels.lattice.scene_push import unpushed
from lfflow.kernels.lattice.spectrum import start
from lfflow.kernels.sensor.equalise import equalise
from lfflow.lattice import ARRANGEMENTS, Lattice
from lfflow.simulate.optics import Optics, frame_of
from lfflow.simulate.rays import illuminate
from lfflow.simulate.sensor import Sensor

F01 = Lattice(9.93456, 9.9412, -0.0047, 3.3, 4.4)
CASES = {
    "F01": (F01, 0.0, 1),
    "pitch 10": (Lattice(10.00861, 10.01028, 0.00143, 3.3, 4.4), 0.0, 1),
    "turned 0.28°, rows 5e-4": (Lattice(9.93, 9.93 * 1.0005, -0.0048869, 3.3, 4.4), 0.0, 1),
    "Illum": (Lattice(14.29, 14.297, 0.0012, 3.3, 4.4), 0.0, 1),
    "square 20": (Lattice(20.2, 20.2, 0.01, 3.3, 4.4, "square"), 0.0, 1),
    "F01, gathered": (F01, 0.0, 3),
    "F01, cat's eye 0.02": (F01, 0.02, 1),
    "F01, cat's eye 0.05": (F01, 0.05, 1),
    "F01, cat's eye 0.1": (F01, 0.1, 1),
    "F01, cat's eye 0.2": (F01, 0.2, 1),
    "F01, cat's eye 0.6": (F01, 0.6, 1),
    "F01, cat's eye 0.9": (F01, 0.9, 1),
    "F01, 0.6, gathered": (F01, 0.6, 3),
}
"""Lattice, cat's eye, and the points along the side of a pixel over which it gathers light."""
COLOURS = 0.7 * np.array([[0.55, 1.0], [1.0, 0.8]], np.float32)
Shape = tuple[int, int]


def light_of(lattice: Lattice, shape: Shape, cat_eye: float = 0.0, fine: int = 1) -> np.ndarray:
    """Levels of a white image without noise; each pixel gathers it at `fine`² points of its area."""
    light, total = np.empty(shape, np.float32), np.zeros(shape, np.float32)
    profile = Optics(cat_eye=cat_eye).profile(lattice, *shape)
    field = frame_of(lattice, *shape)  # a lens is as bright as it is, wherever in a pixel its light is taken
    places = (np.arange(fine) + 0.5) / fine - 0.5
    for x in places:
        for y in places:
            nudged = replace(lattice, cx=lattice.cx - x, cy=lattice.cy - y)
            frame = frame_of(nudged, *shape)._replace(origin_x=field.origin_x, origin_y=field.origin_y)
            illuminate(light, 0, frame, profile)
            total += light
    return total / fine**2 * np.tile(COLOURS, (shape[0] // 2, shape[1] // 2))


def fast_path(raw: np.ndarray, *, black: float = 168.0, scene: bool = False) -> tuple[np.ndarray, Fit]:
    """Equalised image, and the lattice of the subimages' peaks."""
    image, _ = equalise(raw, np.full((2, 2), black))
    guess = start(image)
    flat = flatten_scene(image, guess.dh) if scene else image
    return image, fit(measure_centres(flat, guess), guess, raw.shape)


def bound(lattice: Lattice, size: int, cat_eye: float = 0.0, fine: int = 1) -> float:
    """Cramér-Rao bound of the rms over all lenses, by differences of the forward model itself on a smaller sensor.

    Information grows with the area for the origin and with its square for pitch and rotation, so that the rms distance
    over the lenses falls with the side of the sensor.
    """
    small = min(size, 1000)
    lattice = lattice.anchored(small, small)
    middle = light_of(lattice, (small, small), cat_eye, fine)
    variance = Sensor().noise_std(middle) ** 2
    steps = np.array([1e-4, 1e-4, 1e-5, 1e-2, 1e-2])
    slopes = []
    for index, step in enumerate(steps):
        change = np.eye(5)[index] * step
        sides = [light_of(moved(lattice, sign * change), (small, small), cat_eye, fine) for sign in (1, -1)]
        slope = ((sides[0] - sides[1]) / (2 * step)).astype(float)
        # Pixels that change their lens jump; the model of the information is its smooth part.
        slopes.append(slope[2:-2, 2:-2].ravel())
    root = 1 / np.sqrt(variance[2:-2, 2:-2].ravel())
    design = np.stack(slopes, axis=1) * root[:, None]
    covariance = np.linalg.inv(design.T @ design)
    centres = lens_centres(lattice, small, small, 0.0)
    motion = jacobian(lattice, lens_indices(lattice, centres))
    return float(np.sqrt(np.einsum("anp,pq,anq->", motion, covariance, motion) / len(centres))) * small / size


def measure(case: tuple[Lattice, float, int], shape: Shape, seed: int) -> list[float]:
    """Errors of the peaks, the fast path and the maximum likelihood; CPU seconds and χ² of the last two."""
    lattice, cat_eye, fine = case
    raw = Sensor().digitise(light_of(lattice, shape, cat_eye, fine), np.random.default_rng(seed))
    times = [time.process_time()]
    image, peaks = fast_path(raw)
    times.append(time.process_time())
    found = []
    for precise in (False, True):
        found.append(refine(image, peaks, precise=precise)[0])
        times.append(time.process_time())
    errors = [one.lattice.distance_to(lattice, *shape) for one in (peaks, *found)]
    start_s, fast_s, best_s = np.diff(times)
    return [*errors, start_s + fast_s, start_s + best_s, *(chi_square(one, lattice) for one in found)]


def chi_square(found: Fit, lattice: Lattice) -> float:
    """Square of the error in units of the stated covariance."""
    x, y = lattice.centres(*lattice.nearest(found.lattice.cx, found.lattice.cy))
    truth = replace(lattice, cx=float(x), cy=float(y))
    error = np.array([getattr(found.lattice, n) - getattr(truth, n) for n in ("dh", "dv", "theta", "cx", "cy")])
    return float(error @ np.linalg.solve(found.covariance, error))


def self_calibration(size: int, seed: int) -> tuple[float, float, float]:
    """Error, stated deviation of the rms, and CPU seconds on a natural scene without white image."""
    from lfflow.simulate import simulate_capture

    raw, _ = simulate_capture(F01, height=size, width=size, seed=seed, views=[0])
    begin = time.process_time()
    image, _ = equalise(raw["raw"].values, np.full((2, 2), float(raw["black_level"][0])))
    guess = start(image)
    flat = flatten_scene(image, guess.dh)
    centres = measure_centres(flat, guess)
    found, _ = refine(image, unpushed(image, centres, fit(centres, guess, image.shape)), scene=flat)
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
    lattice = Lattice(
        pitch, pitch * rng.uniform(0.995, 1.005), float(turn), *place.tolist(), ARRANGEMENTS[rng.integers(2)]
    )
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


def main(size: int, seeds: int, first: int) -> None:
    measure((F01, 0.6, 1), (400, 400), 0)
    print(
        f"{size}×{size}, rms of seeds {first} to {first + seeds - 1}; mean CPU s from the raw frame; χ² of 5 on average"
    )
    heads = "peaks", "fast", "likely", "bound", "/bound", "fast s", "ML s", "fast χ²", "ML χ²"
    print(f"{'':<24}" + "".join(f"{head:>9}" for head in heads))
    for name, case in CASES.items():
        rows = np.array([measure(case, (size, size), seed) for seed in range(first, first + seeds)])
        peaks, fast, best = np.sqrt(np.mean(rows[:, :3] ** 2, axis=0))
        fast_s, best_s, fast_chi, best_chi = rows[:, 3:].mean(axis=0)
        least = bound(case[0], size, case[1], case[2])
        print(
            f"{name:<24}{peaks:9.5f}{fast:9.5f}{best:9.5f}{least:9.5f}{best / least:9.2f}"
            f"{fast_s:9.2f}{best_s:9.2f}{fast_chi:9.1f}{best_chi:9.1f}",
            flush=True,
        )
    found = np.array([self_calibration(min(size, 1600), seed) for seed in range(first, first + seeds)])
    print("natural scenes, by themselves: error {:.5f} px, stated {:.5f} px, {:.2f} CPU s".format(*found.mean(axis=0)))


def whole_illum() -> None:
    lattice = CASES["Illum"][0]
    for clip in (0.0, 0.6):
        row = measure((lattice, clip, 1), (ILLUM.height, ILLUM.width), 0)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"Illum {ILLUM.width}×{ILLUM.height}, cat's eye {clip:.1f}: peaks {row[0]:.5f}, fast {row[1]:.5f}, "
            f"likelihood {row[2]:.5f} px; {row[3]:.2f} and {row[4]:.2f} CPU s; peak memory {memory:.1f} GiB"
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["illum"]:
        whole_illum()
    elif sys.argv[1:2] == ["starts"]:
        given = [int(word) for word in sys.argv[2:4]]
        starts(*given, *(200, 0)[len(given) :])
    else:
        given = [int(word) for word in sys.argv[1:4]]
        main(*given, *(3280, 3, 0)[len(given) :])
