"""Drivers with margins: the protection levels, or constant ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, StatelessDriver
from lanebound.agents.drivers.nominal import Nominal
from lanebound.agents.drivers.plan import carry_out
from lanebound.agents.drivers.plans import CruiseConfig, following_acceleration
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Config, Field

__all__ = ["Cautious", "CautiousConfig", "Rss", "RssConfig", "TunedCaution", "make_cautious", "make_rss", "rss_speed"]

Array = NDArray[np.float64]


class RssConfig(CruiseConfig):
    """Parameters of Responsibility-Sensitive Safety, as in the costs of the environments."""

    rss_response_s: float = Field(0.5, gt=0, description="rho; Shalev-Shwartz 2017")
    rss_accelerate_mps2: float = Field(2.0, ge=0, description="acceleration during the response; RSS, comfort")
    rss_brake_min_mps2: float = Field(4.0, gt=0, description="braking that the ego always reaches; IEEE 2846 survey")
    rss_brake_max_mps2: float = Field(6.0, gt=0, description="braking of the leader at most; dry road")


class CautiousConfig(CruiseConfig):
    """Constant margins; :class:`TunedCaution` has those that were tuned on training seeds."""

    gap_m: float = Field(3.0, ge=0, description="taken off every gap; PL_AT of two cars a few seconds into an outage")
    speed_share: float = Field(0.8, gt=0, le=1, description="share of the speed that the route allows [-]; chosen")
    lane_m: float = Field(0.3, ge=0, description="the own lane counts as wider by this on each side; chosen")
    link_m: float = Field(
        10.0, gt=0, description="across, from which a link is excluded, where charges are decided; chosen"
    )


class TunedCaution(Config):
    """Margins tuned for worlds and skies by ``lanebound tune cautious``."""

    at: Mapping[str, Mapping[str, CautiousConfig]] = Field({}, description="by base of the world and sky")

    def of(self, world: EnvConfig) -> CautiousConfig:
        """The margins for an environment: those tuned there, or the defaults."""
        return self.at.get(world.base, {}).get(world.sky, CautiousConfig())


def rss_speed(s: Array, lead_mps: Array, c: RssConfig) -> Array:
    """Fastest speed at which a gap is the longitudinal distance of RSS (Shalev-Shwartz et al. 2017, definition 1).

    ``s = v rho + a rho^2 / 2 + (v + a rho)^2 / (2 b_min) - v_lead^2 / (2 b_max)``, solved for v; 0 at least.
    """
    rho, a, b = c.rss_response_s, c.rss_accelerate_mps2, c.rss_brake_min_mps2
    room = np.maximum(s + 0.5 * a * rho**2 + 0.5 * lead_mps**2 / c.rss_brake_max_mps2, 0.0)
    return np.asarray(np.maximum(np.sqrt((b * rho) ** 2 + 2.0 * b * room) - b * rho - a * rho, 0.0))


class Rss(Nominal):
    """Nominal, with gaps reduced by the protection levels of both vehicles, and at most at the speed of RSS.

    A missing level counts as the largest that observations show.
    """

    NEEDED: ClassVar[Sequence[str]] = (*Nominal.NEEDED, "integrity.pl_at")
    config: RssConfig

    def margins(self, observation: Observation) -> tuple[Array | float, Array | float]:
        """The combined level along the track."""
        return self.reader.rows(observation, "pl_at") if self.reader.config.vehicles else 0.0, 0.0

    def own_margin(self, observation: Observation) -> Array | float:
        """The level along the track."""
        return self.reader.value(observation, "integrity.pl_at")

    def acceleration(self, observation: Observation) -> Array:
        """As nominal; above the safe speed it brakes so that the excess is gone within the response time."""
        c, v = self.config, self.reader.value(observation, "ego.speed")
        s, lead = self.lead(observation)
        follow = following_acceleration(v, self.wanted_speed(observation), s, lead, c)
        proper = (rss_speed(s, lead, c) - v) / c.rss_response_s
        return np.asarray(np.maximum(np.minimum(follow, proper), -c.brake_max_mps2))

    def top_speed(self, observation: Observation) -> Array:
        """As nominal, and RSS."""
        return np.minimum(super().top_speed(observation), rss_speed(*self.lead(observation), self.config))


class Cautious(Nominal):
    """Nominal with less speed, larger gaps and a wider own lane; without integrity."""

    config: CautiousConfig

    def margins(self, observation: Observation) -> tuple[Array | float, Array | float]:
        """The constant margins."""
        return self.config.gap_m, self.config.lane_m

    def own_margin(self, observation: Observation) -> Array | float:
        """The constant margin."""
        return self.config.gap_m

    def link_margin(self, observation: Observation) -> Array | float:
        """The constant margin."""
        return self.config.link_m

    def free_speed(self, observation: Observation) -> Array:
        """A share of the speed of the route."""
        return self.config.speed_share * super().free_speed(observation)


def make_rss(env: DrivingEnv, config: RssConfig | None = None) -> StatelessDriver:
    """The driver of RSS with protection levels."""
    return carry_out(env, Rss(env, config or RssConfig()))


def make_cautious(env: DrivingEnv, config: CautiousConfig | None = None) -> StatelessDriver:
    """The driver with constant margins: without a configuration those tuned for this world and sky, if any."""
    return carry_out(env, Cautious(env, config or TunedCaution.preset("drivers/cautious").of(env.config)))
