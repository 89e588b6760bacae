"""Folders of fake captures."""

from __future__ import annotations

from pathlib import Path

import pytest
from fake_chain import write_capture


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    """One white image and three scenes of one camera."""
    folder = tmp_path / "in"
    write_capture(folder / "WHITE_1.lfp", seed=1, kind="white")
    for number in range(3):
        write_capture(folder / f"IMG_{number}.lfp", seed=10 + number, iso=100.0 * (number + 1))
    return folder


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """File with a line per computed (stage, capture)."""
    log = tmp_path / "calls.txt"
    log.touch()
    monkeypatch.setenv("FAKE_CHAIN_LOG", str(log))
    return log
