"""A separate window, independent of other windows of the user."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lanebound.envs.rendering.canvas import load_pygame

if TYPE_CHECKING:
    import pygame

__all__ = ["Window"]


class Window:
    """Window that shows at most ``fps`` pictures per second until the user closes it."""

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
        """Whether the window is open; False after the user or :meth:`close` has closed it."""
        return self._window is not None

    def show(self, picture: pygame.Surface) -> None:
        """Show a picture and wait until the time of the next picture; without effect if the window is closed."""
        if self._window is not None and self._asked_to_close(self._window):
            self.close()
        if self._window is None:
            return
        self._window.get_surface().blit(picture, (0, 0))
        self._window.flip()
        self._clock.tick(self._fps)

    def _asked_to_close(self, window: pygame.Window) -> bool:
        """Process the close requests of this window; events of other windows remain in the queue."""
        ours = False
        for event in self._pg.event.get([self._pg.WINDOWCLOSE]):
            if getattr(event, "window", None) == window:
                ours = True
            else:
                self._pg.event.post(event)
        return ours

    def close(self) -> None:
        """Close the window, and the display if this window has opened it."""
        if self._window is None:
            return
        self._window.destroy()
        self._window = None
        if self._ours:
            self._pg.display.quit()
