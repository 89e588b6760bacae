"""Whatever happens to the files between scans, the catalogue is what a fresh scan would make of them."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny_captures import open_text, touch_later, write_text

from lfflow.collection import Collection, catalogue
from lfflow.collection.update import update

PLACES = [f"{folder}{stem}.lfp" for folder in ("", "a/", "b/c/") for stem in ("IMG_1", "IMG_2", "W")]
CONTENTS = ["scene 1", "scene 22", "white 3", "broken 4"]
place = st.sampled_from(PLACES)
steps = st.lists(
    st.one_of(
        st.tuples(st.just("write"), place, st.sampled_from(CONTENTS)),
        st.tuples(st.just("move"), place, place),
        st.tuples(st.just("copy"), place, place),
        st.tuples(st.just("remove"), place, st.none()),
        st.tuples(st.just("touch"), place, st.none()),
        st.tuples(st.just("scan"), st.none(), st.none()),
        st.tuples(st.just("lose"), st.none(), st.none()),
    ),
    max_size=16,
)


class Folder:
    """Files on the disk; every write gets a later time, so that nothing rests on the clock's resolution."""

    def __init__(self, root: Path) -> None:
        self.root, self.clock = root, 0

    def apply(self, action: str, path: str, other: str | None) -> None:
        source, target = self.root / path, self.root / (other or "")
        if action == "write":
            write_text(source, *other.split())
        elif not source.exists() or source == target:
            return
        elif action == "remove":
            source.unlink()
        elif action in ("move", "copy"):
            target.parent.mkdir(parents=True, exist_ok=True)
            (shutil.move if action == "move" else shutil.copyfile)(source, target)
        changed = target if action in ("move", "copy") else source
        self.clock += 10
        if changed.exists() and action != "move":
            touch_later(changed, self.clock)


def scan(out: Path, root: Path) -> pd.DataFrame:
    collection = Collection(out)
    catalogue.save(collection.storage, update(collection, open_text, [root]))
    return collection.catalogue_rows()


def by_path(table: pd.DataFrame) -> pd.DataFrame:
    """What the catalogue says of every file, without the ids, which keep their history."""
    facts = [name for name in table.columns if name not in ("id", "duplicate_of")]
    return table[facts].sort_values("path", ignore_index=True)


def check_ids(before: pd.DataFrame, after: pd.DataFrame) -> None:
    assert after["id"].is_unique
    assert (after["id"] != "").all()
    kept = before.merge(after, on="path", suffixes=("", "_now"))
    moved = set(before["sha256"]) - {""}
    # A path keeps its id unless its capture went elsewhere or another came to it.
    same = kept[
        (kept["sha256"] == kept["sha256_now"]) & (kept["duplicate_of"] == "") & (kept["duplicate_of_now"] == "")
    ]
    assert (same["id"] == same["id_now"]).all(), moved


def check_duplicates(table: pd.DataFrame) -> None:
    for content, rows in table[table["sha256"] != ""].groupby("sha256"):
        originals = rows[rows["duplicate_of"] == ""]
        assert len(originals) == 1, content
        assert set(rows["duplicate_of"]) <= {"", originals["id"].item()}


@settings(max_examples=40, deadline=None)
@given(steps)
def test_any_history_gives_the_catalogue_of_a_fresh_scan(history):
    with tempfile.TemporaryDirectory() as name:
        root, out = Path(name) / "in", Path(name) / "col"
        root.mkdir()
        folder = Folder(root)
        table = scan(out, root)
        for action, path, other in [*history, ("scan", None, None)]:
            if action == "lose":
                (out / catalogue.FILE).unlink(missing_ok=True)
            elif action == "scan":
                before, table = table, scan(out, root)
                pd.testing.assert_frame_equal(by_path(table), by_path(scan(Path(name) / "fresh", root)))
                shutil.rmtree(Path(name) / "fresh")
                check_duplicates(table)
                if all(step[0] != "lose" for step in history):
                    check_ids(before, table)
                pd.testing.assert_frame_equal(table, scan(out, root))
            else:
                folder.apply(action, path, other)


@settings(max_examples=10, deadline=None)
@given(st.permutations(PLACES), st.integers(1, 4))
def test_the_order_in_which_files_come_changes_no_fact(places, groups):
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "in"
        for number, group in enumerate(np.array_split(places, groups)):
            for path in group:
                write_text(root / str(path), text=str(path))
            touch_later(root / str(group[0]), number)
            table = scan(Path(name) / "col", root)
        pd.testing.assert_frame_equal(by_path(table), by_path(scan(Path(name) / "fresh", root)))
