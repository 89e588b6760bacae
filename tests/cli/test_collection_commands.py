"""The commands of a collection, on one that no capture needs to be computed for."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr

from lfflow.cli.plan import plan
from lfflow.cli.query import query
from lfflow.cli.run import run
from lfflow.cli.scan import scan
from lfflow.cli.status import status
from lfflow.cli.validate import validate
from lfflow.collection.inputs import find_files
from lfflow.errors import CollectionError, FormatError, LfflowError
from lfflow.run import chain


@pytest.fixture
def scanned(tmp_path, monkeypatch, capsys):
    """A collection with a white image, two scenes and a broken file in its catalogue."""

    def open_raw(path):
        if "BROKEN" in path:
            raise FormatError(f"{path}: found nothing, expected a picture")
        kind = "white" if "WHITE" in path else "scene"
        return xr.Dataset(
            {"raw": (("y", "x"), np.zeros((4, 4), "uint16"))},
            coords={"kind": kind, "camera_serial": "A", "camera_model": "F01", "iso": float(len(path) % 7),
                    "zoom_step": 5.0, "focus_step": 6.0},
        )  # fmt: skip

    monkeypatch.setattr("lfflow.run.batch.scan_collection.__defaults__", (chain.Chain(open_raw, chain.CHAIN.stages),))
    for name in ("WHITE", "A", "BB", "BROKEN"):
        (tmp_path / f"{name}.lfp").write_text(name)
    assert scan(str(tmp_path / "*.lfp"), out=str(tmp_path / "col")) == 2
    assert "4 files, 1 cannot be read" in capsys.readouterr().out
    return str(tmp_path / "col")


def test_status_counts_and_lists_failures(scanned, capsys):
    assert status(scanned, json_=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["kinds"] == {"scene": 2, "white": 1, "unreadable": 1}
    assert told["stages"]["calibration"] == {"pending": 1, "unreadable": 1}
    assert list(told["failed"]) == ["BROKEN"]
    assert status(scanned, failed=True) == 0
    assert capsys.readouterr().out.startswith("BROKEN  found nothing")


def test_status_explains_the_choice_of_the_white_image(scanned, capsys):
    status(scanned, why="BB")
    text = capsys.readouterr().out
    assert "white         WHITE\n" in text
    assert "  WHITE: zoom 0 and focus 0 steps away" in text


def test_query_takes_pandas_and_sql(scanned, capsys):
    assert query(scanned, "kind == 'scene' and disparity_state == 'pending'") == 0
    assert capsys.readouterr().out.split() == ["A", "BB"]
    pytest.importorskip("duckdb")
    assert query(scanned, "select count(*) as n from catalogue where white = 'WHITE'", sql=True, json_=True) == 0
    assert json.loads(capsys.readouterr().out) == [{"n": 2}]


def test_a_wrong_expression_or_collection_is_said(scanned, tmp_path):
    with pytest.raises(CollectionError, match="no column no_such_column"):
        query(scanned, "no_such_column > 1")
    with pytest.raises(CollectionError, match="no collection at"):
        status(str(tmp_path / "nowhere"))


def test_the_plan_lists_steps_and_needs(scanned, capsys):
    assert plan(scanned, json_=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert {(step["capture"], step["stage"]) for step in told["steps"]} == {
        ("WHITE", "calibration"), *((c, s) for c in ("A", "BB") for s in ("lightfield", "disparity"))
    }  # fmt: skip
    assert told["needs"]["steps"] == 5
    assert plan(scanned) == 0
    assert "time of calibration, lightfield, disparity by built-in constants\n" in capsys.readouterr().out


def test_validate_finds_nothing_in_a_whole_collection(scanned, capsys):
    assert validate(scanned) == 0
    assert capsys.readouterr().out == "everything is whole\n"


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ("[disparty]\n", r"no table \[disparty\]; there are calibration"),
        ("[disparity]\nwidth = 1\n", "no key 'width'; there are"),
    ],
)
def test_an_unknown_key_of_the_configuration_is_a_usage_error(tmp_path, toml, message):
    (tmp_path / "c.toml").write_text(toml)
    with pytest.raises(LfflowError, match=message):
        run("x.lfp", out=str(tmp_path / "col"), config=tmp_path / "c.toml")


def test_an_input_that_is_not_there_is_said(tmp_path):
    with pytest.raises(CollectionError, match="no such input"):
        find_files([tmp_path / "nothing*.lfp"])
