"""Archives as inputs: each entry is a capture, judged by its content where the camera has not tagged it."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import numpy as np
import pytest
from tiny_captures import frame_of, lens_pattern, metadata_of

from lfflow.collection import Collection, catalogue
from lfflow.collection.update import update
from lfflow.formats.archives import write_storage
from lfflow.formats.lfp import write_lfp
from lfflow.formats.raw_pair import pair_bytes, write_pair
from lfflow.run.chain import open_damaged_lfp, open_lfp

SIZE = 640
LENSES = lens_pattern(SIZE, SIZE)
X, Y = np.meshgrid(np.linspace(-1, 1, SIZE), np.linspace(-1, 1, SIZE))
LIGHT = {"dark": 0 * LENSES, "white": 0.6 * LENSES * (1 - 0.3 * (X**2 + Y**2)), "scene": 0.5 * LENSES * (X > 0.1)}


@pytest.fixture(autouse=True)
def folder_of_inputs(tmp_path):
    (tmp_path / "in").mkdir()


def picture(kind: str, seed: int = 0, *, tagged: bool = False, zoom: float = 981.0) -> tuple[bytes, bytes]:
    """Samples and text as an F01 writes them; without tags the text does not say what it is."""
    metadata, private = metadata_of("f01", SIZE, SIZE, zoom_step=zoom)
    tags = {"white": tagged and kind == "white", "dark": tagged and kind == "dark"}
    return pair_bytes(frame_of(LIGHT[kind], seed), metadata, private, **tags)


def files_of(kinds: list[str], *, tagged: bool = False) -> dict[str, bytes]:
    files = {"C:\\T1CALIB\\MLACALIBRATION.TXT": b"{}"}
    for number, kind in enumerate(kinds):
        raw, text = picture(kind, number, tagged=tagged)
        files |= {f"C:\\T1CALIB\\MOD_{number:04d}.RAW": raw, f"C:\\T1CALIB\\MOD_{number:04d}.TXT": text}
    return files


def scanned(out: Path, *inputs: Path, damaged: bool = False):
    collection = Collection(out)
    table = update(collection, open_damaged_lfp if damaged else open_lfp, inputs)
    catalogue.save(collection.storage, table)
    return table.set_index("id", drop=False)


@pytest.mark.parametrize("tagged", [True, False])
def test_every_picture_of_a_storage_container_is_a_row(tmp_path, tagged):
    write_storage(tmp_path / "in/data.C.0", files_of(["dark", "white", "white"], tagged=tagged))
    table = scanned(tmp_path / "col", tmp_path / "in")
    assert table["kind"].to_dict() == {"MOD_0000": "dark", "MOD_0001": "white", "MOD_0002": "white"}
    assert set(table["judged_by"]) == {"camera" if tagged else "content"}
    assert table.loc["MOD_0001", "path"] == f"{tmp_path}/in/data.C.0::MOD_0001.RAW"
    assert table.loc["MOD_0001", "camera_serial"] != ""


def test_a_tar_is_walked_as_a_storage_container_is(tmp_path):
    with tarfile.open(tmp_path / "in/caldata-B1.tar", "w") as tar:
        for name, data in files_of(["dark", "white"]).items():
            member = tarfile.TarInfo(name.rpartition("\\")[2])
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    assert list(scanned(tmp_path / "col", tmp_path / "in")["kind"]) == ["dark", "white"]


def test_an_entry_that_was_extracted_is_its_duplicate(tmp_path):
    write_storage(tmp_path / "in/data.C.0", files_of(["white"]))
    raw, text = picture("white", 0)
    (tmp_path / "in/MOD_0000.RAW").write_bytes(raw)
    (tmp_path / "in/MOD_0000.TXT").write_bytes(text)
    table = scanned(tmp_path / "col", tmp_path / "in")
    assert len(table) == 2
    assert sorted(table["duplicate_of"]) == ["", "MOD_0000"]


def test_the_text_beside_the_samples_counts(tmp_path):
    metadata, private = metadata_of("f01", SIZE, SIZE)
    frame = frame_of(LIGHT["white"])
    write_pair(tmp_path / "in/MOD_0001.RAW", frame, metadata, private, white=True)
    first = scanned(tmp_path / "col", tmp_path / "in/MOD_0001.TXT")
    metadata["devices"]["lens"]["zoomStep"] = 7
    write_pair(tmp_path / "in/MOD_0001.RAW", frame, metadata, private, white=True)
    second = scanned(tmp_path / "col")
    assert second["zoom_step"].tolist() == [7.0]
    assert first["sha256"].tolist() != second["sha256"].tolist()


def test_a_changed_archive_is_read_again_entry_by_entry(tmp_path):
    write_storage(tmp_path / "in/data.C.0", files_of(["dark", "white"]))
    before = scanned(tmp_path / "col", tmp_path / "in")
    files = files_of(["dark", "scene", "white"])
    del files["C:\\T1CALIB\\MOD_0000.RAW"]
    write_storage(tmp_path / "in/data.C.0", files)
    after = scanned(tmp_path / "col", tmp_path / "in")
    assert after["kind"].to_dict() == {"MOD_0001": "scene", "MOD_0002": "white"}
    assert before.loc["MOD_0001", "sha256"] != after.loc["MOD_0001", "sha256"]


def test_a_broken_entry_and_a_broken_archive_are_rows_with_a_reason(tmp_path):
    write_storage(tmp_path / "in/data.C.0", files_of(["dark", "white"]))
    data = (tmp_path / "in/data.C.0").read_bytes()
    (tmp_path / "in/data.C.1").write_bytes(data[: len(data) // 3])
    broken = files_of(["white", "white"])
    broken["C:\\T1CALIB\\MOD_0001.RAW"] = broken["C:\\T1CALIB\\MOD_0001.RAW"][:-100]
    write_storage(tmp_path / "in/data.C.2", broken)
    table = scanned(tmp_path / "col", tmp_path / "in")
    reasons = {Path(row["path"]).name: row["reason"] for _, row in table.iterrows() if row["reason"]}
    assert set(reasons) == {"data.C.1", "data.C.2::MOD_0001.RAW"}
    assert "bytes" in reasons["data.C.1"]
    assert "expected 614400 bytes" in reasons["data.C.2::MOD_0001.RAW"]


def test_a_white_image_by_a_strangers_name_is_found_among_scenes(tmp_path):
    metadata, private = metadata_of("f01", SIZE, SIZE)
    for number, kind in enumerate(["scene", "white", "dark"]):
        write_lfp(tmp_path / f"in/IMG_{number:04d}.lfp", frame_of(LIGHT[kind]), metadata, private)
    table = scanned(tmp_path / "col", tmp_path / "in")
    assert table["kind"].tolist() == ["scene", "white", "dark"]
    assert set(table["judged_by"]) == {"content"}


def test_damaged_samples_are_a_reason_unless_accepted(tmp_path):
    metadata, private = metadata_of("f01", SIZE, SIZE)
    path = tmp_path / "in/IMG_1.lfp"
    write_lfp(path, frame_of(LIGHT["scene"]), metadata, private)
    data = bytearray(path.read_bytes())
    data[-1000] ^= 255
    path.write_bytes(data)
    assert "SHA-1" in scanned(tmp_path / "col", path).loc["IMG_1", "reason"]
    assert scanned(tmp_path / "other", path, damaged=True).loc["IMG_1", "reason"] == ""


def test_a_derived_picture_says_that_it_is_no_raw_one(tmp_path, shared_data):
    table = scanned(tmp_path / "col", shared_data / "containers")
    assert (table["reason"] != "").all()
    stack = table[table["path"].str.endswith("-stk.lfp")]["reason"].item()
    assert stack.startswith("found a derived picture")
