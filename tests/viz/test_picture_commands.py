"""The commands that make pictures and files of a collection, on a small simulated one."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfflow.cli.export import export
from lfflow.cli.quicklook import quicklook
from lfflow.cli.report import report
from lfflow.cli.run import run
from lfflow.formats.pfm import read_pfm
from lfflow.simulate import simulate_collection


@pytest.fixture(scope="module")
def collection(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    simulate_collection(folder / "raw", captures=1, height=320, width=320)
    assert run(str(folder / "raw"), out=str(folder / "col"), pictures=False) == 0
    return folder / "col"


def test_quicklook_draws_what_is_missing_and_again_when_forced(
    collection: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert quicklook(collection, json_=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"pictures": [str(collection / "quicklook" / "IMG_0001.png")], "failed": {}}
    picture = Path(told["pictures"][0])
    assert cv2.imread(str(picture)).std() > 20
    picture.write_bytes(b"old")
    assert quicklook(collection) == 0
    assert picture.read_bytes() == b"old"
    assert quicklook(collection, force=True) == 0
    assert picture.stat().st_size > 10_000
    assert quicklook(collection, where="iso > 1e9", json_=True) == 0
    assert capsys.readouterr().out.endswith('{"pictures": [], "failed": {}}\n')


def test_the_report_shows_the_pictures_and_every_file(
    collection: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    assert report(collection, out=page, json_=True) == 0
    assert json.loads(capsys.readouterr().out) == {"report": str(page), "captures": 2, "failed": {}}
    text = page.read_text()
    assert text.count("data:image/jpeg;base64,") == 1
    assert "WHITE_0001" in text
    assert "IMG_0001" in text


def test_export_of_a_collection_keeps_its_lattice(
    collection: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(str(collection), format_="pfm", out=tmp_path, json_=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["failed"] == {}
    disparity = read_pfm(told["written"]["IMG_0001"])
    assert np.isfinite(disparity).mean() > 0.5
    assert np.nanstd(disparity) > 0.01
    assert export(str(collection), format_="ply", out=tmp_path, focus_distance=0.8) == 0
    assert b"metres" in (tmp_path / "IMG_0001.ply").read_bytes()[:300]
    assert export(str(collection), format_="pfm", out=tmp_path, where="iso > 1e9") == 0
