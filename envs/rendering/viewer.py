"""The viewer: renders a frame to an array or to a window, which is independent of other windows of the user."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.rendering.canvas import Canvas, load_pygame
from lanebound.envs.rendering.config import RenderingConfig
from lanebound.envs.rendering.frame import Frame
from lanebound.envs.rendering.map_view import camera_of, draw_map
from lanebound.envs.rendering.panel import draw_legend, draw_panel
from lanebound.envs.rendering.roads import RoadDrawing
from lanebound.envs.rendering.scenery import Scenery
from lanebound.envs.rendering.theme import THEMES

if TYPE_CHECKING:
    import pygame

__all__ = ["Viewer", "Window"]


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


class Viewer:
    """Renders frames; equal frames give equal pictures.

    >>> viewer = Viewer(RenderingConfig(orientation="north_up"))  # doctest: +SKIP
    >>> rgb = viewer.render(frame)  # doctest: +SKIP

    Parameters
    ----------
    config : size, zoom and style
    title, fps : of the window that :meth:`show` opens

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        pygame is missing.
    """

    def __init__(self, config: RenderingConfig | None = None, *, title: str = "lanebound", fps: float = 20.0) -> None:
        self.config = config if config is not None else RenderingConfig()
        self._canvas = Canvas(self.config.width_px, self.config.height_px, self.config.supersampling)
        self._theme = THEMES[self.config.theme]
        self._title, self._fps = title, fps
        self._window: Window | None = None
        self._roads: RoadDrawing | None = None
        self._scenery: Scenery | None = None

    def render(self, frame: Frame) -> NDArray[np.uint8]:
        """Render a frame to a new array (height, width, 3)."""
        self._draw(frame)
        return self._canvas.pixels()

    def show(self, frame: Frame) -> bool:
        """Show the picture in a window, which the first call opens; returns False after the user has closed it."""
        if self._window is None:
            self._window = Window(self.config.width_px, self.config.height_px, self._title, self._fps)
        if self._window.is_open:
            self._window.show(self._draw(frame))
        return self._window.is_open

    def close(self) -> None:
        """Close the window; the viewer remains usable."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def __reduce__(self) -> tuple[Callable[[], Self], tuple[()]]:
        """A copied or pickled viewer is a new one with the same options, without surfaces and windows."""
        return partial(type(self), self.config, title=self._title, fps=self._fps), ()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _draw(self, frame: Frame) -> pygame.Surface:
        camera = camera_of(frame, self.config)
        draw_map(self._canvas, frame, camera, self._roads_of(frame), self._scenery_of(frame), self._theme)
        if self.config.legend:
            draw_legend(self._canvas, frame, camera, self.config, self._theme)
        draw_panel(self._canvas, frame, self.config, self._theme)
        return self._canvas.finish()

    def _roads_of(self, frame: Frame) -> RoadDrawing:
        if self._roads is None or self._roads.network is not frame.network:
            self._roads = RoadDrawing.of(frame.network)
        return self._roads

    def _scenery_of(self, frame: Frame) -> Scenery | None:
        if frame.city is None:
            return None
        if self._scenery is None or self._scenery.city is not frame.city:
            self._scenery = Scenery.of(frame.city)
        return self._scenery
