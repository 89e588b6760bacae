from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from analytic_field import make_field
from matplotlib.figure import Figure

from lfflow.errors import LfflowError
from lfflow.stages.epi import epi, plot_epi
from lfflow.stages.picture import develop, to_integers
from lfflow.stages.reconstruct import reconstruct_views


def test_lines_of_the_disparity_follow_the_texture() -> None:
    lf, disp, _ = make_field([(0.4, -99.0)])
    views = reconstruct_views(lf, disp, scale=2.0)
    for cut, lens, view in (({"t": 30}, "s", "u"), ({"s": 30}, "t", "v")):
        image = epi(views, **cut)
        assert image["epi"].dims == (view, lens, "channel")
        lines = image["line"].isel(line=slice(2, -2))
        along = image["epi"].interp({lens: lines, view: lines[view]})
        assert float(along.std(view).mean()) < 0.15 * float(image["epi"].std(view).mean())


def test_it_can_be_drawn() -> None:
    _, disp, views = make_field([(0.4, -99.0)], shape=(6, 12), radius=2)
    axes = plot_epi(epi(views.assign(disparity=disp["disparity"]), t=3), Figure().subplots())
    assert len(axes.lines) == 2


def test_slanted_cuts_are_refused() -> None:
    _, _, views = make_field([(0.4, -99.0)], shape=(6, 12), radius=1)
    with pytest.raises(LfflowError, match="square grid"):
        epi(views, s=3)
    with pytest.raises(LfflowError, match="one row"):
        epi(views)


def test_clipped_highlights_stay_neutral() -> None:
    matrix = np.array([[3.1, -1.9, -0.2], [-0.4, 1.7, -0.3], [0.1, -1.2, 2.1]])
    coords = {"channel": list("RGB"), "white_balance": ("channel", [1.0, 1.1, 1.7]), "gamma": 0.5}
    camera = xr.Dataset({"color_matrix": (("channel", "channel_in"), matrix)}, coords)
    rgb = xr.DataArray(np.ones((2, 2, 3), np.float32), dims=("t", "s", "channel"), coords={"channel": list("RGB")})
    shown = develop(rgb, camera, exposure=1.0)
    np.testing.assert_allclose(shown, 1, atol=1e-6)
    gray = develop(rgb / camera["white_balance"] * 0.25, camera, exposure=1.0)
    np.testing.assert_allclose(gray, 0.5, atol=1e-5)
    assert to_integers(gray, 16).dtype == np.uint16
    assert to_integers(gray)[0, 0, 0] == 128
