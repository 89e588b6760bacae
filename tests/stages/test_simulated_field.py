"""Simulated captures come back: to the quantisation, and with the noise that the weight claims."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from lfflow.simulate import simulate_white
from lfflow.simulate.body import BODIES, Setting
from lfflow.simulate.optics import Optics
from lfflow.stages.demultiplex import demultiplex


@pytest.mark.parametrize("camera", ["f01", "illum"])
def test_samples_are_the_simulated_ones_to_the_quantisation(camera: str) -> None:
    raw, white = simulate_white(height=240, width=260, camera=camera, noise=False, optics=Optics(crosstalk=0.0))
    lf = demultiplex(raw, white.rename(defects="pixel_flags"))
    error = []
    for colour in range(3):
        mine = lf.cfa.values == colour
        light = (lf.mosaic * lf.weight).values[mine]
        seen = lf.weight.values[mine].astype(float)
        gain = (light * seen).sum() / (seen**2).sum()
        error.append(np.abs(light - gain * lf.weight.values[mine]).max())
    half_count = 0.5 / float((raw.white_level - raw.black_level).min())
    assert max(error) < 1.1 * half_count


def test_noise_is_unbiased_and_of_the_variance_that_the_weight_claims() -> None:
    quiet, _ = simulate_white(height=320, width=330, noise=False)
    noisy, white = simulate_white(height=320, width=330, noise=True)
    cal = white.rename(defects="pixel_flags")
    clean, spoilt = demultiplex(quiet, cal), demultiplex(noisy, cal)
    good: xr.DataArray = (clean.weight >= 0.2) & (spoilt.weight >= 0.2) & (clean.cfa == 1)
    error = (spoilt.mosaic - clean.mosaic).values[good.values]
    weight, level = clean.weight.values[good.values], clean.mosaic.values[good.values]
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(error.size)
    sensor = BODIES["f01"].sensor_at(Setting())
    for low, high in ((0.2, 0.4), (0.4, 0.7), (0.7, 1.0)):
        mine = (weight >= low) & (weight < high)
        shot = (
            level[mine] / (sensor.full_well * weight[mine]) + (sensor.read_noise / sensor.full_well / weight[mine]) ** 2
        )
        assert error[mine].var() == pytest.approx(shot.mean(), rel=0.06)
