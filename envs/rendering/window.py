"""A window of our own, beside whatever windows the user has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lanebound.envs.rendering.canvas import load_pygame

if TYPE_CHECKING:
    import pygame

__all__ = ["Window"]


class Window:
    """Shows pictures at no more than ``fps`` a second until the user closes it."""

    def __init__(self, width_px: int, height_px: int, title: str, fps: float) -> None:
        self._pg = load_pygame()
        self._ours = not self._pg.display.get_init()
        if self._ours:
            self._pg.display.init()
        self._window: pygame.Window | None = self._pg.Window(title, (width_px, height_px))
        self._clock = self._pg.time.Clock()
        self._fps = fps

    @property
    def is_open(self) -> bool:
        """False once the user or :meth:`close` has closed it."""
        return self._window is not None

    def show(self, picture: pygame.Surface) -> None:
        """Show a picture and wait for the time of the next; nothing happens when closed."""
        if self._window is not None and self._asked_to_close(self._window):
            self.close()
        if self._window is None:
            return
        self._window.get_surface().blit(picture, (0, 0))
        self._window.flip()
        self._clock.tick(self._fps)

    def _asked_to_close(self, window: pygame.Window) -> bool:
        """Take our own requests from the queue, and leave those of other windows on it."""
        ours = False
        for event in self._pg.event.get([self._pg.WINDOWCLOSE]):
            if getattr(event, "window", None) == window:
                ours = True
            else:
                self._pg.event.post(event)
        return ours

    def close(self) -> None:
        """Close it; the display too, when nobody had opened it before."""
        if self._window is None:
            return
        self._window.destroy()
        self._window = None
        if self._ours:
            self._pg.display.quit()
