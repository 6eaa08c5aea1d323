"""Truth against belief: errors, misleading information, how an episode stands. It scores; nothing decides by it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from highway_env.envs.common.abstract import AbstractEnv

from lanebound.envs.config import EnvConfig
from lanebound.envs.records import EgoBelief

__all__ = ["Judge", "Verdict"]

CREEP_MPS = 0.5  # backwards, that no one minds


@dataclass(frozen=True)
class Verdict:
    """What truth says of one policy step.

    Attributes
    ----------
    err_at_m, err_ct_m : estimate less truth along and across the true heading, forward and right positive
    mi : available, and an error above its level but not above its limit; hmi : available, and above its limit (S3 II.C)
    crashed, crashed_now, off_road, wrong_way : state of the true car
    is_success : the episode has ended well: arrived, or lasted with enough progress, unharmed
    yaw_rate_radps : of the true car over the step
    """

    err_at_m: float
    err_ct_m: float
    mi: bool
    hmi: bool
    crashed: bool
    crashed_now: bool
    off_road: bool
    wrong_way: bool
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
        err_at, err_ct = error_m(belief, car)
        mi, hmi = _misleading(belief, err_at, err_ct)
        off_road = self.config.off_road_ends and not bool(car.on_road)
        wrong_way = self._against_s > self.config.wrong_way_s
        against = abs(angle) > 0.5 * math.pi  # our own worlds end at once then
        good = ended and bool(car.on_road) and not (self._crashed or against)
        return Verdict(
            err_at_m=err_at,
            err_ct_m=err_ct,
            mi=mi,
            hmi=hmi,
            crashed=self._crashed,
            crashed_now=crashed_now,
            off_road=off_road,
            wrong_way=wrong_way,
            is_success=good and self._progress_m >= self.config.success_share * self._allowed_m,
            yaw_rate_radps=turn / dt_s if self._begun else 0.0,
        )


def error_m(belief: EgoBelief, car: object) -> tuple[float, float]:
    """Estimate less truth along and across the true heading."""
    x, y = belief.position_m - car.position  # type: ignore[attr-defined]
    s, c = math.sin(car.heading), math.cos(car.heading)  # type: ignore[attr-defined]
    return float(c * x + s * y), float(c * y - s * x)


def _misleading(b: EgoBelief, err_at_m: float, err_ct_m: float) -> tuple[bool, bool]:
    mi = hmi = False
    for error, level, limit in ((abs(err_at_m), b.pl_at_m, b.al_at_m), (abs(err_ct_m), b.pl_ct_m, b.al_ct_m)):
        if b.available and level <= limit:
            hmi = hmi or error > limit
            mi = mi or level < error <= limit
    return bool(mi), bool(hmi)
