"""The seed's experiments on a gray scene: ``python pipelines/shape_functions.py OUT [size]``.

Table 2 (sensibility of Υ against σ), Figure 19 (Υ against an error of dh), Figure 20 (centres by colour), and the
global method against the local one (Table 3 and the values after Algorithm 1), on a simulated camera like the seed's.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from lfflow.kernels.centres import measure_centres
from lfflow.kernels.equalise import equalise
from lfflow.kernels.lattice_fit import fit
from lfflow.kernels.quality import SHAPES, ascend, quality
from lfflow.kernels.spectrum import start
from lfflow.lattice import Lattice
from lfflow.simulate.optics import Optics, frame_of
from lfflow.simulate.rays import illuminate
from lfflow.simulate.sensor import Sensor

SEED_CAMERA = Lattice(dh=10.00861, dv=10.01028, theta=0.00143, cx=0.0, cy=0.0)


def gray_scene(size: int) -> tuple[np.ndarray, Lattice]:
    """Equalised picture of a gray scene, and its lattice, numbered from a lens near the middle."""
    lattice = replace(SEED_CAMERA, cx=size / 2 + 0.3, cy=size / 2 - 0.2)
    light = np.empty((size, size), np.float32)
    illuminate(light, 0, frame_of(lattice, size, size), Optics().profile(lattice, size, size))
    raw = Sensor().digitise(0.7 * light, np.random.default_rng(0))
    return equalise(raw, np.full((2, 2), 168.0))[0], lattice


def sensibility(image: np.ndarray, lattice: Lattice) -> list[str]:
    """Table 2: drop of Υ for a horizontal misalignment of 0.04 px."""
    flat, lines = image - image.mean(), ["sigma " + " ".join(f"{shape:>12}" for shape in SHAPES)]
    for sigma in (5, 4, 3, 2, 1):
        drops = [
            quality(flat, lattice, shape, sigma) - quality(flat, replace(lattice, cx=lattice.cx + 0.04), shape, sigma)
            for shape in SHAPES
        ]
        lines.append(f"{sigma:5d} " + " ".join(f"{drop:12.2f}" for drop in drops))
    return lines


def estimates(image: np.ndarray, truth: Lattice) -> list[str]:
    """Global against local, and each colour alone against gray (Figure 20, from all lenses)."""
    guess, shape, lines = start(image), (image.shape[0], image.shape[1]), []
    found = {"global": ascend(image, guess)}
    for name, whole in (("local, sub-pixel", False), ("local, integer", True)):
        found[name] = fit(measure_centres(image, guess, whole=whole), guess, shape).lattice
    for name, sites in {"red only": [(1, 1)], "green only": [(0, 1), (1, 0)], "blue only": [(0, 0)]}.items():
        alone = np.zeros_like(image)
        for row, column in sites:
            alone[row::2, column::2] = image[row::2, column::2]
        found[name] = fit(measure_centres(alone, guess), guess, shape).lattice
    for name, lattice in found.items():
        error = lattice.distance_to(truth, *shape)
        lines.append(
            f"{name:<17} dh {lattice.dh:.5f} dv {lattice.dv:.5f} theta {lattice.theta:.6f}  {error:.5f} px rms"
        )
    return lines


def plot(image: np.ndarray, lattice: Lattice, path: Path) -> None:
    """Figure 19: Υ against the error of dh and of θ."""
    from matplotlib.figure import Figure

    flat, figure = image - image.mean(), Figure(figsize=(9, 6))
    axes = figure.subplots(len(SHAPES), 2)
    for row, shape in enumerate(SHAPES):
        for column, (name, reach) in enumerate((("dh", 0.04), ("theta", 0.01))):
            errors = np.linspace(-reach, reach, 9)
            for sigma in (1, 2, 3, 4, 5):
                values = [
                    quality(flat, replace(lattice, **{name: getattr(lattice, name) + error}), shape, sigma)
                    for error in errors
                ]
                axes[row, column].plot(errors, np.subtract(values, min(values[0], values[-1])), label=f"σ = {sigma}")
            axes[row, column].set(title=f"{shape}: Υ against the error of {name}")
    axes[0, 0].legend()
    figure.tight_layout()
    figure.savefig(path)


def main(out: Path, size: int = 800) -> str:
    """Run the experiments; tables in ``tables.txt``, the plot in ``figure19.png``."""
    out.mkdir(parents=True, exist_ok=True)
    image, lattice = gray_scene(size)
    report = "\n".join([*sensibility(image, lattice), "", *estimates(image, lattice)]) + "\n"
    (out / "tables.txt").write_text(report, encoding="utf-8")
    plot(image, lattice, out / "figure19.png")
    return report


if __name__ == "__main__":
    print(main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 800))
