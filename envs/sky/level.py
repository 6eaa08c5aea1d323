"""How much of the sky a scenario leaves: kinds of street, and how well the corrections arrive."""

from __future__ import annotations

from lanebound.integrity.config import Config, Field
from lanebound.integrity.navigator import NavigatorConfig
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sky.city import CityConfig, SectionConfig, SectionKind

__all__ = ["SKY_LEVELS", "SkyLevel"]

SKY_LEVELS = ("open", "suburban", "urban", "dense")


class SkyLevel(Config):
    """A grade of difficulty for positioning, the same for any lane network.

    >>> SkyLevel.named("urban").navigator().corrections.outage_per_h > 0.0
    True
    """

    city: CityConfig = Field(
        CityConfig(sections=(SectionConfig(kind=SectionKind.OPEN),)), description="what lines the streets, in order"
    )
    corrections: CorrectionsConfig = Field(CorrectionsConfig(), description="the reference link and its outages")
    follow_sections: bool = Field(
        True, description="use the stretches that a world names itself; the level's own elsewhere"
    )

    @classmethod
    def named(cls, name: str) -> SkyLevel:
        """A packaged level: ``open``, ``suburban``, ``urban`` or ``dense``; or the full name of another preset."""
        return cls.preset(f"skies/{name}" if name in SKY_LEVELS else name)

    def navigator(self, base: NavigatorConfig | None = None) -> NavigatorConfig:
        """The navigator of ``base``, or of the defaults, with this level's corrections."""
        return (base or NavigatorConfig()).replace(corrections=self.corrections.to_dict())
