from __future__ import annotations

import importlib.util
from pathlib import Path

PATH = Path(__file__).parents[2] / "pipelines" / "subpixel_study.py"


def test_the_default_interpolations_are_those_that_win(capsys, tmp_path):
    spec = importlib.util.spec_from_file_location("subpixel_study", PATH)
    study = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(study)
    rows = study.main(["--out", str(tmp_path / "study.png")])
    assert (tmp_path / "study.png").stat().st_size > 1000
    assert capsys.readouterr().out.count("\n") == len(rows) + 2
    rms = {(row["images"], row["cost"]): row["rms"] for row in rows}
    assert rms["cubic x2", "parabola"] < 1.1 * min(rms.values())
    assert rms["cubic x2", "parabola"] < rms["linear x2", "parabola"] < rms["linear", "parabola"]
