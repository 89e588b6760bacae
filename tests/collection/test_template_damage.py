import json

from hypothesis import given
from hypothesis import strategies as st

from lfflow.collection.template import differences, is_shorter, looks_rotten

NODE = json.dumps(
    {"shape": [3, 4], "dimension_names": ["capture", "t"], "node_type": "array", "zarr_format": 3}
).encode()


def test_a_different_number_of_captures_is_no_difference() -> None:
    grown = NODE.replace(b"[3, 4]", b"[5, 4]")
    assert differences(grown, NODE) == []
    assert is_shorter(NODE, grown)
    assert not is_shorter(grown, NODE)


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
    is_shorter(bytes(damaged), NODE)


def test_damage_is_told_from_intent_also_behind_a_history() -> None:
    group = {"attributes": {"Conventions": "CF-1.11", "title": "where the lenses are"}, "node_type": "group"}
    written = {**group, "attributes": {**group["attributes"], "history": "2026-01-01 made"}}
    found, wanted = json.dumps(written).encode(), json.dumps(group).encode()
    assert differences(found, wanted) == []
    assert looks_rotten(found.replace(b"Conventions", b"Conven|ions"), wanted)
    assert not looks_rotten(found.replace(b"CF-1.11", b"my own convention"), wanted)
