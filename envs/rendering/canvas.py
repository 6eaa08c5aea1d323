"""A canvas with anti-aliased shapes; only this file and window.py use pygame.

Shapes are drawn with supersampling and averaged; text is drawn on the result. No display is opened: no video driver is
needed, and windows of the user are not affected.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import TYPE_CHECKING, Literal

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.envs.rendering.theme import Colour

if TYPE_CHECKING:
    import pygame

__all__ = ["Anchor", "Canvas", "load_pygame"]

Array = NDArray[np.float64]
Anchor = Literal["left", "centre", "right"]

FONTS = {False: "DejaVuSans.ttf", True: "DejaVuSans-Bold.ttf"}  # fonts of matplotlib, the same on every machine
KEPT_WORDS = 512


def load_pygame() -> ModuleType:
    """Import pygame, or raise Gymnasium's error for a missing dependency."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as exc:
        raise gymnasium.error.DependencyNotInstalled(
            "rendering needs pygame, which cannot be imported: install it with `pip install pygame-ce`"
        ) from exc
    return pygame


class Canvas:
    """A picture of ``width_px`` by ``height_px``; coordinates are pixels as floats, x right and y down."""

    def __init__(self, width_px: int, height_px: int, supersampling: int) -> None:
        self._pg = load_pygame()
        self.size_px = (width_px, height_px)
        self._k = supersampling
        self._large = self._surface(width_px * supersampling, height_px * supersampling)
        self._small = self._surface(width_px, height_px) if supersampling > 1 else self._large
        self._fonts: dict[tuple[int, bool], pygame.font.Font] = {}
        self._words: dict[tuple[str, int, Colour, bool], pygame.Surface] = {}
        self._waiting: list[tuple[pygame.Surface, tuple[int, int]]] = []

    def _surface(self, width: int, height: int, *, alpha: bool = False) -> pygame.Surface:
        surface: pygame.Surface = self._pg.Surface((width, height), self._pg.SRCALPHA if alpha else 0, 32)
        return surface

    @contextmanager
    def clip(self, x: float, y: float, width: float, height: float) -> Iterator[None]:
        """Restrict drawing to this rectangle; text is not clipped."""
        k = self._k
        self._large.set_clip((round(x * k), round(y * k), round(width * k), round(height * k)))
        try:
            yield
        finally:
            self._large.set_clip(None)

    def fill(self, colour: Colour) -> None:
        """Fill the picture, or the clip rectangle."""
        self._large.fill(colour)

    def polygons(self, corners_px: ArrayLike, colour: Colour) -> None:
        """Draw filled polygons (n, k, 2)."""
        draw = self._pg.draw.polygon
        for polygon in self._scaled(corners_px).tolist():
            draw(self._large, colour, polygon)

    def blend(self, corners_px: ArrayLike, colour: Colour, opacity: float) -> None:
        """Draw transparent polygons (n, k, 2); the opacity is the same where they overlap."""
        polygons = self._scaled(corners_px)
        if not polygons.size:
            return
        low, high = np.floor(polygons.min((0, 1))), np.ceil(polygons.max((0, 1))) + 1.0
        box = self._pg.Rect(*low.tolist(), *(high - low).tolist()).clip(self._large.get_clip())
        if box.width == 0 or box.height == 0:
            return
        layer = self._surface(box.width, box.height, alpha=True)
        for polygon in (polygons - box.topleft).tolist():
            self._pg.draw.polygon(layer, (*colour, round(255 * opacity)), polygon)
        self._large.blit(layer, box)

    def line(self, points_px: ArrayLike, colour: Colour, width_px: float = 1.0, *, closed: bool = False) -> None:
        """Draw a line through points (n, 2)."""
        points = np.asarray(points_px, dtype=np.float64) * self._k
        if len(points) > 1:
            self._pg.draw.lines(self._large, colour, closed, points.tolist(), max(round(width_px * self._k), 1))

    def dashes(
        self, points_px: ArrayLike, colour: Colour, width_px: float = 1.0, *, on_px: float = 4.0, closed: bool = False
    ) -> None:
        """Draw a dashed line through points (n, 2); dashes and gaps have the length ``on_px``."""
        points = np.asarray(points_px, dtype=np.float64)
        if closed and len(points):
            points = np.concatenate([points, points[:1]])
        if len(points) < 2:
            return
        run = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        begin = np.arange(0.0, run[-1], 2.0 * on_px)
        ends = np.stack([begin, np.minimum(begin + on_px, run[-1])], 1)
        pieces = np.stack([np.interp(ends, run, points[:, axis]) for axis in (0, 1)], -1) * self._k
        for a, b in pieces.tolist():
            self._pg.draw.line(self._large, colour, a, b, max(round(width_px * self._k), 1))

    def circle(self, middle_px: Iterable[float], radius_px: float, colour: Colour, width_px: float = 0.0) -> None:
        """Draw a disc, or a ring of a given width."""
        k, (x, y) = self._k, middle_px
        width = max(round(width_px * k), 1) if width_px else 0
        self._pg.draw.circle(self._large, colour, (float(x) * k, float(y) * k), radius_px * k, width)

    def box(self, x: float, y: float, width: float, height: float, colour: Colour, *, round_px: float = 0.0) -> None:
        """Draw a filled axis-parallel rectangle with round corners."""
        k = self._k
        rect = self._pg.Rect(round(x * k), round(y * k), round(width * k), round(height * k))
        self._pg.draw.rect(self._large, colour, rect, border_radius=round(round_px * k))

    def text(
        self,
        x: float,
        y: float,
        words: str,
        size_px: int,
        colour: Colour,
        *,
        anchor: Anchor = "left",
        bold: bool = False,
    ) -> int:
        """Add text right of, at or left of x with its middle at y, drawn by :meth:`finish`; returns its width [px]."""
        word = self._word(words, size_px, colour, bold)
        left = {"left": x, "centre": x - 0.5 * word.get_width(), "right": x - word.get_width()}[anchor]
        self._waiting.append((word, (round(left), round(y - 0.5 * word.get_height()))))
        return word.get_width()

    def width_of(self, words: str, size_px: int, *, bold: bool = False) -> int:
        """Width of a text [px]."""
        return int(self._font(size_px, bold).size(words)[0])

    def finish(self) -> pygame.Surface:
        """Finish the picture; the returned surface is valid until the next picture is drawn."""
        if self._k > 1:
            self._pg.transform.smoothscale(self._large, self.size_px, self._small)
        self._small.blits(self._waiting, doreturn=False)
        self._waiting.clear()
        return self._small

    def pixels(self) -> NDArray[np.uint8]:
        """The finished picture, (height, width, 3), a new array."""
        width, height = self.size_px
        rgb = np.empty((height, width, 3), dtype=np.uint8)
        view = self._pg.surfarray.pixels3d(self._small)
        for channel in range(3):  # one channel at a time is five times as fast
            rgb[..., channel] = view[..., channel].T
        return rgb

    def _scaled(self, corners_px: ArrayLike) -> Array:
        return np.asarray(np.asarray(corners_px, dtype=np.float64) * self._k)

    def _font(self, size_px: int, bold: bool) -> pygame.font.Font:
        if (size_px, bold) not in self._fonts:
            from matplotlib import get_data_path

            if not self._pg.font.get_init():
                self._pg.font.init()
            path = os.path.join(get_data_path(), "fonts", "ttf", FONTS[bold])
            self._fonts[size_px, bold] = self._pg.font.Font(path, size_px)
        return self._fonts[size_px, bold]

    def _word(self, words: str, size_px: int, colour: Colour, bold: bool) -> pygame.Surface:
        key = (words, size_px, colour, bold)
        if key not in self._words:
            if len(self._words) >= KEPT_WORDS:
                self._words.clear()
            self._words[key] = self._font(size_px, bold).render(words, True, colour)
        return self._words[key]
