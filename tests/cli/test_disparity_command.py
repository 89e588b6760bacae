import json
import shutil

import pytest

from lfflow.cli import app


@pytest.fixture
def cross(shared_data, tmp_path):
    source = shared_data / "hci" / "antinous"
    for k in {9 * 4 + u for u in (0, 4, 8)} | {9 * v + 4 for v in (0, 8)}:
        shutil.copy(source / f"input_Cam{k:03d}.png", tmp_path)
    return tmp_path, source / "gt_disp_lowres.pfm"


def test_benchmark_and_disparity_of_five_views(cross, capsys):
    folder, truth = cross
    wide = ["--range", "-3.3", "2.9"]
    assert app(["benchmark", str(folder), "--gt", str(truth), *wide, "--json"]) == 0
    scored = json.loads(capsys.readouterr().out)
    assert set(scored) == {"badpix_007", "badpix_003", "badpix_001", "mse_100", "q25", "seconds"}
    assert scored["badpix_007"] < 60
    assert scored["mse_100"] < 40
    assert app(["disparity", str(folder), "--out", str(folder / "d.pfm"), *wide, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["rows"], told["columns"]) == (512, 512)
    assert (folder / "d.pfm").stat().st_size > 4 * 512 * 512
