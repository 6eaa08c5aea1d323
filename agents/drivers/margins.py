"""Drivers with margins: the protection levels, or constant ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, StatelessDriver
from lanebound.agents.drivers.mobil import neighbours
from lanebound.agents.drivers.nominal import Nominal
from lanebound.agents.drivers.plan import carry_out
from lanebound.agents.drivers.plans import CruiseConfig, following_acceleration, safe_speed
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Config, Field

__all__ = ["Cautious", "CautiousConfig", "Levelled", "LevelledConfig", "Rss", "RssConfig", "TunedCaution",
           "make_cautious", "make_rss", "rss_speed"]  # fmt: skip

Array = NDArray[np.float64]


class RssConfig(CruiseConfig):
    """Parameters of Responsibility-Sensitive Safety, as in the costs of the environments."""

    rss_response_s: float = Field(0.5, gt=0, description="rho; Shalev-Shwartz 2017")
    rss_accelerate_mps2: float = Field(2.0, ge=0, description="acceleration during the response; RSS, comfort")
    rss_brake_min_mps2: float = Field(4.0, gt=0, description="braking that the ego always reaches; IEEE 2846 survey")
    rss_brake_max_mps2: float = Field(6.0, gt=0, description="braking of the leader at most; dry road")


class LevelledConfig(RssConfig):
    """Bounds of the reaction to levels."""

    slow_mps2: float = Field(4.0, gt=0, description="braking for an alert at most; as in RSS")
    settled_mps: float = Field(0.2, gt=0, description="excess over a target speed at which it counts as driven")
    follower_s: float = Field(3.0, ge=0, description="time gap up to which a follower counts; chosen")
    lane_extra_m: float = Field(
        3.0,
        ge=0,
        description="the own lane is widened by PL_CT, by this at most; broadcasts can be a lane off",
    )
    cross_extra_m: float = Field(0.5, ge=0, description="crossing vehicles are widened by PL_AT, by this at most")
    decide_m: float = Field(
        130.0,
        gt=0,
        description="to the end of the road for each change of lanes for a goal: farther away it waits while possible "
        "roads ask for different ones; 4.7 s at 27.8 m/s, chosen",
    )


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


class Levelled(Rss):
    """RSS with the levels of both vehicles on both axes, and no harder braking for them than followers expect."""

    NEEDED: ClassVar[Sequence[str]] = (*Rss.NEEDED, "integrity.pl_ct")
    config: LevelledConfig

    def margins(self, observation: Observation) -> tuple[Array | float, Array | float]:
        """The combined levels, across the track up to a bound."""
        if not self.reader.config.vehicles:
            return 0.0, 0.0
        across = np.minimum(self.reader.rows(observation, "pl_ct"), self.config.lane_extra_m)
        return self.reader.rows(observation, "pl_at"), across

    def widening(self, observation: Observation) -> Array | float:
        """The combined level along the track, up to a bound."""
        if not self.reader.config.vehicles:
            return 0.0
        return np.minimum(self.reader.rows(observation, "pl_at"), self.config.cross_extra_m)

    def link_margin(self, observation: Observation) -> Array | float:
        """The level across the track; a level that the observation cannot show excludes no link."""
        level = self.reader.value(observation, "integrity.pl_ct")
        return np.where(level < self.reader.scale("integrity.pl_ct"), level, np.inf)

    def acceleration(self, observation: Observation) -> Array:
        """Brakes as hard as nominal for the estimate alone, and within a bound for levels, sky and alert."""
        c, v = self.config, self.reader.value(observation, "ego.speed")
        careful = super().acceleration(observation)
        plain = self.giving(observation, super().free_speed(observation))
        bare = following_acceleration(v, plain, *self.lead(observation, margins=False), c)
        return np.minimum(bare, np.maximum(careful, -c.slow_mps2))

    def top_speed(self, observation: Observation) -> Array:
        """As RSS; before a follower, levels take the next target speed only when the present one is driven.

        The speed control of meta-actions approaches a target with a time constant of 0.6 s; a level each decision would
        brake with 10 m/s2 in Highway, and a follower that reacts late hits the car.
        """
        careful = super().top_speed(observation)
        if not self._targets_mps.size:
            return careful
        read, c = self.reader.value, self.config
        v, target = read(observation, "ego.speed"), read(observation, "ego.target_speed")
        follower = neighbours(self.reader, observation, 0).follower_gap_m
        still = (v > target + c.settled_mps) & (follower < c.follower_s * v)
        if not still.any():
            return careful
        free = self.giving(observation, super().free_speed(observation))
        bare = np.minimum(free, safe_speed(*self.lead(observation, margins=False), c))
        return np.where(still, np.maximum(careful, np.minimum(bare, target)), careful)

    def waits(self, observation: Observation) -> NDArray[np.bool_]:
        """Where no lane is changed; for a goal it is until it must be."""
        return np.zeros(self.reader.value(observation, "ego.speed").shape, dtype=np.bool_)

    def change(self, observation: Observation) -> NDArray[np.int64]:
        """As nominal; none while it waits."""
        value, waits = self.reader.value, self.waits(observation)
        if self.reader.config.roads:
            seen = 0.95 * self.reader.scale("road.junction")  # a farther end of the road is not seen
            left = np.minimum(self.config.decide_m * np.abs(value(observation, "road.route_shift")), seen)
            waits &= value(observation, "road.junction") > left
        return np.where(waits, 0, super().change(observation))


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
