"""A safety filter over any driver: control barrier functions with protection levels as the bound of the state's error.

Discrete-time barriers (Agrawal and Sreenath 2017), ``h(next) >= (1 - gamma) h(now)``, with the command that is nearest
to the driver's. Acceleration and steering have one pair of bounds each, so that clipping solves the quadratic
programme.

The barrier of following is measurement-robust (Dean et al. 2020, Cosner et al. 2021): it holds for every gap, speed of
the ego and speed of the leader within their bounds, and is verified against the truth. The barrier of the lane is not
robust: it holds for the believed offset with the present PL_CT subtracted from the free width, and treats the believed
heading, curvature and steering as true. A heading error d moves ``q`` by ``v t d``, PL_CT may grow until the next
decision, and the belief may move: these are not bounded, so that nothing is claimed or verified for the lane. In 1 of
100 decisions headings are wrong by more than 0.02 rad under a dense sky and 0.04 rad under an urban one (training seeds
1004-1007), 0.2 to 0.4 m at 11 m/s and the preview: a lane of 3.25 m has no room for such a bound.

Bends have a barrier of speed, ``v^2 <= share a_lat / |kappa(d)| + 2 b (d - PL_AT)`` at each preview, so that the
steering of the lane barrier stays within the grip. Without it the steering of a car that is too fast leaves the road.

Symbols: v and u speed now and next [m/s], s gap [m], T length of a policy step [s], b and B braking of ego and leader,
e offset [m], psi heading less its steady value in the bend, beta angle of the velocity less that value, L wheelbase.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import field_validator

from lanebound.agents.drivers.base import Driver, Observation, Starts, States
from lanebound.agents.drivers.lane_barrier import LaneBarrier, LaneBarrierConfig
from lanebound.agents.drivers.leaders import counted, expected_m, in_way
from lanebound.agents.drivers.plans import EGO_LENGTH_M
from lanebound.agents.drivers.shares import share_of, value_of
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import ConfigError, InputError

__all__ = ["BarrierConfig", "BarrierFilter", "CbfConfig", "make_cbf"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
NEEDED = (
    "ego.speed", "ego.lateral_offset", "road.speed_limit", "integrity.pl_at", "integrity.pl_ct", "integrity.alert"
)  # fmt: skip
EPS = 1e-6


class BarrierConfig(LaneBarrierConfig):
    """Bounds that the guarantee of the filter assumes, and how early it acts."""

    brake_mps2: float = Field(5.0, gt=0, description="b, braking that the ego is sure to reach; dry road")
    lead_brake_mps2: float = Field(6.0, gt=0, description="B >= b, hardest braking of the leader; RSS, dry road")
    standstill_m: float = Field(1.0, ge=0, description="gap when both vehicles have stopped; chosen")
    response_s: float = Field(0.1, ge=0, description="tau, reserve beyond the known ages; an epoch, chosen")
    speed_error_mps: float = Field(0.25, ge=0, description="odometer's error at most; 5 sigma of 0.05 m/s")
    speed_share: float | None = Field(
        None, ge=0, description="and of its scale [-]; None: as declared, dead_reckoning.odometer_scale, 4.5 sigma"
    )
    lag_s: float = Field(0.06, ge=0, description="half an epoch of 0.1 s, and slip of 1e-3 s2/m at 10 m/s")
    creep_mps: float = Field(0.15, ge=0, description="lower speeds are not measured; inductive odometers")
    growth_mps: float = Field(
        2.0,
        ge=0,
        description="growth of PL_AT of both together; 99 % of decisions lie below, also in an outage's first 3 s; "
        "urban and dense, training seeds 1000-1029 and 1300-1311",
    )
    lane_extra_m: float = Field(
        20.0, ge=0, description="the lane is widened by PL_CT, by this at most; the largest shown"
    )
    slow_share: float = Field(0.48, gt=0, le=1, description="of the limit, while the lane is kept with slack")
    slow_mps2: float = Field(2.0, gt=0, description="braking down to that; comfortable")
    speed_mps: float = Field(14.0, gt=0, description="limit where the map gives none; 50 km/h")


class CbfConfig(BarrierConfig):
    """The filter, and the agent that it filters."""

    over: str = Field("nominal", min_length=1, description="agent whose commands are filtered, any but cbf itself")

    @field_validator("over")
    @classmethod
    def _is_another(cls, over: str) -> str:
        if over == "cbf":
            raise ConfigError("over must be another agent than cbf, got cbf: choose nominal or integrity_aware, say")
        return over


class BarrierFilter(LaneBarrier):
    """Passes the command of a driver, or the nearest command that is safe.

    Following has priority. Where no acceleration is safe it brakes fully, ``-b``: then ``h`` of the true state grows,
    so that it stays positive. Vehicles that are believed ahead count, and a leader of the last decision that is now
    believed level or behind while its level reaches over the ego (:mod:`.leaders`); a vehicle that was never believed
    ahead does not count, which is an assumption. The guarantee, a true ``h >= 0``, does not depend on ``growth_mps``,
    which only makes full braking rare where levels have grown, or the belief has moved within them. The lane comes
    second: where the levels leave no room it is kept with slack, as near to its middle as a floor allows, and the car
    slows to a share of the limit; where the wheel does not reach the safe angles, it turns to the nearest one.

    Parameters
    ----------
    env : of continuous actions that include acceleration
    driver : any policy

    Attributes
    ----------
    speed_share : bound of the error of the odometers' scale [-], from this configuration or that of navigation
    commanded_mps2 : acceleration of the last decision, by which the speed has changed since the odometer's epoch
    followed : whether a vehicle counted as leader in the last decision
    counts : ``decisions``; number of those where ``following`` and ``lane`` changed the command or had no safe one,
        where a ``bend`` required braking, and where the lane was kept with slack; ``infeasible`` and ``relaxed``,
        decisions with any of either

    Raises
    ------
    InputError
        The actions are not continuous, or the observation shows no protection levels.
    """

    config: BarrierConfig

    def __init__(self, env: DrivingEnv, driver: Driver, config: BarrierConfig | None = None) -> None:
        if not (isinstance(env.action_space, spaces.Box) and env.world.action_type.longitudinal):
            raise InputError("action must be continuous with acceleration for a barrier, got others: choose another id")
        super().__init__(env, BarrierConfig() if config is None else config)
        self.driver = driver
        self.reader.require(NEEDED)
        share = self.config.speed_share
        self.speed_share = _declared_scale(env) if share is None else share
        self._tick_s = 1.0 / env.config.simulation_hz
        self.commanded_mps2: Array | float = 0.0
        self.followed: Bools = np.zeros((), dtype=np.bool_)
        self._expected_m: Array | float = np.nan
        self._behind: Array | float = 0.0
        self._behind_m: Array | float = 0.0
        self.counts: Counter[str] = Counter()

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], States]:
        """The filtered action, and the driver's own state."""
        action, after = self.driver.predict(observation, state, episode_start, deterministic)
        if episode_start is not None:
            self.begin(episode_start.reshape(np.shape(action)[:-1]))
        shares = np.array(action, dtype=np.float64)
        bounds = self._inner.acceleration_range
        wanted = value_of(shares[..., 0], bounds)
        top, stuck = self.acceleration_bound(observation)
        self.remember(observation)
        lane_top = np.asarray(np.inf)
        if self._inner.lateral:
            bends = self.bends(observation)
            self.pass_bend(observation, bends[0][1])
            lane_top = np.minimum(self._slowing(observation), self.bend_bound(observation, bends))
        self.counts["decisions"] += wanted.size
        self._count("following", top < wanted - EPS, stuck)
        commanded = np.clip(np.minimum(np.minimum(wanted, top), lane_top), *bounds)
        shares[..., 0], self.commanded_mps2 = share_of(commanded, bounds), commanded
        none, slack = stuck, np.zeros_like(stuck)
        if self._inner.lateral:
            shares[..., 1], slack, lost = self._steered(observation, shares[..., 1])
            none = stuck | lost
        self.counts.update({"infeasible": int(np.sum(none)), "relaxed": int(np.sum(slack))})
        return shares.astype(np.float32), after

    def begin(self, starts: Bools) -> None:
        """Clear the memory where an episode starts.  (...)."""
        if np.all(starts):  # their number may have changed
            self.commanded_mps2, self._expected_m = 0.0, np.nan
            self._behind, self._behind_m = 0.0, 0.0
            return
        self.commanded_mps2 = np.where(starts, 0.0, self.commanded_mps2)
        self._expected_m = np.where(starts, np.nan, self._expected_m)
        self._behind, self._behind_m = np.where(starts, 0.0, self._behind), np.where(starts, 0.0, self._behind_m)

    def reseed(self, seed: int) -> None:
        """Pass an episode's seed to a driver with random draws."""
        if hasattr(self.driver, "reseed"):
            self.driver.reseed(seed)

    def remember(self, observation: Observation) -> None:
        """Store the expected gap of the leader at the next decision; it identifies a leader that is believed behind."""
        if self.reader.config.vehicles:
            ahead = self.ahead(observation)
            self.followed = np.asarray(ahead.any(axis=-1))
            self._expected_m = expected_m(self.reader, observation, ahead, self._dt_s)

    def ahead(self, observation: Observation) -> Bools:
        """Which vehicles count as leaders, (..., K)."""
        way = in_way(self.reader, observation, self.config.lane_extra_m)
        return counted(self.reader, observation, way, self._expected_m)

    def fastest(self, speed_mps: Any, acceleration_mps2: Any) -> Any:
        """The largest speed of the ego for a measured one, the mean of the last epoch [m/s]."""
        c, gain = self.config, np.maximum(acceleration_mps2, 0.0)
        return speed_mps + c.speed_error_mps + self.speed_share * abs(speed_mps) + c.lag_s * gain

    def slowest(self, speed_mps: Any, age_s: Any) -> Any:
        """The least speed of a leader that has braked as hard as possible since its broadcast [m/s]."""
        c = self.config
        return np.maximum(speed_mps - self._speed_bound(speed_mps) - c.lead_brake_mps2 * age_s, 0.0)

    def least_mps(self, speed_mps: Any) -> Any:
        """The least speed of a leader at the time of its broadcast [m/s]."""
        return np.maximum(speed_mps - self._speed_bound(speed_mps), 0.0)

    def strayed(self, speed_mps: Any, age_s: Any) -> Any:
        """How far a leader may be from the place that its broadcast speed predicts, beyond its level [m]."""
        return self._speed_bound(speed_mps) * age_s

    def _speed_bound(self, speed_mps: Any) -> Any:
        c = self.config
        return c.speed_error_mps + self.speed_share * abs(speed_mps) + c.lag_s * c.lead_brake_mps2

    def acceleration_bound(self, observation: Observation) -> tuple[Array, Bools]:
        """Largest safe acceleration [m/s2], and where full braking does not satisfy the barrier either.

        ``h = s - PL + v_lead^2 / 2B - s0 - v tau - v^2 / 2b``, every quantity at the worst end of its bound, with a
        leader that brakes with B from now on (then ``s + v_lead^2 / 2B`` shrinks by the ego's way alone), becomes in a
        step of n dynamic steps dt ``h(u) = h - dPL - way - ...``: ``s - PL - dPL + v_lead^2 / 2B - s0 - v (T + dt) / 2
        - u (T - dt) / 2 - u tau - u^2 / 2b``; the largest u with ``h(u) >= (1 - gamma) h``, h counted as 0 at least.
        """
        c, dt, reader = self.config, self._dt_s, self.reader
        shown = reader.value(observation, "ego.speed")[..., None]
        v = np.maximum(self.fastest(shown, np.asarray(self.commanded_mps2)[..., None]), 0.0)
        least = -(shown[..., 0] + c.speed_error_mps) / dt
        if not reader.config.vehicles:
            return np.full(v.shape[:-1], np.inf), np.zeros(v.shape[:-1], dtype=np.bool_)
        gap, age = reader.rows(observation, "lane_gap"), reader.rows(observation, "age")
        there = self.ahead(observation)
        broadcast = shown + reader.rows(observation, "velocity_ahead")
        lead = self.slowest(broadcast, age)
        s = gap - 0.5 * (reader.rows(observation, "length") + EGO_LENGTH_M) - reader.rows(observation, "pl_at")
        room = s - self.strayed(broadcast, age) + 0.5 * lead**2 / c.lead_brake_mps2 - c.standstill_m
        h = np.maximum(room - v * c.response_s - 0.5 * v * v / c.brake_mps2, 0.0)
        rest = room - c.growth_mps * dt - 0.5 * v * (dt + self._tick_s) - (1.0 - c.gamma) * h
        p = c.brake_mps2 * (c.response_s + 0.5 * (dt - self._tick_s))
        u = np.sqrt(p * p + 2.0 * c.brake_mps2 * np.maximum(rest, 0.0)) - p
        unsafe = there & (rest < 0.0)
        bound = np.where(unsafe, -np.inf, np.where(there, (u - v) / dt, np.inf)).min(axis=-1)
        hardest = np.maximum(least, -c.brake_mps2)
        stuck = (bound < hardest - EPS) & (shown[..., 0] > c.creep_mps)
        return np.maximum(bound, hardest), stuck

    def bend_bound(self, observation: Observation, bends: list[tuple[float, Array]]) -> Array:
        """Largest acceleration [m/s2] after which all :meth:`bends` can be driven at a share of the grip.

        The believed place may be too far ahead as well: the tightest bend within PL_AT behind counts
        (:meth:`pass_bend`).
        """
        if self._limits is None or self._limits.lateral_acceleration_mps2 is None:
            return np.full(self.reader.value(observation, "ego.speed").shape, np.inf)
        shown = self.reader.value(observation, "ego.speed")
        v = np.maximum(self.fastest(shown, self.commanded_mps2), 0.0)
        squared = self.bend_squared(observation, bends, v, np.asarray(self._behind))
        self._count("bend", squared < (v + EPS) ** 2, np.zeros(shown.shape, dtype=np.bool_))
        return np.asarray(np.maximum((np.sqrt(squared) - v) / self._dt_s, -self.config.brake_mps2))

    def pass_bend(self, observation: Observation, here: Array) -> None:
        """Store the tightest bend within PL_AT behind; ``here`` is the present curvature [1/m]."""
        way = self._behind_m + self.reader.value(observation, "ego.speed") * self._dt_s
        passed = (here >= self._behind) | (way > self.reader.value(observation, "integrity.pl_at"))
        self._behind, self._behind_m = np.where(passed, here, self._behind), np.where(passed, 0.0, way)

    def _steered(self, observation: Observation, share: Array) -> tuple[Array, Bools, Bools]:
        """The share of steering, where the lane is kept with slack, and where no angle is safe."""
        bounds = self._inner.steering_range
        wanted = value_of(share, bounds)
        low, high, slack, none = self.steering_bounds(observation)
        safe = np.clip(wanted, low, high)
        self._count("lane", np.abs(safe - wanted) > EPS, none)
        self.counts["lane slack"] += int(np.sum(slack))
        return np.where(safe == wanted, share, share_of(safe, bounds)), slack, none

    def _slowing(self, observation: Observation) -> Array:
        """Largest acceleration where the lane is kept with slack, or cannot be kept."""
        c, v = self.config, self.reader.value(observation, "ego.speed")
        limit = self.reader.value(observation, "road.speed_limit")
        slow = c.slow_share * np.where(limit < self.reader.scale("road.speed_limit"), limit, c.speed_mps)
        _, _, slack, none = self.steering_bounds(observation)
        return np.where(slack | none, np.maximum((slow - v) / self._dt_s, -c.slow_mps2), np.inf)

    def _count(self, name: str, changed: Bools, none: Bools) -> None:
        self.counts[f"{name} changed"] += int(np.sum(changed))
        self.counts[f"{name} infeasible"] += int(np.sum(none))


def _declared_scale(env: DrivingEnv) -> float:
    """The bound of the odometer's scale error in the configuration of navigation [-]."""
    navigator = env.config.level.navigator().replace(**env.config.navigator)
    return float(navigator.positioning.dead_reckoning.odometer_scale)


def make_cbf(env: DrivingEnv, config: CbfConfig | None = None) -> BarrierFilter:
    """The filter over the driver that its figures name, the nominal one by default.

    Raises
    ------
    InputError
        One of the two cannot drive this environment.
    """
    from lanebound.agents.drivers import make_agent  # which makes this one

    chosen = config or CbfConfig()
    return BarrierFilter(env, make_agent(chosen.over, env), chosen)
