"""`lfflow info`: every kind of file, as text and as JSON; broken ones end in a message."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from lfflow.cli import main
from lfflow.formats.archives import write_storage
from lfflow.formats.eslf import write_eslf
from lfflow.formats.pfm import write_pfm
from lfflow.formats.png import write_png
from lfflow.formats.toolbox import write_toolbox
from lfflow.formats.views import write_views

LIGHT_FIELD = xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), np.zeros((3, 3, 4, 5, 3), np.float32))})


@pytest.fixture
def info(monkeypatch, capsys):
    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lfflow", "info", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        return int(ended.value.code or 0), out, err

    return call


def containers(shared_data: Path) -> Path:
    return shared_data / "containers"


def test_a_raw_picture(info, shared_data) -> None:
    path = shared_data / "f01" / "IMG_1.lfp"
    code, out, err = info(path)
    assert (code, err) == (0, "")
    assert "BGGR" in out
    assert out.count("right") == 4
    code, out, _ = info(path, "--json")
    described = json.loads(out)
    assert described["sizes"] == {"y": 3280, "x": 3280}
    assert described["bits"] == 12
    assert described["metadata"]["temperature"] is None
    assert [section["offset"] for section in described["sections"]] == [16, 512, 16138208, 16139824]


def test_a_flipped_bit(info, shared_data, tmp_path) -> None:
    path = tmp_path / "a.lfp"
    data = bytearray((containers(shared_data) / "behnam_IMG_0002-dm.lfp").read_bytes())
    data[2000] ^= 1
    path.write_bytes(data)
    code, out, err = info(path)
    assert code == 1
    assert "wrong" in out
    assert "section at byte 1392 (depthMap.imageRef): wrong SHA-1" in err
    assert info(path, "--accept-damaged")[0] == 0


def test_a_cut_picture_ends_in_a_message(info, shared_data) -> None:
    code, out, err = info(containers(shared_data) / "exiftool_Lytro_truncated.lfp")
    assert (code, out) == (1, "")
    assert "imageRef" in err
    assert "Traceback" not in err


def test_a_folder_is_a_table(info, shared_data) -> None:
    code, out, _ = info(containers(shared_data))
    assert code == 2  # one of the pictures is cut
    assert [line.split()[0] for line in out.splitlines()[1:4]] == [
        "behnam_IMG_0001-stk.lfp", "behnam_IMG_0002-dm.lfp", "bkerley_illum_demo.LFP",
    ]  # fmt: skip
    rows = json.loads(info(containers(shared_data), "--json")[1])
    assert [row["kind"] for row in rows] == ["derived picture"] * 3 + ["broken"] + ["metadata without its picture"] * 2


def test_other_kinds(info, tmp_path) -> None:
    write_views(tmp_path / "views", LIGHT_FIELD)
    write_eslf(tmp_path / "a_eslf.png", LIGHT_FIELD)
    write_png(tmp_path / "b.png", np.zeros((2, 3), np.uint8))
    write_toolbox(tmp_path / "c.mat", LIGHT_FIELD)
    write_pfm(tmp_path / "d.pfm", np.zeros((2, 3)))
    write_storage(tmp_path / "data.C.0", {"C:\\MOD_0000.RAW": b"short"})
    rows = {Path(row["path"]).name: row for row in json.loads(info(tmp_path, "--json")[1])}
    assert {name: row["kind"] for name, row in rows.items()} == {
        "views": "folder of views", "a_eslf.png": "lenslet picture", "b.png": "picture",
        "c.mat": "LFToolbox light field", "d.pfm": "float map", "data.C.0": "calibration archive",
    }  # fmt: skip
    assert rows["a_eslf.png"]["sizes"]["u"] == 3
    assert "MOD_0000.TXT" in info(tmp_path / "data.C.0")[1]


def test_nothing_there(info, tmp_path) -> None:
    code, _, err = info(tmp_path / "none.lfp")
    assert code == 1
    assert "No such file" in err
    (tmp_path / "empty.lfp").touch()
    assert "empty file" in info(tmp_path / "empty.lfp")[2]
    shutil.rmtree(tmp_path)
