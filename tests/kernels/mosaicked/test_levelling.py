"""Light that changes with the viewpoint is taken off the views; texture is not."""

from __future__ import annotations

import numpy as np
import pytest

import lfflow
from lfflow.conventions import CFA_NONE
from lfflow.kernels.colour.completion import complete_centre
from lfflow.kernels.mosaicked.levelling import levelled, without_strangers
from lfflow.kernels.mosaicked.mosaic_field import mosaic_field
from lfflow.schema import lattice_of
from tests.mosaic_fields import lightfield, plane

TRUE = 0.3
INNER = {"t": slice(7, -7), "s": slice(7, -7)}


def shaded(strength):
    """Weak texture on a bright slope whose light moves the other way with the viewpoint."""
    texture = plane(TRUE)

    def scene(X, Y, a, b, colour):
        weak = 0.5 + 0.06 * (texture(X, Y, a, b, colour) - 0.5)
        slope = np.sin(2 * np.pi * (X + TRUE * a) / 50) + np.sin(2 * np.pi * (Y + TRUE * b) / 40)
        return weak + 0.05 * slope + strength * (a * np.cos(2 * np.pi * X / 50) + b * np.cos(2 * np.pi * Y / 40))

    return lightfield(scene, noise=0.001)


def errors(lf, **options):
    return abs(lfflow.disparity(lf, **options)["disparity"].isel(INNER) - TRUE)


def field_of(lf):
    arrays = [lf[name].to_numpy() for name in ("mosaic", "cfa", "weight")]
    return mosaic_field(*arrays, tuple(lf[dim].to_numpy() for dim in ("v", "u", "t", "s")), lattice_of(lf))


def rms(difference):
    return float(np.sqrt(np.mean(difference[:, :, 7:-7, 7:-7] ** 2)))


@pytest.mark.parametrize("strength", [-0.004, 0.004])
def test_moving_light_is_taken_off_and_texture_is_not(strength):
    even, moved = field_of(shaded(0.0)), field_of(shaded(strength))
    truth = np.full(even.mosaic.shape[2:], TRUE, np.float32)
    picture, _ = complete_centre(even, truth, 0 * truth)
    found, same = (
        levelled(field, picture, truth, views=field.views(), limit=0.1, least=0.0005) for field in (moved, even)
    )
    light = rms(moved.mosaic - even.mosaic)
    assert rms(found.mosaic - even.mosaic) < 0.25 * light
    assert rms(same.mosaic - even.mosaic) < 0.05 * light


def test_without_levelling_it_would(monkeypatch):
    lf = shaded(-0.004)
    level = errors(lf)
    monkeypatch.setattr("lfflow.kernels.mosaicked.match_field.levelled", lambda field, *_, **__: field)
    assert float(errors(lf).mean()) > 2 * float(level.mean())


def test_even_light_stays_as_it_is():
    lf = shaded(0.0)
    assert float(errors(lf).median()) < 0.01


def test_views_that_are_black_or_far_lighter_are_left_out():
    lf = shaded(0.0)
    field = field_of(lf)
    assert without_strangers(field) is field
    mosaic = field.mosaic.copy()
    dark, light = field.views()[0], field.views()[-1]
    mosaic[dark] *= 0.01
    mosaic[light] *= 5
    found = without_strangers(field._replace(mosaic=mosaic))
    assert set(field.views()) - set(found.views()) == {dark, light}


def test_black_views_change_nothing():
    lf = shaded(0.0)
    inner = (abs(lf.u) < 4) & (abs(lf.v) < 4)
    black = lf.assign(mosaic=lf.mosaic.where(inner, 0.0 * lf.mosaic))
    cut = lf.assign(cfa=lf.cfa.where(inner, 255).astype("u1"))
    assert float(errors(black).median()) == float(errors(cut).median())


@pytest.mark.parametrize("gains", [(1.0, 0.2, 0.05), (0.05, 0.1, 1.0)])
def test_saturated_colours_are_no_strangers(gains):
    field = field_of(shaded(0.0))
    mosaic = field.mosaic.copy()
    for colour, gain in enumerate(gains):
        mosaic[field.cfa == colour] *= gain
    black, ungreen = field.views()[0], field.views()[1]
    mosaic[black] = 0.02
    cfa = field.cfa.copy()
    cfa[ungreen][cfa[ungreen] == 1] = CFA_NONE
    found = without_strangers(field._replace(mosaic=mosaic, cfa=cfa))
    assert set(field.views()) - set(found.views()) == {black}
