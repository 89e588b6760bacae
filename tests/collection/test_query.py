"""Expressions over the catalogue: what they find, what they say when they are wrong, and that they run no code."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfflow.collection.catalogue import frame
from lfflow.collection.query import select
from lfflow.errors import CollectionError

TABLE = frame([
    {"id": "IMG_1", "kind": "scene", "iso": 100.0, "focus_step": 600.0, "time": np.datetime64("2012-08-15T04:00:00")},
    {"id": "IMG_2", "kind": "scene", "iso": 200.0, "focus_step": 700.0, "time": np.datetime64("2013-01-01T00:00:00")},
    {"id": "IMG_3", "kind": "scene", "focus_step": 800.0, "reason": "cut short"},
    {"id": "W_1", "kind": "white", "iso": 80.0, "focus_step": 400.0, "missing": True},
])  # fmt: skip


def found(expression: str) -> list[str]:
    return list(select(TABLE, expression)["id"])


@pytest.mark.parametrize(
    ("expression", "ids"),
    [
        ("", ["IMG_1", "IMG_2", "IMG_3", "W_1"]),
        ("iso < 200 and focus_step > 500", ["IMG_1"]),
        ("iso < 200 & focus_step > 500", ["IMG_1"]),
        ("not (iso < 200)", ["IMG_2", "IMG_3"]),
        ("100 <= iso <= 200", ["IMG_1", "IMG_2"]),
        ("kind in ['white', 'dark'] or iso == 200", ["IMG_2", "W_1"]),
        ("kind not in ('scene',)", ["W_1"]),
        ("iso.isna() and reason != ''", ["IMG_3"]),
        ("id.str.contains('MG_[12]')", ["IMG_1", "IMG_2"]),
        ("id.str.lower().str.startswith('w')", ["W_1"]),
        ("time >= '2013-01-01'", ["IMG_2"]),
        ("time.dt.year == 2012", ["IMG_1"]),
        ("iso.between(90, 150) and not missing", ["IMG_1"]),
        ("focus_step - iso > 500 or missing", ["W_1"]),
        ("  missing ", ["W_1"]),
        ("iso / 2 + 1 < 50", ["W_1"]),
    ],
)
def test_what_holds_is_found(expression, ids):
    assert found(expression) == ids


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("is0 < 200", "no column is0; did you mean iso?"),
        ("disparity_stat == 'done'", "no column disparity_stat"),
        ("focusstep > 3", "did you mean focus_step"),
        ("xyzzy > 1", "there are id, path"),
        ("iso = 200", "write == to compare"),
        ("iso <", "cannot read 'iso <'"),
        ("iso", "is no condition"),
        ("iso + 1", "is no condition"),
        ("iso < 'a'", "cannot evaluate"),
        ("id.str.contains('[')", "cannot evaluate"),
        ("5 < 6", "is no condition"),
    ],
)
def test_what_is_wrong_is_said(expression, message):
    with pytest.raises(CollectionError) as caught:
        select(TABLE, expression)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "expression",
    [
        "@pd.io.common.os.system('touch {mark}')",
        "__import__('os').system('touch {mark}')",
        "id.__class__.__mro__",
        "id.to_csv('{mark}')",
        "id.str.__init__.__globals__",
        "id.map(print)",
        "id.apply('to_csv')",
        "iso.pipe(id.to_pickle, '{mark}')",
        "[open('{mark}', 'w') for _ in [1]]",
        "(lambda: 1)()",
        "open('{mark}', 'w')",
        "iso := 3",
        "f'{{id}}'",
        "iso[0] > 1",
        "id.str.cat.__self__",
        "path.values.tofile('{mark}')",
        "kind.dt.tz_localize('{mark}')",
        "x = 1",
        "iso = 3\nkind == 'scene'",
        "9**9**9 < iso.abs().to_pickle('{mark}')",
        "9**9**9**9 > iso",
        "1 << 99999999999 > iso",
    ],
)
def test_nothing_is_run_by_an_expression(expression, tmp_path):
    mark = tmp_path / "mark"
    before = TABLE.copy()
    with pytest.raises(CollectionError):
        select(TABLE, expression.replace("{mark}", str(mark)))
    assert not mark.exists()
    assert TABLE.equals(before)


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet="iso<>=&|()@_. '\"1[]{}:,!+-~\nlambda", max_size=30))
def test_any_text_selects_or_is_refused(text):
    with contextlib.suppress(CollectionError):
        assert set(select(TABLE, text)["id"]) <= set(TABLE["id"])
