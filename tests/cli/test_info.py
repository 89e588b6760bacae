"""`lfflow info`: every kind of file, as text and as JSON; broken ones end in a message."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from broken_examples import BROKEN, picture
from format_examples import PRIVATE, metadata_of

from lfflow.cli import main
from lfflow.formats.archives import write_storage
from lfflow.formats.describe import NO_CHECKSUM
from lfflow.formats.eslf import write_eslf
from lfflow.formats.pfm import write_pfm
from lfflow.formats.png import write_png
from lfflow.formats.raw_pair import write_pair
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
    listed = info(tmp_path / "data.C.0")[1]
    assert "found no metadata beside it, expected MOD_0000.TXT" in listed
    assert "C:\\MOD_0000.RAW" in listed
    assert "1 unreadable" in info(tmp_path)[1]


def test_nothing_there(info, tmp_path) -> None:
    code, _, err = info(tmp_path / "none.lfp")
    assert code == 1
    assert "No such file" in err
    (tmp_path / "empty.lfp").touch()
    assert "empty file" in info(tmp_path / "empty.lfp")[2]
    shutil.rmtree(tmp_path)


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_one_line(info, tmp_path, name) -> None:
    make, _, parts = BROKEN[name]
    code, out, err = info(make(tmp_path))
    assert code == 1
    assert err.count("\n") == 1
    assert err.startswith("lfflow: ")
    assert "Traceback" not in out + err
    if name.startswith("a flipped bit in the metadata"):
        return
    for part in parts:
        assert part in err


def test_the_command_itself_says_one_line(tmp_path) -> None:
    """In a process of its own, where libraries could speak on standard error."""
    for name in ("a view with a flipped bit", "a PNG bomb", "cut in the image"):
        (tmp_path / name).mkdir()
        path = BROKEN[name][0](tmp_path / name)
        done = subprocess.run(
            [sys.executable, "-m", "lfflow", "info", path], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.count("\n") == 1


def test_damage_is_accepted_and_recorded(info, tmp_path) -> None:
    path = tmp_path / "a.lfp"
    data = bytearray(picture(path))
    data[-30] ^= 1
    path.write_bytes(data)
    code, _, err = info(path)
    assert code == 1
    assert "frame.imageRef): wrong SHA-1" in err
    code, out, err = info(path, "--accept-damaged", "--json")
    assert (code, err) == (0, "")
    described = json.loads(out)
    assert "wrong SHA-1" in described["damaged"][0]
    assert [section["state"] for section in described["sections"]] == ["right", "right", "right", "wrong"]
    path.write_bytes(picture(path) + b"rubbish behind it")
    assert info(path)[0] == 1
    code, out, _ = info(path, "--accept-damaged")
    assert code == 0
    assert "bytes 72 75 62 62" in out


def test_a_folder_of_strangers(info, tmp_path) -> None:
    kept = {name: make for name, (make, *_) in BROKEN.items() if name in ("empty", "cut in the image", "a JPEG")}
    for number, make in enumerate(kept.values()):
        (tmp_path / f"x{number}").mkdir()
        make(tmp_path / f"x{number}").rename(tmp_path / f"{number}.lfp")
    picture(tmp_path / "good.lfp")
    code, out, err = info(tmp_path)
    assert (code, err) == (2, "")
    kinds = {row["path"].split("/")[-1]: row["kind"] for row in json.loads(info(tmp_path, "--json")[1])}
    assert kinds == {
        "0.lfp": "unknown", "1.lfp": "unknown", "2.lfp": "broken", "good.lfp": "raw picture", "x0": "folder",
        "x1": "folder", "x2": "folder",
    }  # fmt: skip
    assert len({line.index("kind") for line in out.splitlines()[:1]}) == 1


def test_what_tells_damage(info, tmp_path) -> None:
    picture(tmp_path / "a.lfp")
    write_png(tmp_path / "b.png", np.zeros((2, 3), np.uint8))
    write_pfm(tmp_path / "c.pfm", np.zeros((2, 3)))
    write_pair(tmp_path / "MOD_0001.RAW", np.zeros((4, 6), np.uint16), metadata_of("f01", 4, 6), PRIVATE)
    rows = json.loads(info(tmp_path, "--json")[1])
    assert {row["path"].split("/")[-1]: row["checksum"] for row in rows} == {
        "a.lfp": "SHA-1", "b.png": "CRC-32", "c.pfm": NO_CHECKSUM, "MOD_0001.RAW": NO_CHECKSUM,
    }  # fmt: skip
