"""Dark images of a camera: their hot pixels are flagged in its calibrations, and in no other camera's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from fake_chain import FAKE, write_capture
from fault_tools import lines

from lfflow.run import Options, run_collection
from lfflow.run.chain import CHAIN
from lfflow.run.executors import Workers
from lfflow.run.memory import calibration_work

HOT = (7, 11)


@pytest.fixture
def seen(monkeypatch):
    """A chain whose calibration notes how many dark images it is given."""
    given_darks = []
    original = FAKE["calibration"].function

    def calibrate(given):
        given_darks.append((given.frame["capture"].item(), len(list(given.darks))))
        return original(given)

    stages = tuple(
        replace(stage, function=calibrate, uses_darks=True) if stage.name == "calibration" else stage
        for stage in FAKE.stages
    )
    return replace(FAKE, stages=stages), given_darks


def test_a_new_dark_image_redoes_what_depends_on_it_and_nothing_of_other_cameras(tmp_path, captures, calls, seen):
    chain, given = seen
    write_capture(captures / "OTHER.lfp", seed=50, serial="S2")
    options = Options(inputs=(captures,), workers=Workers("threads", 1))
    run_collection(tmp_path / "col", options, chain)
    assert sorted(given) == [("OTHER", 0), ("WHITE_1", 0)]
    given.clear()
    calls.write_text("")
    write_capture(captures / "DARK_1.lfp", seed=60, kind="dark")
    write_capture(captures / "DARK_2.lfp", seed=61, kind="dark")
    assert run_collection(tmp_path / "col", options, chain).counts["kept"] == 3
    assert given == [("WHITE_1", 2)]
    assert not [line for line in lines(calls) if "OTHER" in line]


def test_the_chain_flags_the_pixels_that_dark_images_agree_on():
    from lfflow.run import chain

    frames = np.full((3, 40, 40), 168, "uint16")
    frames[:, HOT[0], HOT[1]] = 3000
    frames[0, 20, 20] = 3000
    levels = {"black_level": ("site", [168.0] * 4), "white_level": ("site", [4095.0] * 4)}
    darks = [
        xr.Dataset(
            {"raw": (("y", "x"), frame)},
            coords={**levels, "site": ["r", "gr", "gb", "b"], "cfa_pattern": "BGGR", "kind": "dark"},
        )
        for frame in frames
    ]
    flags = chain._defects(iter(darks))
    assert [tuple(place) for place in np.argwhere(flags.values)] == [HOT]
    assert chain._defects(()) is None
    assert CHAIN["calibration"].uses_darks
    assert CHAIN["calibration"].work is calibration_work
