"""`lfflow calibrate` on a real picture: the document it prints."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lfflow.cli.calibrate import calibrate


def test_prints_the_lattice_of_a_real_picture(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(shared_data / "f01" / "IMG_2.lfp", json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["dh", "dv", "theta", "cx", "cy", "lenses", "rms_px", "method"]
    assert found["dh"] == pytest.approx(9.93, abs=0.01)
    assert found["method"] == "self"
