"""Levels of difficulty for positioning: kinds of street, and quality of the reference link."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.integrity.core.config import Config, Field, deep_merge
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import FILES, load_file, preset_names
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sky.city import CityConfig, SectionConfig, SectionKind
from lanebound.integrity.sky.survey import MapConfig

__all__ = ["RECORDING", "SKIES", "SKY_LEVELS", "SkyLevel"]

FOLDER = "skies/"
SKY_LEVELS = ("open", "suburban", "urban", "dense")
"""Levels of difficulty, the easiest first."""
_PRESETS = [name.removeprefix(FOLDER) for name in preset_names() if name.startswith(FOLDER)]
SKIES = (*SKY_LEVELS, *(name for name in _PRESETS if name not in SKY_LEVELS))
"""Short names of all packaged skies: the levels, and the other presets of ``configs/skies/``."""
RECORDING = (".csv", ".csv.gz")  # how names of recorded skies end
LENGTH_FACTORS = 0.5, 1.5  # of a section, uniform: as facades and blocks of a street differ; chosen
# Between cities of one level, up to 2 sigma; chosen: a seventh of log(20.6 m / 7.1 m), the distance of Westminster from
# Guildford, which are of two levels (Tzaras et al. 1998, as in integrity.sky.city).
HEIGHT_LOG_SD = 0.15
HEIGHT_SPREADS = 0.27, 0.44  # log sd of the heights in a city: Guildford to Westminster
WIDTH_FACTORS = 0.8, 1.25  # of the least distance of facades; chosen
MATERIAL_COUNT = 20.0  # concentration of the Dirichlet law of shares; chosen: a share of 0.4 has a 1 sigma of 0.11
AS_RECORDED = "urban"  # the level whose link and instruments go with a recorded sky


class SkyLevel(Config):
    """A level of difficulty for positioning, for any lane network.

    >>> SkyLevel.named("urban").navigator().corrections.outage_per_h > 0.0
    True
    """

    city: CityConfig = Field(
        CityConfig(sections=(SectionConfig(kind=SectionKind.OPEN),)), description="what lines the streets, in order"
    )
    street_width_m: float = Field(
        24.0,
        ge=0,
        le=200,
        description="facades stand at least so far apart, so that narrow roads are no darker; chosen",
    )
    material_shares: tuple[float, float, float, float] = Field(
        (0.4, 0.2, 0.35, 0.05),
        description="shares of buildings with facades of concrete, glass, brick and metal; chosen, not measured",
    )
    map: MapConfig = Field(MapConfig(), description="the city as mapped, by which satellites are predicted")
    corrections: CorrectionsConfig = Field(CorrectionsConfig(), description="the reference link and its outages")
    max_age_s: float = Field(
        2.0, gt=0, le=60, description="oldest usable corrections; a rover in town, whose link sends every second"
    )
    instruments: Mapping[str, Any] = Field(
        {}, description="what NavigatorConfig differs by in such streets: instruments and what is declared of them"
    )
    follow_sections: bool = Field(
        True, description="use the stretches that a world names itself; the level's own elsewhere"
    )

    recording: str | None = Field(
        None, description="a recorded sky to be played in place of a made-up city; a file of lanebound record-sky"
    )

    def streets_along(self, road_width_m: float) -> CityConfig:
        """The city configuration for a road of this width; setbacks too small for ``street_width_m`` are increased."""
        least = 0.5 * (self.street_width_m - road_width_m)
        kinds = {kind: self.city.street(kind) for kind in SectionKind}
        streets = {kind: street.replace(setback_m=max(street.setback_m, least)) for kind, street in kinds.items()}
        return CityConfig(sections=self.city.sections, streets=streets)

    def of_city(self, seed: int) -> SkyLevel:
        """The level with the streets of one city, drawn about its own from the stream ``character`` of a seed.

        Drawn are the order and the lengths of the sections, one factor on all median heights, the spread of heights,
        the width of streets and the shares of materials. The kinds of streets, and the mean share of the road that
        each has, are those of the level: so an urban city stays one.
        """
        rng, own = named_generator(seed, "character"), self.city
        order, stretched = rng.permutation(len(own.sections)), rng.uniform(*LENGTH_FACTORS, len(own.sections))
        higher = float(np.exp(HEIGHT_LOG_SD * np.clip(rng.standard_normal(), -2.0, 2.0)))
        spread, wider = float(rng.uniform(*HEIGHT_SPREADS)), float(rng.uniform(*WIDTH_FACTORS))
        shares = rng.standard_gamma(MATERIAL_COUNT * np.array(self.material_shares))
        sections = [
            own.sections[k].replace(length_m=max(float(factor) * own.sections[k].length_m, 10.0))
            for k, factor in zip(order.tolist(), stretched, strict=True)
        ]
        streets = {
            kind: street.replace(height_median_m=min(higher * street.height_median_m, 500.0), height_log_sd=spread)
            for kind in SectionKind
            if (street := own.street(kind)).height_median_m > 0.0
        }
        return self.replace(
            city=CityConfig(sections=sections, streets={**own.streets, **streets}).to_dict(),
            street_width_m=min(wider * self.street_width_m, 200.0),
            material_shares=tuple((shares / shares.sum()).tolist()),
        )

    @classmethod
    def named(cls, name: str) -> SkyLevel:
        """Load a packaged sky by its short name, one of ``SKIES``, or by the full name of its preset (``skies/urban``).

        A ``.csv`` file is a recorded sky, used with the link and the instruments of ``urban``. A ``.yaml`` file is a
        level of the user and can contain ``extends: skies/urban``.

        Raises
        ------
        ConfigError
            An unknown preset or file, or a refused value in it.
        """
        if name.endswith(FILES):
            return cls.load(load_file(Path(name), "sky", "sky_level"), name)
        if name.endswith(RECORDING):
            if not Path(name).is_file():
                raise ConfigError(
                    f"sky must name a file, got {name!r}, which is none: make it by 'lanebound record-sky'"
                )
            return cls.named(AS_RECORDED).replace(recording=name)
        return cls.preset(f"{FOLDER}{name}" if name in SKIES else name)

    def navigator(self, base: NavigatorConfig | None = None) -> NavigatorConfig:
        """The navigator configuration ``base`` (or the default) with reference link and instruments of this level."""
        link = {"corrections": self.corrections.to_dict(), "positioning": {"rtk": {"max_age_s": self.max_age_s}}}
        return (base or NavigatorConfig()).replace(**deep_merge(link, self.instruments))
