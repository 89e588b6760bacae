"""What is systematic between measured and predicted lattices: constant differences, trends with zoom and focus."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

LEVERS = ("zoom_step", "focus_step")
SIGNIFICANT = 4.0
"""Standard errors."""
MATTERS = 0.01
"""Smallest effect at the edge of the sensor that is called one, pixels."""
STEPS = 100.0


def differences(table: pd.DataFrame) -> dict[str, tuple[pd.Series, pd.Series, str]]:
    """Of each quantity: measured minus predicted, pixels at the sensor's edge per unit of it, and its unit."""
    arm = table["width"] / 2
    return {
        "theta": (table["theta_difference"], arm, "rad"),
        "dv/dh": (table["ratio_difference"], arm, ""),
        "dh": (table["dh_difference"], arm / table["dh"], "px"),
        "dv": (table["dv_difference"], arm / table["dv"], "px"),
        "cx": (table["cx_difference"], pd.Series(1.0, table.index), "px"),
        "cy": (table["cy_difference"], pd.Series(1.0, table.index), "px"),
    }


def trend(values: pd.Series, table: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Slope per 100 steps of zoom and focus and its standard error, from one fit of both; only levers that vary."""
    levers = [name for name in LEVERS if table[name].notna().all() and table[name].nunique() > 1]
    free = len(table) - len(levers) - 1
    if not levers or free < 1:
        return {}
    centred = table[levers] - table[levers].mean()
    design = np.column_stack([np.ones(len(table)), centred / STEPS])
    solution, _, rank, _ = np.linalg.lstsq(design, values.to_numpy(), rcond=None)
    if rank < design.shape[1]:
        return {}
    left = values.to_numpy() - design @ solution
    errors = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * (left**2).sum() / free)
    return {name: (float(solution[i + 1]), float(errors[i + 1])) for i, name in enumerate(levers)}


def statements(table: pd.DataFrame) -> list[str]:
    """A line for each quantity: constant difference and trends, and which of them are systematic."""
    lines = [
        f"{len(table)} lattices; differences are measured minus predicted; effects at the sensor's edge in pixels."
    ]
    for name, (values, leverage, unit) in differences(table).items():
        known = values.dropna()
        if known.empty:
            lines.append(f"{name}: the metadata say nothing")
            continue
        edge, mean = float(leverage.mean()), float(known.mean())
        spread = float(known.std(ddof=1)) if len(known) > 1 else math.nan
        verdict = _verdict(mean, spread / math.sqrt(len(known)), edge)
        lines.append(f"{name}: mean {mean:+.3e} {unit} ({mean * edge:+.3f} px), spread {spread:.1e}: {verdict}")
        lines += _trends(known, table.loc[known.index], edge)
    return [*lines, *_optics(table)]


def _trends(values: pd.Series, table: pd.DataFrame, edge: float) -> list[str]:
    lines = []
    for lever, (slope, deviation) in trend(values, table).items():
        effect = abs(slope) * (table[lever].max() - table[lever].min()) / STEPS * edge
        if abs(slope) > SIGNIFICANT * deviation and effect > MATTERS:
            what = lever.removesuffix("_step")
            lines.append(f"  changes by {slope:+.1e} ± {deviation:.0e} per 100 steps of {what}: {effect:.3f} px in all")
    return lines


def _verdict(mean: float, error: float, edge: float) -> str:
    if abs(mean) * edge <= MATTERS:
        return "agrees"
    if math.isnan(error):
        return "differs; one lattice cannot tell whether always"
    return "systematic" if abs(mean) > SIGNIFICANT * error else "not constant"


def _optics(table: pd.DataFrame) -> list[str]:
    """Lens pitch and gap that the measured pitches ask for, where the metadata know several exit pupils."""
    known = table[table["exit_pupil_offset"].notna()]
    if known["exit_pupil_offset"].round(6).nunique() < 3:
        implied = float(table["implied_pupil"].median())
        verdict = (
            "the metadata know too few to compare" if 5e-3 < implied < 10 else "no lens's: the pitches are not its own"
        )
        return [f"exit pupil that dh asks for: {implied * 1e3:.1f} mm ({verdict})"]
    closeness = 1 / known["exit_pupil_offset"].to_numpy()
    design = np.column_stack([np.ones(len(known)), closeness])
    (base, slope), *_ = np.linalg.lstsq(design, known["dh"].to_numpy(), rcond=None)
    pitch = f"pitch of the array {base:.6f} px (metadata {known['bare_pitch'].mean():.6f})"
    gap = f"its gap f {slope / base * 1e6:.3f} µm (metadata {known['gap'].mean() * 1e6:.3f})"
    return [f"dh against 1/Z: {pitch}, {gap}"]


def convention(table: pd.DataFrame) -> str:
    """Which signs of `mla.sensorOffset` bring the predicted places of C nearest to lens centres."""
    scores = {signs: float(np.sqrt((table[f"off{signs}"] ** 2).mean())) for signs in ("++", "+-", "-+", "--")}
    if any(math.isnan(score) for score in scores.values()):
        return "signs of mla.sensorOffset: unknown"
    if max(scores.values()) - min(scores.values()) < MATTERS:
        return "signs of mla.sensorOffset: the metadata tell no offset"
    best = min(scores, key=lambda signs: scores[signs])
    listed = ", ".join(f"{signs} {score:.3f}" for signs, score in scores.items())
    return f"signs (x, y) of mla.sensorOffset that fit best: {best} (px rms from the nearest lens: {listed})"


def plot(table: pd.DataFrame, path: str) -> None:
    """Each quantity, measured and predicted, against zoom and against focus."""
    from matplotlib.figure import Figure

    quantities = {"theta": "theta", "dv/dh − 1": "ratio", "dh": "dh", "dv": "dv"}
    figure = Figure(figsize=(10, 15), layout="constrained")
    axes = figure.subplots(len(quantities) + 2, len(LEVERS))
    for column, lever in enumerate(LEVERS):
        for row, (title, name) in enumerate(quantities.items()):
            ax = axes[row, column]
            ax.errorbar(table[lever], table[name], yerr=table[f"{name}_std"], fmt="o", ms=4, label="measured, with 1 σ")
            ax.plot(table[lever], table[f"predicted_{name}"], "x", ms=7, label="predicted from metadata")
            ax.set_title(title)
        for row, name in enumerate(("cx", "cy"), start=len(quantities)):
            axes[row, column].axhline(0, color="0.7", lw=1)
            axes[row, column].plot(table[lever], table[f"{name}_difference"], "o", ms=4)
            axes[row, column].set_title(f"{name}, measured − predicted (px)")
        axes[-1, column].set_xlabel(lever.replace("_", " "))
    for ax in axes.ravel():
        ax.ticklabel_format(axis="y", useOffset=False)
    axes[0, 0].legend(fontsize="small")
    figure.savefig(path, dpi=90)
