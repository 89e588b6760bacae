"""The demo on a small sensor: the chain from simulated files to a scored collection, its pictures and its page."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import pytest

from lfflow import open_collection
from lfflow.schema import SCHEMAS
from pipelines.demo import demo


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    folder = tmp_path_factory.mktemp("demo")
    return folder, demo(folder, captures=1, size=520)


def test_the_chain_agrees_with_the_simulated_truth(
    first_run: tuple[Path, int], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, code = first_run
    assert code == 0
    assert demo(folder, input=folder / "input") == 0
    said = capsys.readouterr().out
    assert "0 results made" in said
    lattice = re.search(r"WHITE_0001: ([\d.]+) px", said)
    disparity = re.search(r"IMG_0001: ([\d.]+) % within 0.1, median error ([\d.]+)", said)
    assert lattice is not None
    assert disparity is not None
    assert float(lattice[1]) <= 0.03
    assert float(disparity[1]) >= 80
    assert float(disparity[2]) <= 0.02


def test_a_picture_of_each_capture_and_a_page_are_left(first_run: tuple[Path, int]) -> None:
    collection = first_run[0] / "collection"
    picture = cv2.imread(str(collection / "quicklook" / "IMG_0001.png"))
    assert picture is not None
    assert picture.std() > 20
    assert "IMG_0001" in (collection / "report.html").read_text()


@pytest.mark.parametrize("kind", ["calibration", "lightfield", "disparity"])
def test_every_store_is_what_its_schema_declares(first_run: tuple[Path, int], kind: str) -> None:
    SCHEMAS[kind].check(open_collection(first_run[0] / "collection").open(kind), kind)
