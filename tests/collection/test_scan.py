"""What a scan makes of the files it meets: one row each, ids that last, nothing read twice."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from tiny_captures import open_text, touch_later, write_text

from lfflow.collection import Collection, catalogue, open_collection
from lfflow.collection.inputs import find_files
from lfflow.collection.update import update
from lfflow.errors import CollectionError

Scan = Callable[..., pd.DataFrame]


@pytest.fixture
def read_paths(monkeypatch) -> list[str]:
    return []


@pytest.fixture
def rescan(tmp_path, read_paths) -> Scan:
    """Scan into one collection, by id; `read_paths` lists what was opened."""

    def open_raw(path):
        read_paths.append(path)
        return open_text(path)

    def go(*inputs, out=tmp_path / "col", **options):
        collection = Collection(out)
        table = update(collection, open_raw, inputs, **options)
        catalogue.save(collection.storage, table)
        return open_collection(out).catalogue_rows().set_index("id", drop=False)

    return go


def names(paths):
    return [Path(path).name for path in paths]


def test_folders_are_walked_and_globs_expanded(tmp_path):
    for name in ("a/IMG_1.lfp", "a/b/IMG_2.LFR", "a/b/c/MOD_1.RAW", "a/notes.txt", "IMG_3.lfp"):
        write_text(tmp_path / name)
    assert names(find_files([tmp_path])) == ["IMG_3.lfp", "IMG_1.lfp", "IMG_2.LFR", "MOD_1.RAW"]
    assert names(find_files([f"{tmp_path}/**/IMG_*.lfp"])) == ["IMG_3.lfp", "IMG_1.lfp"]
    assert names(find_files([f"{tmp_path}/a/*"])) == ["IMG_1.lfp", "IMG_2.LFR", "MOD_1.RAW"]
    assert names(find_files([tmp_path / "a/notes.txt"])) == ["notes.txt"], "a file that is named is taken"
    with pytest.raises(CollectionError, match=r"no such input: .*nothing\*\.lfp"):
        find_files([f"{tmp_path}/nothing*.lfp"])


def test_a_name_with_the_letters_of_a_pattern_is_a_name(tmp_path):
    path = write_text(tmp_path / "IMG [1]*.lfp")
    assert find_files([path]) == [str(path)]


def test_hidden_files_stores_and_other_collections_are_passed_over(tmp_path):
    for name in ("._IMG_1.lfp", ".trash/IMG_2.lfp", "x.zarr/zarr.json", "x.zarr/IMG_4.lfp", "col/catalogue.parquet",
                 "col/IMG_5.lfp", "IMG_3.lfp"):  # fmt: skip
        write_text(tmp_path / name)
    assert names(find_files([tmp_path])) == ["IMG_3.lfp"]


def test_loops_of_links_end_and_a_folder_is_known_by_its_own_name(tmp_path):
    write_text(tmp_path / "in/real/IMG_1.lfp")
    (tmp_path / "in/a_link").symlink_to(tmp_path / "in/real")
    (tmp_path / "in/real/up").symlink_to(tmp_path / "in")
    (tmp_path / "in/self").symlink_to("self")
    assert find_files([tmp_path / "in"]) == [str(tmp_path / "in/real/IMG_1.lfp")]


def test_links_to_nowhere_pipes_and_forbidden_files_are_rows_with_a_reason(tmp_path, rescan):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/GONE.lfp").symlink_to("nowhere")
    os.mkfifo(tmp_path / "in/PIPE.lfp")
    write_text(tmp_path / "in/BAD.lfp", "broken", "rubbish")
    table = rescan(tmp_path / "in", tmp_path / "in/PIPE.lfp")
    assert table["reason"].to_dict() == {
        "GONE": "cannot be read: No such file or directory",
        "PIPE": "cannot be read: it is no regular file",
        "BAD": "found 'rubbish', expected a capture",
    }


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission_is_tried_again(tmp_path, rescan):
    path = write_text(tmp_path / "in/A.lfp")
    path.chmod(0)
    assert rescan(tmp_path / "in").loc["A", "reason"] == "cannot be read: Permission denied"
    path.chmod(0o600)
    assert rescan(tmp_path / "in").loc["A", "reason"] == ""


def test_odd_names_give_ids_that_can_be_typed_and_stored(tmp_path, rescan):
    odd = ["été 2013.lfp", "e\u0301te\u0301 2013.lfp", "花" * 70 + ".lfp", "a\nb.lfp", "back\\slash.lfp", "a::b.lfp"]
    for number, name in enumerate(odd):
        write_text(tmp_path / "in" / name, text=str(number))
    (tmp_path / "in" / os.fsdecode(b"latin-\xe9.lfp")).write_text("scene 9")
    write_text(tmp_path / ".hidden.lfp", text="hidden")
    table = rescan(tmp_path / "in", tmp_path / ".hidden.lfp")
    ids = list(table["id"])
    assert "été 2013" in ids
    assert sum(name.startswith("été 2013-") for name in ids) == 1, "the same letters, composed otherwise"
    assert {"a_b", "slash", "a::b", "_hidden"} <= set(ids)
    assert all(name.isprintable() and len(name.encode()) < 200 for name in ids)
    assert table.loc[table["path"].str.contains("latin"), "reason"].item().startswith("its name is no text in UTF-8")
    assert (table["reason"] != "").sum() == 1
    assert list(rescan(tmp_path / "in")["id"]) == ids


def test_what_is_unchanged_is_not_read_again(tmp_path, rescan, read_paths):
    paths = [write_text(tmp_path / f"in/IMG_{n}.lfp", text=str(n)) for n in range(3)]
    write_text(tmp_path / "in/BAD.lfp", "broken")
    first = rescan(tmp_path / "in")
    assert len(read_paths) == 4
    touch_later(paths[0])
    second = rescan(tmp_path / "in")
    assert len(read_paths) == 4, "another time, the same sha256"
    pd.testing.assert_frame_equal(first.drop(columns="mtime_ns"), second.drop(columns="mtime_ns"))
    write_text(paths[1], text="changed")
    assert rescan(tmp_path / "in").loc["IMG_1", "iso"] == 7
    assert len(read_paths) == 5
    rescan(tmp_path / "in", again=True)
    assert names(read_paths[5:]) == ["BAD.lfp"]


def test_a_new_scan_looks_after_all_files_that_are_known(tmp_path, rescan):
    old = write_text(tmp_path / "one/A.lfp", text="1")
    rescan(tmp_path / "one")
    write_text(old, text="longer")
    write_text(tmp_path / "one/NOT_ASKED_FOR.lfp")
    table = rescan(write_text(tmp_path / "two/B.lfp", text="22"))
    assert table["iso"].to_dict() == {"A": 6, "B": 2}


def test_ids_of_one_stem_differ_and_last_whatever_comes_later(tmp_path, rescan):
    write_text(tmp_path / "m/IMG_1.lfp", text="m")
    first = rescan(tmp_path / "m")["path"].to_dict()
    for folder in ("a", "z"):
        write_text(tmp_path / folder / "IMG_1.lfp", text=folder)
    later = rescan(tmp_path)["path"].to_dict()
    assert first.items() <= later.items()
    assert len(later) == 3
    suffixed = {path: name for name, path in later.items() if name != "IMG_1"}
    # The suffix comes from the content: another machine with another path gives the same.
    other = rescan(tmp_path / "m", tmp_path, out=tmp_path / "other")
    for path, name in suffixed.items():
        if name in other.index:
            assert other.loc[name, "path"] == path
    assert set(other["id"]) & set(suffixed.values())


def test_equal_files_are_one_capture(tmp_path, rescan, read_paths):
    for name in ("B.lfp", "sub/B.lfp", "C.lfp"):
        write_text(tmp_path / "in" / name, text="same")
    table = rescan(tmp_path / "in")
    assert sorted(table["duplicate_of"]) == ["", "B", "B"]
    write_text(tmp_path / "in/A.lfp", text="same")
    assert rescan(tmp_path / "in").loc["A", "duplicate_of"] == "B", "who was first stays the original"


def test_a_renamed_file_is_the_same_capture(tmp_path, rescan, read_paths):
    path = write_text(tmp_path / "in/IMG_1.lfp", text="it")
    rescan(white=[path])
    path.rename(tmp_path / "in/flower.lfp")
    table = rescan(tmp_path / "in")
    assert table["path"].to_dict() == {"IMG_1": str(tmp_path / "in/flower.lfp")}
    assert table.loc["IMG_1", ["kind", "judged_by"]].tolist() == ["white", "told"]


def test_the_copy_takes_the_place_of_an_original_that_was_removed(tmp_path, rescan):
    original = write_text(tmp_path / "in/A.lfp", text="same")
    write_text(tmp_path / "in/B.lfp", text="same")
    rescan(tmp_path / "in")
    original.unlink()
    table = rescan(tmp_path / "in")
    assert table["path"].to_dict() == {"A": str(tmp_path / "in/B.lfp")}
    assert table.loc["A", "duplicate_of"] == ""


def test_removed_files_leave_unless_they_have_results_or_their_folder_is_out_of_reach(tmp_path, rescan, monkeypatch):
    for name in ("in/A", "in/B", "drive/C"):
        write_text(tmp_path / f"{name}.lfp", text=name)
    rescan(tmp_path / "in", tmp_path / "drive")
    monkeypatch.setattr("lfflow.collection.update.finished", lambda _: {"B"})
    (tmp_path / "in/A.lfp").unlink()
    (tmp_path / "in/B.lfp").unlink()
    (tmp_path / "drive").rename(tmp_path / "unplugged")
    table = rescan(tmp_path / "in")
    assert table["missing"].to_dict() == {"B": True, "C": True}
    assert table.loc["B", ["kind", "reason"]].tolist() == ["scene", ""], "its metadata are kept"
    (tmp_path / "unplugged").rename(tmp_path / "drive")
    assert rescan()["missing"].to_dict() == {"B": True, "C": False}


def test_what_was_told_lasts_and_can_be_told_otherwise(tmp_path, rescan):
    path = write_text(tmp_path / "in/A.lfp")
    rescan(tmp_path / "in", white=[path])
    assert rescan(tmp_path / "in").loc["A", ["kind", "judged_by"]].tolist() == ["white", "told"]
    assert rescan(tmp_path / "in", dark=[path]).loc["A", "kind"] == "dark"


@pytest.mark.parametrize("damage", ["bytes", "gone", "seal"])
def test_a_damaged_catalogue_is_made_anew_from_what_was_asked_for(tmp_path, rescan, damage):
    for name in ("in/A", "in/B", "more/A"):
        write_text(tmp_path / f"{name}.lfp", text=name)
    rescan(tmp_path / "in")
    before = rescan(tmp_path / "more", white=[tmp_path / "in/B.lfp"])
    file = tmp_path / "col" / catalogue.FILE
    if damage == "bytes":
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        file.write_bytes(data)
    elif damage == "gone":
        file.unlink()
    else:
        (tmp_path / "col/catalogue.sha256.json").write_text("[]")
    if damage != "gone":
        with pytest.raises(catalogue.DamagedCatalogueError):
            open_collection(tmp_path / "col").catalogue_rows()
    pd.testing.assert_frame_equal(rescan(), before)
