"""A sheet of pictures with captions, as one array: quick to draw from any thread, no global state."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
FloatImage = npt.NDArray[np.float32]

INK, SOFT, EMPTY = (34, 38, 43), (106, 112, 120), (201, 204, 209)
_CAPTION = 15


class Canvas:
    """A white sheet; places are pixels from its top-left corner.

    Parameters
    ----------
    width, height
        Size, pixels.
    """

    def __init__(self, width: int, height: int) -> None:
        self.pixels: Image = np.full((height, width, 3), 255, dtype=np.uint8)
        self._texts: list[tuple[tuple[int, int], str, int, tuple[int, int, int]]] = []

    def text(self, x: int, y: int, text: str, *, size: int = _CAPTION, colour: tuple[int, int, int] = INK) -> None:
        """Text whose top-left corner is (x, y)."""
        self._texts.append(((x, y), text, size, colour))

    def picture(self, x: int, y: int, width: int, height: int, image: Image) -> None:
        """RGB picture scaled into a box."""
        way = cv2.INTER_AREA if image.shape[0] > height else cv2.INTER_LINEAR
        self.pixels[y : y + height, x : x + width] = cv2.resize(image, (width, height), interpolation=way)

    def lines(self, x: int, y: int, lines: Sequence[npt.NDArray[np.floating]], colour: tuple[int, int, int]) -> None:
        """Thin lines (point, 2) in pixels from (x, y)."""
        points = [np.rint((line + np.array([x, y])) * 16).astype(np.int32) for line in lines]
        cv2.polylines(self.pixels, points, isClosed=False, color=colour, thickness=1, lineType=cv2.LINE_AA, shift=4)

    def bar(self, x: int, y: int, height: int, colours: Image, low: float, high: float) -> None:
        """Colour bar with five values beside it; `colours` (256, 3) from low to high."""
        self.pixels[y : y + height, x : x + 14] = cv2.resize(colours[::-1, None], (14, height))
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            place = round(y + (1 - share) * (height - 12)) - 2
            self.text(x + 19, place, f"{low + share * (high - low):.2f}", size=12)

    def png(self) -> bytes:
        """The sheet as PNG."""
        from PIL import Image as Pillow
        from PIL import ImageDraw, ImageFont

        sheet = Pillow.fromarray(self.pixels)
        draw = ImageDraw.Draw(sheet)
        fonts = {size: ImageFont.load_default(size) for size in {size for _, _, size, _ in self._texts}}
        for place, text, size, colour in self._texts:
            draw.text(place, text, font=fonts[size], fill=colour)
        drawn = np.asarray(sheet)[..., ::-1]
        return bytes(cv2.imencode(".png", drawn, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def palette(name: int) -> Image:
    """Colours (256, 3) of an OpenCV colour map, RGB."""
    return np.ascontiguousarray(cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], name)[:, 0, ::-1])


def coloured(values: FloatImage, low: float, high: float, colours: Image) -> Image:
    """Values as colours of a palette, NaN grey."""
    level = np.clip((np.nan_to_num(values) - low) / (high - low), 0, 1)
    picture: Image = colours[np.rint(level * 255).astype(np.intp)]
    picture[~np.isfinite(values)] = EMPTY
    return picture
