r"""Axes, labels, signs and units: the one page that every part of lfflow agrees on.

Labels
------
=============  =====================================================================================================
``x``, ``y``   sensor column and row; pixel centres at integers, (0, 0) is the centre of the top-left pixel, y down
``u``, ``v``   view: offset in sensor pixels from the (rounded) lens centre, right and down; the place in the aperture
``s``, ``t``   lens: column and row of the microlens in the brick layout; ``t = k2``, ``s = k1 + floor(k2 / 2)``
``capture``    one picture, a string id
``channel``    "R", "G", "B"
``pair``       a pair of views that is matched; coordinates ``pair_u``, ``pair_v`` hold the baseline
``hypothesis`` a candidate disparity; the coordinate holds its value
=============  =====================================================================================================

Arrays lie as ``(capture, v, u, t, s[, channel])`` on disk and by default. Public functions use names, never positions.

Lattice
-------
The centre of lens (t, s) is ``T · (s − floor(t/2), t) + (cx, cy)`` in sensor pixels (x, y) with

    T = B(θ) · diag(dh, dv) · A,   A = [[1, 1/2], [0, √3/2]],   B = [[cos θ, −sin θ], [sin θ, cos θ]]

so (cx, cy) is the centre of lens (t=0, s=0). A square array has A = identity and no brick offset: lens (t, s) is at
``T · (s, t) + (cx, cy)``.

In lens pitches dh, the lens (t, s) of the brick layout lies at X = s + ½·(t mod 2), Y = t·(√3/2)·dv/dh.
On the square grid of a picture X = s, Y = t (divided by the scale).

Disparity
---------
d is in lens pitches per view step (one sensor pixel of u or v); for folders of views in image pixels per view step.
A point at X in view (0, 0) lies at X − d·u in view (u, v), and Y likewise with v. d > 0 is nearer than the focal
plane, 0 lies on it; both directions share one d; NaN means none.

Radiance
--------
Linear float: 0 is the black level, 1 the white level, after vignetting. Colour matrix and gamma belong to pictures.
The colour of a mosaicked sample (``cfa``) is 0 R, 1 G, 2 B, and 255 where there is no sample.

Other letters
-------------
LFToolbox writes (s, t) for views and (u, v) for lenses; Levoy and Hanrahan, plenopticam and plenpy write as here.
`TO_LFTOOLBOX` and `FROM_LFTOOLBOX` rename a dataset either way: ``ds.rename(TO_LFTOOLBOX)``.
"""

from typing import Final

VIEW_DIMS: Final = ("v", "u")
LENS_DIMS: Final = ("t", "s")
SENSOR_DIMS: Final = ("y", "x")
FIELD_DIMS: Final = ("v", "u", "t", "s")
CHANNELS: Final = ("R", "G", "B")
SITES: Final = ("r", "gr", "gb", "b")

CFA_R: Final = 0
CFA_G: Final = 1
CFA_B: Final = 2
CFA_NONE: Final = 255

TO_LFTOOLBOX: Final = {"v": "t", "u": "s", "t": "v", "s": "u"}
FROM_LFTOOLBOX: Final = {new: old for old, new in TO_LFTOOLBOX.items()}
