"""Options of the rendering."""

from __future__ import annotations

from enum import StrEnum

from lanebound.integrity.core.config import Config, Field

__all__ = ["Orientation", "RenderingConfig", "ThemeName"]


class Orientation(StrEnum):
    """Direction of the top edge of the map."""

    HEADING_UP = "heading_up"
    NORTH_UP = "north_up"


class ThemeName(StrEnum):
    """The two sets of colours."""

    DARK = "dark"
    LIGHT = "light"


class RenderingConfig(Config):
    """Size, scale and style of a rendered frame; the defaults are suitable for a README and a video."""

    width_px: int = Field(960, ge=320, le=7680, description="width of the picture [px]")
    height_px: int = Field(540, ge=240, le=4320, description="height of the picture [px]")
    scale_px_per_m: float = Field(8.0, gt=0.2, le=100, description="zoom of the map [px/m]; a car is then 40 px long")
    orientation: Orientation = Field(Orientation.HEADING_UP, description="direction of the top edge of the map")
    theme: ThemeName = Field(ThemeName.DARK, description="dark or light colours")
    panel: bool = Field(True, description="instruments on the right: status, sky, error box and strip charts")
    legend: bool = Field(True, description="legend of the colours at the bottom of the map")
    supersampling: int = Field(2, ge=1, le=4, description="factor of anti-aliasing [-]")
    window_s: float = Field(30.0, gt=1, le=600, description="time range of the strip charts")

    @property
    def map_width_px(self) -> int:
        """Width of the map without the panel [px]."""
        return self.width_px - self.panel_width_px

    @property
    def panel_width_px(self) -> int:
        """Width of the panel [px]; 0 if it is switched off or would leave less than half of the width to the map."""
        return PANEL_WIDTH_PX if self.panel and self.width_px >= 2 * PANEL_WIDTH_PX else 0


PANEL_WIDTH_PX = 300
