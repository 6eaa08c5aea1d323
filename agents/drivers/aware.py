"""The integrity-aware driver: its caution follows the protection levels and the predicted sky."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, StatelessDriver
from lanebound.agents.drivers.crossing import crosses
from lanebound.agents.drivers.margins import Levelled, LevelledConfig
from lanebound.agents.drivers.plan import carry_out
from lanebound.agents.drivers.plans import FREE_M, closure_gap
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import ConfigError

__all__ = ["AwareConfig", "IntegrityAware", "make_integrity_aware"]

Array = NDArray[np.float64]
FAR_M = 1e6


class AwareConfig(LevelledConfig):
    """Thresholds for slowing down and stopping."""

    alert_share: float = Field(0.48, gt=0, le=1, description="of the limit while an alert is on; just below what costs")
    permitted_share: float = Field(
        0.96, gt=0, le=1, description="of the permitted speed while an alert is on, where the environment shows it"
    )
    ratio_calm: float = Field(0.6, ge=0, lt=1, description="PL / AL up to which the limit holds [-]; chosen")
    satellites_needed: int = Field(17, ge=0, description="predicted, below which RTK is out in over 3 of 5 cases")
    dead_reckoning_s: float = Field(
        30.0,
        gt=0,
        description="without RTK, or since the start of an alert, until the car stops; on training seeds 12 s saved no "
        "departure and cost a sixth of the return",
    )
    stop_ct_m: float | None = Field(
        None,
        gt=0,
        description="PL_CT under an alert from which the car stops at once; None: it stops by time alone",
    )
    crossing_ct_m: float = Field(
        2.0, ge=0, description="PL_CT below which it does not stop where vehicles cross its way; half a lane"
    )
    grace_s: float = Field(8.0, ge=0, description="longer by this where the open sky is reached within it; chosen")
    link_s: float = Field(1.0, gt=0, description="the same where the sky is open and the link is out; chosen")
    link_age_s: float = Field(2.0, gt=0, description="age of the reference data from which the link counts as out")
    sky_bonus_mps2: float = Field(0.5, ge=0, description="gain of a lane that sees the sky where the own does not")
    closure_bonus_mps2: float = Field(1.0, ge=0, description="gain of leaving a lane that is known to close; chosen")


class IntegrityAware(Levelled):
    """RSS with protection levels: slower with them and before known outages, and prefers lanes with an open sky.

    The speed falls from the limit at ``PL / AL = ratio_calm`` to a share of it at 1; the larger ratio counts. Before
    a stretch where two points in a row of the predicted sky have too few satellites it brakes to that share,
    ``v^2 <= v_alert^2 + 2 b d``. The minimal-risk manoeuvre on an alert: that share of the limit, no lane change, and a
    stop when dead reckoning, or the alert, has lasted its time (the last position of a service may be new, and its
    level beyond the limit all the time). That time is short where only the link is out, because an outage of the link
    ends while the car waits. It is longer where the car soon reaches the open sky. In between the car does not slow
    down further: errors across the track grow with time, about 0.1 m/s at any speed above walking pace, so that a
    blocked stretch of D metres adds more error at a lower speed (a gyro's bias b adds ``b D^2 / 2 v``).

    Where a camera keeps the lane, levels say which roads are possible. It then keeps to the least limit of these,
    without a stop under an alert; changes of lanes for the goal wait under an alert, and while possible roads ask for
    different ones, until they must be made.
    """

    NEEDED: ClassVar[Sequence[str]] = (
        *Levelled.NEEDED,
        "integrity.alert",
        "integrity.alert_age",
        "integrity.corrections_age",
        "integrity.ratio_at",
        "integrity.ratio_ct",
        "integrity.since_rtk",
    )
    config: AwareConfig

    def __init__(self, env: DrivingEnv, config: AwareConfig) -> None:
        super().__init__(env, config)
        most = self.reader.scale("integrity.pl_ct")
        if config.stop_ct_m is not None and config.stop_ct_m > most:
            raise ConfigError(
                f"stop_ct_m must be <= {most:g}, the largest level in the observation, got {config.stop_ct_m:g}: lower "
                "it, or raise observation.pl_max_m"
            )

    def free_speed(self, observation: Observation) -> Array:
        """Speed that route, levels, predicted sky and alert allow."""
        c, reader = self.config, self.reader
        route = super().free_speed(observation)
        limit = reader.value(observation, "road.speed_limit")
        slow = c.alert_share * np.where(limit < reader.scale("road.speed_limit"), limit, c.speed_mps)
        if self.reader.config.roads:
            return np.minimum(route, reader.value(observation, "integrity.possible_limit"))
        worst = np.maximum(
            reader.value(observation, "integrity.ratio_at"), reader.value(observation, "integrity.ratio_ct")
        )
        share = np.clip((1.0 - worst) / (1.0 - c.ratio_calm), 0.0, 1.0)
        wanted = np.minimum(route, slow + share * np.maximum(route - slow, 0.0))
        wanted = np.minimum(wanted, np.sqrt(slow**2 + 2.0 * c.brake_mps2 * self._outage(observation)))
        alert = reader.value(observation, "integrity.alert") > 0.5
        over = self._overdue(observation, slow)
        wanted = np.where(alert, np.minimum(wanted, self._permitted(observation, slow)), wanted)
        return np.where(alert & over, 0.0, wanted)

    def _permitted(self, observation: Observation, slow_mps: Array) -> Array:
        """Speed under an alert: by the level where the environment shows it, else the share of the limit."""
        if not self.reader.config.permitted_speed:
            return slow_mps
        return self.config.permitted_share * self.reader.value(observation, "integrity.permitted_speed")

    def _overdue(self, observation: Observation, slow_mps: Array) -> NDArray[np.bool_]:
        """Where RTK has been missing for too long and no open sky is near, or the level across is too large."""
        c, value = self.config, self.reader.value
        since = np.maximum(value(observation, "integrity.since_rtk"), value(observation, "integrity.alert_age"))
        unlinked = value(observation, "integrity.corrections_age") > c.link_age_s
        sky = self._sky(observation, "own")
        enough = (sky[..., :1] >= c.satellites_needed - 0.5).any(axis=-1)
        out_s = self._open(observation) / slow_mps
        reaches = ~enough & (out_s <= c.grace_s) & (since <= c.dead_reckoning_s + c.grace_s)
        late = np.where(unlinked & enough, since > c.link_s, (since > c.dead_reckoning_s) & ~reaches)
        level = value(observation, "integrity.pl_ct")
        late &= (level >= c.crossing_ct_m) | ~crosses(self.reader, observation, self.giving_way)
        return late if c.stop_ct_m is None else late | (level >= c.stop_ct_m)

    def _open(self, observation: Observation) -> Array:
        """Distance to where two points in a row have enough satellites [m]; far without any."""
        return self._first_pair(self._sky(observation, "own") >= self.config.satellites_needed - 0.5)

    def _first_pair(self, points: NDArray[np.bool_]) -> Array:
        """Distance to the first two points of the predicted sky in a row that are True [m]; far without any."""
        nearest = np.full(points.shape[:-1], FAR_M)
        for i, (d, _) in reversed(list(enumerate(pairwise(self.reader.config.satellites_m)))):
            nearest = np.where(points[..., i] & points[..., i + 1], d, nearest)
        return nearest

    def waits(self, observation: Observation) -> NDArray[np.bool_]:
        """Under an alert; where possible roads ask for different lanes as well."""
        waits = self.reader.value(observation, "integrity.alert") > 0.5
        if self.reader.config.roads:
            waits |= self.reader.value(observation, "integrity.roads_agree") < 0.5
        return waits

    def bonus(self, observation: Observation) -> tuple[Array | float, Array | float]:
        """For each side the share of the points ahead with enough satellites there and too few on the own lane.

        Where the own lane is known to close, also what makes the car leave it at once: under an alert it could not.
        """
        own = self._dark(observation, "own")
        sides = [own & ~self._dark(observation, s) & self._seen(observation, s) for s in ("left", "right")]
        left, right = (self.config.sky_bonus_mps2 * side.sum(axis=-1) for side in sides)
        if not self.reader.config.closure:
            return left, right
        early = self.config.closure_bonus_mps2 * (closure_gap(self.reader, observation) < FREE_M)
        return left + early, right + early

    def _outage(self, observation: Observation) -> Array:
        """Distance to the next known outage [m]; far without one."""
        return self._first_pair(self._dark(observation, "own"))

    def _dark(self, observation: Observation, lane: str) -> NDArray[np.bool_]:
        """Where fewer satellites are predicted than needed, (..., D); not where nothing is predicted."""
        return self._seen(observation, lane) & (self._sky(observation, lane) < self.config.satellites_needed - 0.5)

    def _seen(self, observation: Observation, lane: str) -> NDArray[np.bool_]:
        return self._sky(observation, lane) >= 0.0

    def _sky(self, observation: Observation, lane: str) -> Array:
        points = self.reader.config.satellites_m
        if not points:
            return np.zeros((*self.reader.value(observation, "ego.speed").shape, 0))
        return np.stack([self.reader.value(observation, f"road.sky_{d:g}m_{lane}") for d in points], axis=-1)


def make_integrity_aware(env: DrivingEnv, config: AwareConfig | None = None) -> StatelessDriver:
    """The integrity-aware driver."""
    return carry_out(env, IntegrityAware(env, config or AwareConfig()))
