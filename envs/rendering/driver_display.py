"""The in-vehicle display: a light of green, amber or red and its reason, above the picture of a drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.rendering.canvas import Canvas
from lanebound.envs.rendering.theme import Theme, mix

__all__ = ["DISPLAY_PX", "with_display"]

DISPLAY_PX = 44  # a multiple of 4, which video codecs want


def with_display(
    picture: NDArray[np.uint8], light: str, advice: str, road: str, score: float, theme: Theme
) -> NDArray[np.uint8]:
    """The picture (H, W, 3) below a bar (DISPLAY_PX, W, 3): light, what it means, road and score."""
    width = picture.shape[1]
    colour = {"green": theme.ok, "amber": theme.caution, "red": theme.alert}[light]
    canvas = Canvas(width, DISPLAY_PX, 2)
    canvas.fill(mix(theme.panel, colour, 0.25))
    canvas.box(10, 10, DISPLAY_PX - 20, DISPLAY_PX - 20, colour, round_px=0.5 * DISPLAY_PX - 10)
    _write(canvas, advice, f"{road or 'no road'}   score {score:.0f}", theme)
    canvas.finish()
    return np.concatenate([canvas.pixels(), picture])


def _write(canvas: Canvas, advice: str, right: str, theme: Theme) -> None:
    """Write the advice beside the light, and road and score at the right."""
    width, middle = canvas.size_px[0], 0.5 * DISPLAY_PX
    canvas.text(DISPLAY_PX + 4, middle, advice, 13, theme.text, bold=True)
    canvas.text(width - 12, middle, right, 11, theme.text, anchor="right")
