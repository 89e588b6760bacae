"""Figure 20 of the seed: centres from one colour alone against those from all, single and after the fit."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd

from lfflow.kernels.lattice.centres import climb, lens_centres
from lfflow.kernels.lattice.fit import fit
from lfflow.lattice import Lattice
from pipelines.seed_gray_scene import Gray

COLOURS = ("gray", "red", "green", "blue")
SIGMA = 2.5
WINDOW = (1010, 1100, 1420, 1455)
"""x0, x1, y0, y1 of the seed's figure."""

Centres = npt.NDArray[np.float64]


def even_mask(sigma: float) -> npt.NDArray[np.float64]:
    """Gaussian mask of 10×10 pixels, as the seed's: a centre can only lie where four pixels meet."""
    line = np.exp(-0.5 * ((np.arange(10) - 4.5) / sigma) ** 2)
    return np.outer(line, line)


def whole_centres(image: npt.NDArray[np.float32], guess: Lattice) -> Centres:
    """The seed's search: the best of all places between pixels, (n, 2) with NaN where there is none."""
    surface = cv2.filter2D(image, cv2.CV_32F, even_mask(SIGMA), anchor=(4, 4), borderType=cv2.BORDER_REFLECT_101)
    starts = lens_centres(guess, image.shape[0], image.shape[1], margin=8.0)
    return climb(np.asarray(surface), starts - 0.5, 0.5 * guess.dh, True) + 0.5  # noqa: FBT003 - whole pixels


def by_colour(photo: Gray, guess: Lattice) -> tuple[pd.DataFrame, dict[str, Centres], dict[str, Lattice]]:
    """One row a colour: single centres and the fitted lattice against gray and truth; the centres; the lattices."""
    images = {"gray": photo.colours, **{name: photo.only(name) for name in COLOURS[1:]}}
    centres = {name: whole_centres(image, guess) for name, image in images.items()}
    lattices = {name: fit(_found(found), guess, photo.shape).lattice for name, found in centres.items()}
    rows = []
    for name in COLOURS:
        step = centres[name] - centres["gray"]
        lattice = lattices[name]
        rows.append(
            {
                "colour": name,
                "same_place": float(np.mean((step == 0).all(axis=1))),
                "single_rms": float(np.sqrt(np.nanmean((step**2).sum(axis=1)))),
                "dh": lattice.dh,
                "dv": lattice.dv,
                "theta": lattice.theta,
                "model_to_gray": lattice.distance_to(lattices["gray"], *photo.shape),
                "model_to_truth": lattice.distance_to(photo.lattice, *photo.shape),
            }
        )
    return pd.DataFrame(rows), centres, lattices


def _found(centres: Centres) -> Centres:
    return centres[np.isfinite(centres[:, 0])]


def agreement(table: pd.DataFrame) -> list[str]:
    """What the seed says about its Figure 20, and what is found here."""
    alone = table[table["colour"] != "gray"]
    same, apart = alone["same_place"].min(), alone["model_to_gray"].max()
    single = alone["single_rms"].min()
    gray, worst = table["model_to_truth"].iloc[0], alone["model_to_truth"].max()
    place = f"most single-colour centres fall on the same place as gray: here {same:.0%} or more"
    model = (
        f"after the fit the colours differ little: here by {apart:.4f} px rms at most, single centres by {single:.2f}"
    )
    return [
        "Figure 20:",
        f"  (a) {place}: {'agrees' if same > 0.5 else 'DIFFERS'}",
        f"  (b) {model}: {'agrees' if apart < 0.1 * single else 'DIFFERS'}",
        f"  not in the seed: gray alone is {gray:.4f} px rms from the truth, the worst colour {worst:.4f} px",
    ]


def plot(photo: Gray, centres: dict[str, Centres], lattices: dict[str, Lattice], path: Path) -> None:
    """Both panels over the picture, at the seed's place on the sensor (or its middle on a smaller one)."""
    from matplotlib.figure import Figure

    x0, x1, y0, y1 = WINDOW
    if photo.shape[1] < x1 or photo.shape[0] < y1:
        x0, y0 = photo.shape[1] // 2 - 45, photo.shape[0] // 2 - 17
        x1, y1 = x0 + 90, y0 + 35
    figure = Figure(figsize=(9, 7.6), layout="constrained")
    axes = figure.subplots(2, 1)
    fitted = {name: lens_centres(lattice, *photo.shape, margin=8.0) for name, lattice in lattices.items()}
    titles = ("(a) single centres, a whole pixel at a time", "(b) centres of the fitted models")
    for ax, places, title in zip(axes, (centres, fitted), titles, strict=True):
        ax.imshow(photo.equal[y0:y1, x0:x1], cmap="gray", extent=(x0 - 0.5, x1 - 0.5, y1 - 0.5, y0 - 0.5))
        for size, (name, found) in zip((90, 55, 30, 12), places.items(), strict=True):
            inside = (found[:, 0] > x0) & (found[:, 0] < x1) & (found[:, 1] > y0) & (found[:, 1] < y1)
            ax.scatter(
                *found[inside].T, s=size, c="0.5" if name == "gray" else name, label=name, edgecolors="k", lw=0.4
            )
        ax.set_title(title)
    axes[0].legend(loc="upper right", fontsize="small")
    figure.savefig(path, dpi=110)
