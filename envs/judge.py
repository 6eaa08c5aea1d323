"""Truth against belief: errors, misleading information, how an episode stands. It scores; nothing decides by it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.config import EnvConfig
from lanebound.envs.records import EgoBelief

__all__ = ["Judge", "Verdict"]

Array = NDArray[np.float64]
Pair = tuple[float, float]
CREEP_MPS = 0.5  # backwards, that no one minds


@dataclass(frozen=True)
class Verdict:
    """What truth says of one policy step.

    Attributes
    ----------
    err_at_m, err_ct_m : estimate less truth along and across the true heading, forward and right positive
    mi, hmi : at any navigation epoch of the step available, and an error above its level but within its limit, or above
        its limit (S3 II.C); an epoch that is hazardous on one axis is no more than that
    hmi_share : share of the step's epochs that were hazardous
    crashed, crashed_now, off_road, wrong_way : state of the true car
    astray_now : in this step it has left the road, or turned against the traffic so that the episode ends
    is_success : the episode has ended well: arrived, or lasted with enough progress, unharmed
    yaw_rate_radps : of the true car over the step
    """

    err_at_m: float
    err_ct_m: float
    mi: bool
    hmi: bool
    hmi_share: float
    crashed: bool
    crashed_now: bool
    off_road: bool
    wrong_way: bool
    astray_now: bool
    is_success: bool
    yaw_rate_radps: float

    @property
    def failed(self) -> bool:
        """Whether the episode ends badly here."""
        return self.crashed or self.off_road or self.wrong_way


class Judge:
    """Keeps score of one episode."""

    def __init__(self, config: EnvConfig, world: AbstractEnv) -> None:
        self.config, self.world = config, world
        self._crashed, self._against_s, self._time_s, self._progress_m, self._allowed_m = False, 0.0, 0.0, 0.0, 0.0
        self._heading, self._begun = float(world.vehicle.heading), False
        self._epochs = self._mi = self._hmi = 0
        self._astray = False

    def glance(self, position_m: Array, levels_m: Pair, limits_m: Pair, available: bool) -> None:
        """Count a navigation epoch: the estimate, and how far it is trusted, against where the car is."""
        mi, hmi = _misleading(error_m(position_m, self.world.vehicle), levels_m, limits_m, available)
        self._epochs, self._mi, self._hmi = self._epochs + 1, self._mi + mi, self._hmi + hmi

    def look(self, belief: EgoBelief, dt_s: float, ended: bool) -> Verdict:
        """The verdict on the step that ends now; ``ended`` when the world itself says that it is over."""
        car = self.world.vehicle
        s, _ = car.lane.local_coordinates(car.position)
        angle = float(car.lane.local_angle(car.heading, s))
        turn, self._heading = math.remainder(float(car.heading) - self._heading, 2.0 * math.pi), float(car.heading)
        if self._begun:
            limit = float(car.lane.speed_limit or car.MAX_SPEED)
            self._progress_m += float(car.speed) * math.cos(angle) * dt_s
            self._allowed_m += limit * dt_s
            backwards = float(car.speed) * math.cos(angle) < -CREEP_MPS or abs(angle) > 0.5 * math.pi
            self._against_s = self._against_s + dt_s if backwards else 0.0
        self._begun = True
        crashed_now, self._crashed = bool(car.crashed) and not self._crashed, self._crashed or bool(car.crashed)
        err_at, err_ct = error_m(belief.position_m, car)
        mi, hmi, epochs = self._mi, self._hmi, max(self._epochs, 1)
        self._epochs = self._mi = self._hmi = 0
        off_road = self.config.off_road_ends and not bool(car.on_road)
        wrong_way = self._against_s > self.config.wrong_way_s
        against = abs(angle) > 0.5 * math.pi  # our own worlds end at once then
        astray = off_road or wrong_way or (ended and against)
        astray_now, self._astray = astray and not self._astray, self._astray or astray
        good = ended and bool(car.on_road) and not (self._crashed or against)
        return Verdict(
            err_at_m=err_at,
            err_ct_m=err_ct,
            mi=mi > 0,
            hmi=hmi > 0,
            hmi_share=hmi / epochs,
            crashed=self._crashed,
            crashed_now=crashed_now,
            off_road=off_road,
            wrong_way=wrong_way,
            astray_now=astray_now,
            is_success=good and self._progress_m >= self.config.success_share * self._allowed_m,
            yaw_rate_radps=turn / dt_s if self._begun else 0.0,
        )


def error_m(position_m: Array, car: Vehicle) -> Pair:
    """Estimate less truth along and across the true heading."""
    x, y = position_m - car.position
    s, c = math.sin(car.heading), math.cos(car.heading)
    return float(c * x + s * y), float(c * y - s * x)


def _misleading(errors_m: Pair, levels_m: Pair, limits_m: Pair, available: bool) -> tuple[bool, bool]:
    """Whether information is misleading or hazardously so, never both; it is neither while it is not available."""
    mi = hmi = False
    for error, level, limit in zip(map(abs, errors_m), levels_m, limits_m, strict=True):
        if available and level <= limit:
            hmi = hmi or error > limit
            mi = mi or level < error <= limit
    return mi and not hmi, hmi
