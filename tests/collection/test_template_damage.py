import json
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfflow.collection.template import build, differences, has_other_length, looks_rotten
from lfflow.schema import LIGHTFIELD

NODE = json.dumps(
    {"shape": [3, 4], "dimension_names": ["capture", "t"], "node_type": "array", "zarr_format": 3}
).encode()


def test_a_different_number_of_captures_is_no_difference() -> None:
    grown = NODE.replace(b"[3, 4]", b"[5, 4]")
    assert differences(grown, NODE) == []
    assert has_other_length(NODE, grown)
    assert has_other_length(grown, NODE)
    assert not has_other_length(NODE, NODE)


@given(st.integers(0, 8 * len(NODE) - 1))
def test_a_flipped_bit_in_the_metadata_of_an_array_is_a_difference_and_no_crash(bit: int) -> None:
    damaged = bytearray(NODE)
    damaged[bit // 8] ^= 1 << bit % 8
    found = differences(bytes(damaged), NODE)
    try:
        document = json.loads(damaged)
    except ValueError:
        assert found
        return
    if document.get("shape", [None])[0] == 3 and document != json.loads(NODE):
        assert found
    has_other_length(bytes(damaged), NODE)


def flips(data: bytes) -> Iterator[bytes]:
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        yield bytes(damaged)


SIZES = {"v": 3, "u": 3, "t": 5, "s": 7}
HISTORY = ["lfflow 0.1.0: lightfield {}", "lfflow 0.1.0: lightfield {'lightfield': {'power': [1, 2]}}"]


@pytest.mark.parametrize("key", ["zarr.json", "F01/zarr.json", "F01/mosaic/zarr.json"])
def test_every_flipped_bit_in_metadata_is_seen_and_taken_for_damage(key: str) -> None:
    """Except where it changes nothing that is said, or only the history, which every run writes anew."""
    found = build(LIGHTFIELD, "F01", SIZES, ["A", "B"], {}, HISTORY, values=False)[key]
    wanted = build(LIGHTFIELD, "F01", SIZES, ["A", "B"], {}, values=False)[key]
    assert differences(found, wanted) == []
    for damaged in flips(found):
        if differences(damaged, wanted):
            assert looks_rotten(damaged, wanted), damaged
        elif not has_other_length(damaged, wanted):
            assert without_history(damaged) == without_history(found)


def without_history(data: bytes) -> object:
    document = json.loads(data)
    document.get("attributes", {}).pop("history", None)
    return document


def test_damage_is_told_from_intent_also_behind_a_history() -> None:
    group = {
        "attributes": {"Conventions": "CF-1.11", "title": "where the lenses are", "history": []},
        "node_type": "group",
    }
    written = {**group, "attributes": {**group["attributes"], "history": ["2026-01-01 made"]}}
    found, wanted = json.dumps(written).encode(), json.dumps(group).encode()
    assert differences(found, wanted) == []
    assert looks_rotten(found.replace(b"Conventions", b"Conven|ions"), wanted)
    assert not looks_rotten(found.replace(b"CF-1.11", b"my own convention"), wanted)
