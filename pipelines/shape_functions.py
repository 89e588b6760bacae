"""The seed's experiments of chapter 6 on gray scenes: ``python -m pipelines.shape_functions OUT [SIZE]``.

Table 2 (sensibility of Υ against σ), Figure 19 (Υ against errors of dh and θ), Figure 20 (centres by colour) and
Table 3 with the values after Algorithm 1 (global against local), on a simulated camera like the seed's: a CSV file for
each, two figures, and ``agreement.txt``, which compares every printed value.
"""

from __future__ import annotations

import sys
from pathlib import Path

from lfflow.kernels.lattice.spectrum import start
from pipelines import seed_colours, seed_methods, seed_sensibility
from pipelines.seed_gray_scene import AFTER_ALGORITHM_1, SIZE, TABLE_3, photograph


def main(out: Path, size: int = SIZE) -> str:
    """Run all experiments on photos of `size`² pixels; returns the text of all tables and comparisons."""
    out.mkdir(parents=True, exist_ok=True)
    photos = {
        "as Table 3": photograph(TABLE_3, size, seed=1),
        "as Algorithm 1": photograph(AFTER_ALGORITHM_1, size, seed=2),
    }
    photo = photos["as Table 3"]
    sensibility = seed_sensibility.table_2(photo)
    curves = seed_sensibility.figure_19(photo, seed_sensibility.scale(sensibility))
    seed_sensibility.plot(curves, out / "figure19.png")
    colours, centres, lattices = seed_colours.by_colour(photo, start(photo.equal))
    seed_colours.plot(photo, centres, lattices, out / "figure20.png")
    methods = seed_methods.table_3(photos)
    tables = {"table2": sensibility, "figure19": curves, "figure20": colours, "table3": methods}
    for name, table in tables.items():
        table.to_csv(out / f"{name}.csv", index=False)
    lines = [
        *seed_sensibility.agreement(sensibility, curves),
        *seed_colours.agreement(colours),
        *seed_methods.agreement(methods),
    ]
    if size != SIZE:
        lines.insert(0, f"On {size} px instead of the seed's {SIZE}: errors of dh and θ are larger by the same factor.")
    (out / "agreement.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    shown = "\n\n".join(tables[name].to_string(index=False) for name in ("table2", "figure20", "table3"))
    (out / "tables.txt").write_text(shown + "\n", encoding="utf-8")
    return shown + "\n\n" + "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else SIZE))
