"""A short run of the fuzzer (the long one is ``make fuzz``), and bombs made by hand."""

from __future__ import annotations

import json
import tracemalloc

import numpy as np
import pytest
from format_examples import PRIVATE, metadata_of
from fuzz_formats import run

from lfflow.formats.bounded_json import MAX_JSON_BYTES
from lfflow.formats.container import write_container
from lfflow.formats.errors import FileFormatError, LimitError
from lfflow.formats.lfp import open_lfp, write_lfp
from lfflow.formats.opening import open_picture
from lfflow.formats.views import open_views


def test_mutants_end_in_success_or_format_error(tmp_path) -> None:
    outcomes = run(iter(range(2500)), tmp_path)
    kinds = {outcome.split(":")[0] for outcome in outcomes}
    assert outcomes.total() == 2500
    assert len(kinds) == 19
    assert all(any(o.startswith(f"{kind}:") and not o.endswith("read") for o in outcomes) for kind in kinds)


def patched(tmp_path, **image):
    metadata = metadata_of("f01", 4, 4)
    path = tmp_path / "a.lfp"
    write_lfp(path, np.zeros((4, 4), np.uint16), metadata, PRIVATE)
    metadata["image"] |= image
    text = path.read_bytes()
    frame = {"frame": {"metadata": metadata, "imageRef": "sha1-" + "0" * 40}}
    write_container(path, {"frames": [frame]}, [text[:24]])
    return path


@pytest.mark.parametrize("image", [{"width": 2**31}, {"width": 10**6, "height": 10**6}, {"width": -1}, {"width": "9"}, {"width": 4.0}])  # fmt: skip  # noqa: E501
def test_huge_pictures_allocate_nothing(tmp_path, image) -> None:
    path = patched(tmp_path, **image)
    tracemalloc.start()
    with pytest.raises(FileFormatError):
        open_lfp(path)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


def test_json_bombs(tmp_path) -> None:
    path = tmp_path / "a.lfp"
    for text in (b"[" * 100_000, b'{"a":' * 90 + b"1" + b"}" * 90, b" " * (MAX_JSON_BYTES + 1)):
        body = b'{"frames": ' + text
        write_container(path, {}, [])
        # A table of contents of its own, under the right SHA-1.
        import hashlib
        import struct

        head = struct.pack(">8sII", b"\x89LFM\r\n\x1a\n", 0, len(body))
        sha1 = hashlib.sha1(body, usedforsecurity=False).hexdigest()
        path.write_bytes(path.read_bytes()[:16] + head + f"sha1-{sha1}".encode().ljust(80, b"\0") + body)
        with pytest.raises(FileFormatError):
            open_picture(path)


def test_endless_zeros_and_sections(tmp_path) -> None:
    path = tmp_path / "a.lfp"
    write_container(path, {"frames": []}, [])
    with path.open("r+b") as file:
        file.truncate(1 << 34)
    with pytest.raises(LimitError, match="zeros and more"):
        open_picture(path)
    write_container(path, {"frames": []}, [b""] * 9000)
    with pytest.raises(LimitError, match="more than 8192"):
        open_picture(path)


def test_messages_cannot_move_the_cursor(tmp_path) -> None:
    (tmp_path / "a\x1b[2Jb.lfp").write_bytes(json.dumps({}).encode())
    with pytest.raises(FileFormatError) as caught:
        open_picture(tmp_path / "a\x1b[2Jb.lfp")
    assert str(caught.value).isprintable()


def test_a_view_number_beyond_all_grids(tmp_path) -> None:
    (tmp_path / "input_Cam9999.png").write_bytes(b"")
    with pytest.raises(LimitError, match="view 9999"):
        open_views(tmp_path)
