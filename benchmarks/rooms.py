"""Rendered rooms with exact disparity, as hard to match as the HCI scenes: grids, leaves, smooth bodies, gloss, shadow.

Rays through patches, ellipsoids and bars in space; texture, light and gloss belong to the place, so that nothing here
is shared with what matches the views. `python benchmarks/rooms.py NAME SEED FOLDER` writes one as a folder of views.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numba
import numpy as np
import numpy.typing as npt
import xarray as xr

from lfflow.formats.pfm import write_pfm

Array = npt.NDArray[np.float64]

PATCH, BALL, BAR = 0, 1, 2
GRAIN, WEAVE, BRICKS = 0, 1, 2
WHOLE, GRID, LEAF, SLATS = 0, 1, 2, 3
FOCAL, BASELINE = 1.1, 12.0
"""Focal length in picture widths; disparity = BASELINE (1/z − 1) px per view step on 512 columns."""
TAPS, RADIUS, FAR = 3, 4, 1e9
FAST = {"nsz", "contract", "reassoc", "arcp"}


class Room:
    """Surfaces, each a row of numbers for the kernels (the last four a sphere about it), and a lamp."""

    def __init__(self, seed: int, ambient: float, lamp: Sequence[float]) -> None:
        self.rng = np.random.default_rng(seed)
        self.ambient, self.lamp = ambient, np.array(lamp, dtype=np.float64)
        self.kinds: list[int] = []
        self.shapes: list[Array] = []
        self.looks: list[Array] = []

    def _add(
        self, kind, bound, numbers, colour, grain=0.2, scale=30.0, pattern=GRAIN, gloss=0.0, cut=WHOLE, cuts=(0.0, 0.0)
    ):
        self.kinds.append(kind)
        numbers = np.concatenate([np.ravel(n) for n in numbers])
        self.shapes.append(np.concatenate([np.pad(numbers, (0, 12))[:12], bound[0], [bound[1] ** 2]]))
        self.looks.append(np.array([*colour, grain, scale, pattern, gloss, cut, *cuts, self.rng.uniform(0, 50)]))

    def patch(self, middle, a, b, colour, **look):
        """Parallelogram middle ± a ± b."""
        normal = np.cross(a, b)
        bound = middle, np.linalg.norm(a) + np.linalg.norm(b)
        self._add(PATCH, bound, (middle, a, b, normal / np.linalg.norm(normal)), colour, **look)

    def ball(self, middle, radii, colour, **look):
        turn, _ = np.linalg.qr(self.rng.normal(size=(3, 3)))
        self._add(BALL, (middle, max(radii)), (middle, np.diag(1 / np.asarray(radii)) @ turn), colour, **look)

    def bar(self, start, end, radius, colour, **look):
        bound = (np.asarray(start) + end) / 2, np.linalg.norm(np.asarray(end) - start) / 2 + radius
        self._add(BAR, bound, (start, end, [radius]), colour, **look)

    def box(self, middle, half, colour, yaw=0.0, **look):
        axes = np.array([[math.cos(yaw), 0, math.sin(yaw)], [0, 1, 0], [-math.sin(yaw), 0, math.cos(yaw)]])
        axes *= np.asarray(half)[:, None]
        for i in range(3):
            for sign in (-1, 1):
                self.patch(np.asarray(middle) + sign * axes[i], axes[(i + 1) % 3], axes[(i + 2) % 3], colour, **look)


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _chance(i, j, k):
    """Number in −½..½ that belongs to three whole numbers."""
    h = (i * 374761393 + j * 668265263 + k * 2147483647) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    return ((h ^ (h >> 15)) & 0xFFFF) / 65535.0 - 0.5


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _noise(x, y, z):
    """Smooth noise in space with unit grid."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    fx, fy, fz = x - i, y - j, z - k
    fx, fy, fz = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy), fz * fz * (3 - 2 * fz)
    total = 0.0
    for c in range(2):
        for b in range(2):
            share = (fz if c else 1 - fz) * (fy if b else 1 - fy)
            total += share * ((1 - fx) * _chance(i, j + b, k + c) + fx * _chance(i + 1, j + b, k + c))
    return total


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _sum(a, factor, b):
    """a + factor · b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _unit(a):
    return _sum((0.0, 0.0, 0.0), 1 / math.sqrt(_dot(a, a)), a)


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _vector(row, first):
    return row[first], row[first + 1], row[first + 2]


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _hole(look, a, b):
    """Whether a patch is cut out at (a, b) in −1..1."""
    if look[7] == GRID:
        return (a * look[8]) % 1.0 > look[9] and (b * look[8]) % 1.0 > look[9]
    if look[7] == LEAF:
        return abs(b) > 1 - a * a
    return look[7] == SLATS and (a * look[8]) % 1.0 > look[9]


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _meet_patch(shape, look, start, way):
    normal = _vector(shape, 9)
    den = _dot(way, normal)
    if abs(den) < 1e-9:
        return FAR, normal
    far = -_dot(start, normal) / den
    place, across, down = _sum(start, far, way), _vector(shape, 3), _vector(shape, 6)
    a, b = _dot(place, across) / _dot(across, across), _dot(place, down) / _dot(down, down)
    if abs(a) > 1 or abs(b) > 1 or _hole(look, a, b):
        return FAR, normal
    return far, _sum((0.0, 0.0, 0.0), -1.0 if den > 0 else 1.0, normal)


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _root(a, b, c):
    """Smaller root of a x² + 2 b x + c; far away without any."""
    square = b * b - a * c
    return FAR if square < 0 or a < 1e-12 else (-b - math.sqrt(square)) / a


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _meet_ball(shape, start, way):
    a, b, c = _vector(shape, 3), _vector(shape, 6), _vector(shape, 9)
    p, d = (_dot(a, start), _dot(b, start), _dot(c, start)), (_dot(a, way), _dot(b, way), _dot(c, way))
    far = _root(_dot(d, d), _dot(p, d), _dot(p, p) - 1)
    x, y, z = _sum(p, far, d)
    return far, _unit(_sum(_sum((x * a[0], x * a[1], x * a[2]), y, b), z, c))


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _meet_bar(shape, start, way):
    axis = _sum(_vector(shape, 3), -1.0, _vector(shape, 0))
    length = math.sqrt(_dot(axis, axis))
    axis = _unit(axis)
    along, rate = _dot(start, axis), _dot(way, axis)
    p, d = _sum(start, -along, axis), _sum(way, -rate, axis)
    far = _root(_dot(d, d), _dot(p, d), _dot(p, p) - shape[6] ** 2)
    inside = 0 <= along + far * rate <= length
    return far if inside else FAR, _sum((0.0, 0.0, 0.0), 1 / shape[6], _sum(p, far, d))


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _meet(kinds, shapes, looks, origin, way, limit):
    """First surface within `limit` along a ray (−1 where there is none), how far, and its normal."""
    found, nearest, normal = -1, limit, (0.0, 0.0, 0.0)
    square = _dot(way, way)
    for q in range(kinds.shape[0]):
        middle = _sum(origin, -1.0, _vector(shapes[q], 12))
        if _dot(middle, middle) - _dot(middle, way) ** 2 / square > shapes[q, 15]:
            continue
        start = _sum(origin, -1.0, _vector(shapes[q], 0))
        if kinds[q] == PATCH:
            far, turned = _meet_patch(shapes[q], looks[q], start, way)
        elif kinds[q] == BALL:
            far, turned = _meet_ball(shapes[q], start, way)
        else:
            far, turned = _meet_bar(shapes[q], start, way)
        if 1e-4 < far < nearest:
            found, nearest, normal = q, far, turned
    return found, nearest, normal


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _texture(look, p):
    """Factor of the colour at a place."""
    f, grain, off = look[4], look[3], look[10]
    if look[5] == WEAVE:
        waves = math.sin((p[0] + 0.3 * p[2]) * f * 6.28) * math.sin((p[1] + 0.3 * p[2]) * f * 6.28)
        return 1 + grain * (waves + 0.3 * _noise(p[0] * f * 0.5 + off, p[1] * f * 0.5, p[2] * f * 0.5))
    if look[5] == BRICKS:
        row = math.floor(p[1] * f)
        tone = 2 * _chance(math.floor(p[0] * f * 0.5 + 0.5 * (row % 2)), row, math.floor(p[2] * f * 0.5))
        return 1 + grain * (tone + 0.2 * _noise(p[0] * f * 4, p[1] * f * 4, p[2] * f * 4))
    total, share = 0.0, 2.0
    for _ in range(4):
        total += share * _noise(p[0] * f + off, p[1] * f + off, p[2] * f)
        f, share = 2.1 * f, 0.6 * share
    return math.exp(grain * total)


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _light(kinds, shapes, looks, lamp, tap, place, way, normal, gloss):
    """Direct light and gloss at a place; each tap has its own point on the lamp, for soft shadows."""
    point = (lamp[0] + 0.08 * _chance(tap, 0, 11), lamp[1] + 0.08 * _chance(tap, 1, 11), lamp[2])
    towards = _sum(point, -1.0, place)
    away = math.sqrt(_dot(towards, towards))
    towards = _unit(towards)
    slant = _dot(normal, towards)
    if slant <= 0 or _meet(kinds, shapes, looks, _sum(place, 1e-3, normal), towards, away)[0] >= 0:
        return 0.0, 0.0
    shine = max(_dot(normal, _unit(_sum(towards, -1.0, _unit(way)))), 0.0)
    return 0.9 * slant / (0.5 + 0.5 * away * away), gloss * shine**40


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _tent(share):
    """Offset of a tap in pixels, of triangular density."""
    return 0.9 * (math.sqrt(2 * share) - 1 if share < 0.5 else 1 - math.sqrt(2 - 2 * share))


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _ray(t, s, eye, size):
    """Direction through a pixel; all views see the same at z = 1."""
    x, y = (s - (size - 1) / 2) / (FOCAL * size), (t - (size - 1) / 2) / (FOCAL * size)
    return x - eye[0], y - eye[1], 1.0


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _view(kinds, shapes, looks, lamp, ambient, u, v, out):
    """Fill `out` (t, s, channel) with linear radiance."""
    size = out.shape[0]
    eye = (u * BASELINE / (FOCAL * 512), v * BASELINE / (FOCAL * 512), 0.0)
    for t in range(size):
        for s in range(size):
            for tap in range(TAPS * TAPS):
                dy = _tent((tap // TAPS + 0.5 + _chance(tap, 9, 2)) / TAPS)
                dx = _tent((tap % TAPS + 0.5 + _chance(tap, 3, 7)) / TAPS)
                way = _ray(t + dy, s + dx, eye, size)
                q, far, normal = _meet(kinds, shapes, looks, eye, way, FAR)
                if q >= 0:
                    place = _sum(eye, far, way)
                    direct, shine = _light(kinds, shapes, looks, lamp, tap, place, way, normal, looks[q, 6])
                    shade = _texture(looks[q], place) * (ambient * (0.7 - 0.3 * normal[1]) + direct)
                    for c in range(3):
                        out[t, s, c] += (looks[q, c] * shade + shine) / TAPS**2


@numba.njit(nogil=True, cache=True, fastmath=FAST)
def _depth(kinds, shapes, looks, out):
    size, eye = out.shape[0], (0.0, 0.0, 0.0)
    for t in range(size):
        for s in range(size):
            out[t, s] = _meet(kinds, shapes, looks, eye, _ray(t, s, eye, size), 50.0)[1]


def render(room: Room, size: int) -> tuple[xr.Dataset, npt.NDArray[np.float32]]:
    """9 × 9 views of 8 bit with gamma, ``rgb (v, u, t, s, channel)`` in 0..1, and the disparity (t, s)."""
    kinds, shapes, looks = np.array(room.kinds), np.array(room.shapes), np.array(room.looks)
    offsets = np.arange(-RADIUS, RADIUS + 1)
    rgb = np.zeros((len(offsets), len(offsets), size, size, 3))

    def one(q: int) -> None:
        i, j = divmod(q, len(offsets))
        _view(kinds, shapes, looks, room.lamp, room.ambient, float(offsets[j]), float(offsets[i]), rgb[i, j])

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(one, range(len(offsets) ** 2)))
    depth = np.empty((size, size))
    _depth(kinds, shapes, looks, depth)
    shown = (np.round(np.clip(rgb, 0, 1) ** (1 / 2.2) * 255) / 255).astype(np.float32)
    coords = {"v": offsets, "u": offsets, "channel": ["R", "G", "B"]}
    views = xr.Dataset({"rgb": (("v", "u", "t", "s", "channel"), shown)}, coords)
    return views, (BASELINE * (1 / depth - 1) * size / 512).astype(np.float32)


def crate(seed: int) -> Room:
    """A grid, slats and thin bars before boxes."""
    r = Room(seed, 0.4, (-0.5, -0.7, 0.1))
    g = r.rng
    r.patch((0, 0, 1.3), (1.2, 0, 0.05), (0, 1.2, 0), (0.5, 0.42, 0.33), grain=0.35, scale=25)
    r.patch((0, 0.42, 1.0), (1.2, 0, 0), (0, 0, 0.6), (0.35, 0.3, 0.25), grain=0.3, scale=40)
    for i in range(5):
        place = (g.uniform(-0.4, 0.4), g.uniform(0.05, 0.3), g.uniform(1.0, 1.2))
        r.box(place, g.uniform(0.05, 0.13, 3), g.uniform(0.2, 0.7, 3), g.uniform(-0.8, 0.8), grain=g.uniform(0.02, 0.3),
              scale=g.uniform(20, 80), pattern=int(g.integers(0, 3)), gloss=0.1 * (i % 2))  # fmt: skip
    r.patch((-0.12, -0.05, 0.92), (0.3, 0, 0.04), (0, 0.28, 0), (0.55, 0.5, 0.4), grain=0.15, scale=60, cut=GRID,
            cuts=(4.0, 0.14))  # fmt: skip
    r.patch((0.3, 0.12, 0.83), (0.1, 0, -0.03), (0, 0.25, 0), (0.3, 0.4, 0.5), grain=0.1, scale=60, cut=SLATS,
            cuts=(5.0, 0.3))  # fmt: skip
    for _ in range(4):
        top = np.array([g.uniform(-0.35, 0.35), -0.45, g.uniform(0.8, 0.95)])
        end = top + np.array([g.uniform(-0.2, 0.2), 0.7, g.uniform(-0.05, 0.05)])
        r.bar(top, end, g.uniform(0.003, 0.008), g.uniform(0.1, 0.7, 3), grain=0.1, scale=50)
    return r


def bust(seed: int) -> Room:
    """Smooth bodies of little texture before a faint wall."""
    r = Room(seed, 0.3, (0.7, -0.8, 0.2))
    g, stone = r.rng, (0.62, 0.6, 0.57)
    r.patch((0, 0, 1.25), (1.3, 0, 0.25), (0, 1.3, 0), (0.4, 0.36, 0.3), grain=0.06, scale=18)
    r.patch((0, 0.4, 1.0), (1.3, 0, 0), (0, 0.02, 0.6), (0.32, 0.3, 0.28), grain=0.05, scale=30)
    bodies = (
        ((0, 0.5, 0.98), (0.36, 0.3, 0.3)),
        ((0.02, -0.08, 0.93), (0.15, 0.16, 0.13)),
        ((0, 0.18, 0.97), (0.12,) * 3),
    )
    for middle, radii in bodies:
        r.ball(middle, radii, stone, grain=0.04, scale=14, gloss=0.05)
    for _ in range(14):
        turn = g.uniform(0, 6.3)
        place = (0.02 + 0.13 * np.cos(turn), -0.2 + 0.06 * np.sin(turn), 0.9 + g.uniform(-0.08, 0.04))
        r.ball(place, g.uniform(0.02, 0.06, 3), stone, grain=0.05, scale=20, gloss=0.05)
    return r


def plain(seed: int) -> Room:
    """Plain walls, boards and bodies, with shading and hardly any texture."""
    r = Room(seed, 0.35, (-0.3, -0.55, 0.3))
    g = r.rng
    r.patch((0, 0, 1.33), (1.2, 0, 0), (0, 1.2, 0), (0.55, 0.52, 0.45), grain=0.02, scale=10)
    r.patch((-0.55, 0, 1.0), (0.03, 0, 0.5), (0, 1.2, 0), (0.5, 0.35, 0.3), grain=0.03, scale=16)
    r.patch((0, 0.38, 1.0), (1.2, 0, 0), (0, 0, 0.6), (0.4, 0.4, 0.42), grain=0.03, scale=20)
    for i in range(4):
        place = (g.uniform(-0.4, 0.4), g.uniform(-0.1, 0.3), g.uniform(0.9, 1.15))
        r.ball(place, g.uniform(0.05, 0.16, 3), g.uniform(0.2, 0.7, 3), grain=g.uniform(0.01, 0.1),
               scale=g.uniform(10, 40), gloss=0.15 * (i % 2))  # fmt: skip
    for _ in range(3):
        place = (g.uniform(-0.4, 0.4), g.uniform(0.1, 0.3), g.uniform(0.95, 1.15))
        r.box(place, g.uniform(0.05, 0.12, 3), g.uniform(0.2, 0.7, 3), g.uniform(-0.9, 0.9),
              grain=g.uniform(0.01, 0.05), scale=g.uniform(10, 40))  # fmt: skip
    place = (g.uniform(-0.3, 0.3), 0, 0.95)
    r.patch(place, (0.12, 0.05, 0.1), (-0.04, 0.16, 0.03), (0.5, 0.5, 0.2), grain=0.02, scale=15)
    return r


def shelf(seed: int) -> Room:
    """Fine wallpaper, a plant of thin leaves, glossy things on a board."""
    r = Room(seed, 0.4, (0.4, -0.8, 0.1))
    g = r.rng
    r.patch((0, 0, 1.28), (1.2, 0, 0), (0, 1.2, 0), (0.5, 0.5, 0.42), grain=0.3, scale=26, pattern=WEAVE)
    r.patch((0, 0.2, 1.12), (0.45, 0, 0), (0, 0, 0.16), (0.4, 0.25, 0.15), grain=0.15, scale=40)
    r.patch((0, 0.24, 0.96), (0.45, 0, 0), (0, 0.04, 0), (0.4, 0.25, 0.15), grain=0.15, scale=40)
    r.patch((0, 0.45, 1.0), (1.2, 0, 0), (0, 0, 0.6), (0.45, 0.4, 0.35), grain=0.3, scale=15, pattern=BRICKS)
    for _ in range(4):
        place = (g.uniform(-0.4, 0.4), 0.12, g.uniform(1.0, 1.2))
        r.ball(place, g.uniform(0.04, 0.08, 3), g.uniform(0.1, 0.6, 3), grain=0.1, gloss=0.4)
    root = np.array([g.uniform(-0.25, 0.25), 0.3, 0.92])
    for i in range(26):
        up = np.array([g.normal(0, 0.6), -abs(g.normal(0, 1)) - 0.3, g.normal(0, 0.4)])
        up /= np.linalg.norm(up)
        tip = root + up * g.uniform(0.15, 0.4)
        if i % 3 == 0:
            r.bar(root, tip, 0.003, (0.15, 0.25, 0.08), grain=0.1)
        across = np.cross(up, g.normal(size=3))
        across *= g.uniform(0.01, 0.03) / np.linalg.norm(across)
        green = (0.12 * g.uniform(0.5, 2), 0.3 * g.uniform(0.6, 1.4), 0.08)
        r.patch(tip, up * g.uniform(0.03, 0.07), across, green, grain=0.15, scale=50, cut=LEAF)
    return r


ROOMS: dict[str, Callable[[int], Room]] = {"crate": crate, "bust": bust, "plain": plain, "shelf": shelf}


def main(name: str, seed: int, folder: Path) -> None:
    views, truth = render(ROOMS[name](seed), 320)
    folder.mkdir(parents=True, exist_ok=True)
    pictures = views["rgb"].to_numpy().reshape(-1, *views["rgb"].shape[2:])
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"input_Cam{number:03}.png"), np.round(picture[..., ::-1] * 255).astype(np.uint8))
    write_pfm(folder / "gt_disp_lowres.pfm", truth)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
