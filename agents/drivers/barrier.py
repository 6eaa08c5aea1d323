"""A safety filter over any driver: control barrier functions with protection levels as the bound of the state's error.

Discrete-time barriers (Agrawal and Sreenath 2017), ``h(next) >= (1 - gamma) h(now)``, with the command that is nearest
to the driver's. Acceleration and steering each stand in one pair of bounds, so that the quadratic programme is solved
by clipping.

The barrier of following is measurement-robust (Dean et al. 2020, Cosner et al. 2021): it holds for every gap, speed of
the ego and speed of the leader within their bounds, and its promise is scored against the truth. That of the lane is
not: it holds for the believed offset with PL_CT of now taken off the room, and takes the believed heading, curvature
and steering for true. A heading error d moves ``q`` by ``v t d``, PL_CT may grow until the next decision, and the
belief may move: none of that is bounded, no promise is made of it and none is scored. In 1 of 100 decisions headings
are wrong by more than 0.02 rad under a dense sky and 0.04 rad under an urban one (training seeds 1004-1007), 0.2 to
0.4 m at 11 m/s and the preview: a lane of 3.25 m has no room for such a bound.

Bends have a barrier of speed: ``v^2 <= share a_lat / |kappa(d)| + 2 b (d - PL_AT)`` wherever they are shown, so that
what the lane barrier asks of the wheel stays within the grip. Without it who is too fast is steered off the road.

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

from lanebound.agents.drivers.base import Driver, Observation, Reader
from lanebound.agents.drivers.lateral import errors
from lanebound.agents.drivers.leaders import counted, expected_m, in_way
from lanebound.agents.drivers.plans import EGO_LENGTH_M
from lanebound.agents.drivers.shares import share_of, value_of
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError, InputError

__all__ = ["BarrierConfig", "BarrierFilter", "CbfConfig", "make_cbf"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
States = tuple[NDArray[Any], ...] | None
NEEDED = (
    "ego.speed", "ego.lateral_offset", "road.speed_limit", "integrity.pl_at", "integrity.pl_ct", "integrity.alert"
)  # fmt: skip
EPS = 1e-6
WALK_MPS = 1.0  # slower, steering moves nothing


class BarrierConfig(Config):
    """What the filter's promise rests on, and how early it acts."""

    gamma: float = Field(0.3, gt=0, le=1, description="share of the barrier that a step may use up [-]; argued")
    brake_mps2: float = Field(5.0, gt=0, description="b, braking that the ego is sure to reach; dry road")
    lead_brake_mps2: float = Field(6.0, gt=0, description="B >= b, hardest braking of the leader; RSS, dry road")
    standstill_m: float = Field(1.0, ge=0, description="gap that is left when both stand; argued")
    response_s: float = Field(0.1, ge=0, description="tau, to spare beyond the ages that are known; an epoch, argued")
    speed_error_mps: float = Field(0.25, ge=0, description="odometer's error at most; 5 sigma of 0.05 m/s")
    speed_share: float | None = Field(
        None, ge=0, description="and of its scale [-]; None: as declared, dead_reckoning.odometer_scale, 4.5 sigma"
    )
    lag_s: float = Field(0.06, ge=0, description="half an epoch of 0.1 s, and slip of 1e-3 s2/m at 10 m/s")
    creep_mps: float = Field(0.15, ge=0, description="slower than this odometers show nothing; as inductive ones")
    growth_mps: float = Field(
        2.0,
        ge=0,
        description="growth of PL_AT of both together; 99 % of decisions keep to it, so in an outage's first 3 s; "
        "urban and dense, training seeds 1000-1029 and 1300-1311",
    )
    lane_extra_m: float = Field(20.0, ge=0, description="the lane is widened by PL_CT, by this at most; all that shows")
    preview_s: float = Field(1.0, gt=0, description="over which the lane barrier looks ahead; argued")
    lane_floor_m: float = Field(0.15, gt=0, description="M at least, for the believed middle; a hand's breadth, argued")
    car_width_m: float = Field(2.0, gt=0, description="of highway-env's cars")
    bend_share: float = Field(0.75, gt=0, le=1, description="of the grip, for bends; the rest corrects; argued")
    bend_brake_mps2: float = Field(3.0, gt=0, description="braking that is counted on before bends; argued")
    slow_share: float = Field(0.48, gt=0, le=1, description="of the limit, while the lane is kept by slack")
    slow_mps2: float = Field(2.0, gt=0, description="braking down to that; comfortable")
    speed_mps: float = Field(14.0, gt=0, description="taken for the limit where the map gives none; 50 km/h")


class CbfConfig(BarrierConfig):
    """The filter, and whom it filters."""

    over: str = Field("nominal", min_length=1, description="agent whose commands are filtered, any but cbf itself")

    @field_validator("over")
    @classmethod
    def _is_another(cls, over: str) -> str:
        if over == "cbf":
            raise ConfigError("over must be another agent than cbf, got cbf: choose nominal or integrity_aware, say")
        return over


class BarrierFilter:
    """Passes on what a driver commands, or the nearest command that is safe.

    Following comes first. Where no acceleration is safe it brakes fully, ``-b``: then ``h`` of the true state grows, so
    that it stays positive even so. Whoever is believed ahead counts, and a leader of the last decision that is believed
    level or behind now while its level reaches over the ego (:mod:`.leaders`); one that was never believed ahead does
    not, which is an assumption. That is why its promise, a true ``h >= 0``, does not rest on ``growth_mps``, which
    is foresight: it makes full braking for levels that have grown, or for a belief that has moved within them, rare.
    The lane comes second: where the levels leave no room it is kept with slack, as near to its middle as a floor says,
    and the car slows to a share of the limit; where the wheel cannot get to the safe angles, as near to them as it can.

    Parameters
    ----------
    env : of continuous actions that include acceleration
    driver : any policy

    Attributes
    ----------
    speed_share : bound of the error of the odometers' scale [-], as configured or as the navigation declares it
    commanded_mps2 : acceleration of the last decision, by which the speed has changed since the odometer's epoch
    followed : whether any vehicle counted as one to stop behind in the last decision
    counts : ``decisions``; in how many ``following`` and ``lane`` changed the command or had none that is safe, in how
        many a ``bend`` called for braking, and in how many the lane was kept with slack; ``infeasible`` and
        ``relaxed``, decisions with any of either

    Raises
    ------
    InputError
        The actions are not continuous, or the observation shows no protection levels.
    """

    def __init__(self, env: DrivingEnv, driver: Driver, config: BarrierConfig | None = None) -> None:
        self.config = BarrierConfig() if config is None else config
        self.driver, self.reader, self._dt_s = driver, Reader(env.config.observation), env.dt_s
        if not (isinstance(env.action_space, spaces.Box) and env.world.action_type.longitudinal):
            raise InputError("action must be continuous with acceleration for a barrier, got others: choose another id")
        self.reader.require(NEEDED)
        share = self.config.speed_share
        self.speed_share = _declared_scale(env) if share is None else share
        if not self.reader.previews_m:
            raise InputError("observation.preview_m must name a distance for this agent, got none: add one")
        self._inner, self._limits = env.world.action_type, env.config.actuators
        self._tick_s = 1.0 / env.config.simulation_hz
        self.commanded_mps2: Array | float = 0.0
        self.followed: Bools = np.zeros((), dtype=np.bool_)
        self._expected_m: Array | float = np.nan
        self._behind: Array | float = 0.0
        self._behind_m: Array | float = 0.0
        self.counts: Counter[str] = Counter()

    def predict(
        self,
        observation: Any,
        state: States = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
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
        """Forget what was, where an episode starts.  (...)."""
        if np.all(starts):  # there may be another number of them
            self.commanded_mps2, self._expected_m = 0.0, np.nan
            self._behind, self._behind_m = 0.0, 0.0
            return
        self.commanded_mps2 = np.where(starts, 0.0, self.commanded_mps2)
        self._expected_m = np.where(starts, np.nan, self._expected_m)
        self._behind, self._behind_m = np.where(starts, 0.0, self._behind), np.where(starts, 0.0, self._behind_m)

    def reseed(self, seed: int) -> None:
        """Hand an episode's seed to a driver that draws."""
        if hasattr(self.driver, "reseed"):
            self.driver.reseed(seed)

    def remember(self, observation: Observation) -> None:
        """Keep where the leader of this decision will be at the next, by which one is known that is believed behind."""
        if self.reader.config.vehicles:
            ahead = self.ahead(observation)
            self.followed = np.asarray(ahead.any(axis=-1))
            self._expected_m = expected_m(self.reader, observation, ahead, self._dt_s)

    def ahead(self, observation: Observation) -> Bools:
        """Which vehicles count as ones to stop behind, (..., K)."""
        way = in_way(self.reader, observation, self.config.lane_extra_m)
        return counted(self.reader, observation, way, self._expected_m)

    def fastest(self, speed_mps: Any, acceleration_mps2: Any) -> Any:
        """The ego's speed at most, by what its odometer shows: the mean of the last epoch [m/s]."""
        c = self.config
        return (
            speed_mps
            + c.speed_error_mps
            + self.speed_share * abs(speed_mps)
            + c.lag_s * np.maximum(acceleration_mps2, 0.0)
        )

    def slowest(self, speed_mps: Any, age_s: Any) -> Any:
        """A leader's speed at least, having braked as hard as it can since it said so [m/s]."""
        c = self.config
        return np.maximum(speed_mps - self._speed_bound(speed_mps) - c.lead_brake_mps2 * age_s, 0.0)

    def least_mps(self, speed_mps: Any) -> Any:
        """A leader's speed at least by what it tells, when it said so [m/s]."""
        return np.maximum(speed_mps - self._speed_bound(speed_mps), 0.0)

    def strayed(self, speed_mps: Any, age_s: Any) -> Any:
        """How far a leader may be from where the speed that it told of puts it, beyond its level [m]."""
        return self._speed_bound(speed_mps) * age_s

    def _speed_bound(self, speed_mps: Any) -> Any:
        c = self.config
        return c.speed_error_mps + self.speed_share * abs(speed_mps) + c.lag_s * c.lead_brake_mps2

    def acceleration_bound(self, observation: Observation) -> tuple[Array, Bools]:
        """Largest safe acceleration [m/s2], and where even full braking does not keep the barrier.

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
        told = shown + reader.rows(observation, "velocity_ahead")
        lead = self.slowest(told, age)
        s = gap - 0.5 * (reader.rows(observation, "length") + EGO_LENGTH_M) - reader.rows(observation, "pl_at")
        room = s - self.strayed(told, age) + 0.5 * lead**2 / c.lead_brake_mps2 - c.standstill_m
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
        """Largest acceleration [m/s2] after which every one of :meth:`bends` can be met at a share of the grip.

        With the believed place PL_AT too far back, a way of ``v T`` until the next decision, and no less of a bend than
        there was within PL_AT behind (:meth:`pass_bend`): the believed place may be too far ahead as well.
        """
        c, dt, grip = self.config, self._dt_s, None if self._limits is None else self._limits.lateral_acceleration_mps2
        shown = self.reader.value(observation, "ego.speed")
        if grip is None:
            return np.full(shown.shape, np.inf)
        v = np.maximum(self.fastest(shown, self.commanded_mps2), 0.0)
        late = self.reader.value(observation, "integrity.pl_at") + v * dt
        squared = c.bend_share * grip / np.maximum(self._behind, 1e-6)
        for d, kappa in bends:
            bend = c.bend_share * grip / np.maximum(kappa, 1e-6)
            squared = np.minimum(squared, bend + 2.0 * c.bend_brake_mps2 * np.maximum(d - late, 0.0))
        self._count("bend", squared < (v + EPS) ** 2, np.zeros(shown.shape, dtype=np.bool_))
        return np.asarray(np.maximum((np.sqrt(squared) - v) / dt, -c.brake_mps2))

    def bends(self, observation: Observation) -> list[tuple[float, Array]]:
        """Where bends begin [m] and how tight they are [1/m]: at each preview, and on average between two of them."""
        read = self.reader.value
        turned = -np.arctan2(read(observation, "ego.heading_sin"), read(observation, "ego.heading_cos"))
        found, at = [], 0.0
        for d in self.reader.previews_m:
            heading = read(observation, f"road.preview_{d:g}m_heading")
            turn = (heading - turned + np.pi) % (2.0 * np.pi) - np.pi
            found += [(at, np.abs(turn) / (d - at)), (d, np.abs(read(observation, f"road.preview_{d:g}m_curvature")))]
            turned, at = heading, d
        return found

    def pass_bend(self, observation: Observation, here: Array) -> None:
        """Keep the tightest bend of the way of PL_AT just driven, ``here`` is how tight it is now [1/m]."""
        way = self._behind_m + self.reader.value(observation, "ego.speed") * self._dt_s
        passed = (here >= self._behind) | (way > self.reader.value(observation, "integrity.pl_at"))
        self._behind, self._behind_m = np.where(passed, here, self._behind), np.where(passed, 0.0, way)

    def angle_bounds(self, observation: Observation) -> tuple[Array, Array, Bools]:
        """Bounds of the steering angle [rad] that keep the car in its lane, and where they rest on slack.

        ``q = e + v t psi``, where the car would be after the preview t, stays within ``M = (w - W) / 2 - PL_CT``:
        ``-gamma M + (1 - gamma) q <= q(next) <= gamma M + (1 - gamma) q``, ``q(next) = q + v T psi + G beta``,
        ``G = v T + (v T)^2 / L + 2 T v^2 t / L``. e follows q as a lag of first order, so that it stays there too, and
        one steering angle answers for q; all that of the belief, see the head of this file. Where M is below a floor
        no steering keeps a car in the lane that may be out of it already: there the floor counts, which keeps what may
        stick out smallest.
        """
        c, dt, reader = self.config, self._dt_s, self.reader
        v = np.maximum(reader.value(observation, "ego.speed"), 0.0)
        e, psi, beta, _ = errors(reader, observation)
        width = reader.value(observation, "ego.lane_width")
        free = 0.5 * (width - c.car_width_m) - reader.value(observation, "integrity.pl_ct")
        m = np.maximum(free, c.lane_floor_m)
        way = v * dt
        reach = way + way**2 / EGO_LENGTH_M + 2.0 * way * v * c.preview_s / EGO_LENGTH_M
        q = e + v * c.preview_s * psi
        middle = -c.gamma * q - way * psi
        per = np.maximum(reach, 0.1)
        low, high = (
            np.arctan(2.0 * np.tan(np.clip(beta + (middle + side * c.gamma * m) / per, -1.0, 1.0))) for side in (-1, 1)
        )
        return low, high, (free < c.lane_floor_m) & (v >= WALK_MPS)

    def reachable(self, observation: Observation) -> tuple[Array, Array]:
        """Steering angles that grip and the wheel's rate allow within a decision [rad]."""
        limits, (low, high) = self._limits, self._inner.steering_range
        v = np.maximum(self.reader.value(observation, "ego.speed"), 0.0)
        now = self.reader.value(observation, "ego.steering")
        grip = np.full(v.shape, np.pi / 2)
        if limits is not None and limits.lateral_acceleration_mps2 is not None:
            sine = np.minimum(limits.lateral_acceleration_mps2 * 0.5 * EGO_LENGTH_M / np.maximum(v, 0.1) ** 2, 0.99)
            grip = np.arctan(2.0 * np.tan(np.arcsin(sine)))
        rate = np.inf if limits is None or limits.steering_rate_radps is None else limits.steering_rate_radps
        turn = rate * self._dt_s
        return (
            np.clip(np.maximum(-grip, now - turn), low, high),
            np.clip(np.minimum(grip, now + turn), low, high),
        )

    def _lane(self, observation: Observation) -> tuple[Array, Array, Bools, Bools]:
        """Bounds of steering, free at walking pace where it moves nothing; where there is slack; where no way is."""
        low, high, slack = self.angle_bounds(observation)
        least, most = self.reachable(observation)
        rolls = self.reader.value(observation, "ego.speed") >= WALK_MPS
        none = rolls & ((low > most) | (high < least))
        return np.where(rolls, low, -np.pi), np.where(rolls, high, np.pi), slack, none

    def _steered(self, observation: Observation, share: Array) -> tuple[Array, Bools, Bools]:
        """The share of steering, where the lane is kept with slack, and where no angle is safe."""
        bounds = self._inner.steering_range
        wanted = value_of(share, bounds)
        low, high, slack, none = self._lane(observation)
        safe = np.clip(wanted, low, high)
        self._count("lane", np.abs(safe - wanted) > EPS, none)
        self.counts["lane slack"] += int(np.sum(slack))
        return np.where(safe == wanted, share, share_of(safe, bounds)), slack, none

    def _slowing(self, observation: Observation) -> Array:
        """Acceleration at most where the lane is kept by slack, or not at all."""
        c, v = self.config, self.reader.value(observation, "ego.speed")
        limit = self.reader.value(observation, "road.speed_limit")
        slow = c.slow_share * np.where(limit < self.reader.scale("road.speed_limit"), limit, c.speed_mps)
        _, _, slack, none = self._lane(observation)
        return np.where(slack | none, np.maximum((slow - v) / self._dt_s, -c.slow_mps2), np.inf)

    def _count(self, name: str, changed: Bools, none: Bools) -> None:
        self.counts[f"{name} changed"] += int(np.sum(changed))
        self.counts[f"{name} infeasible"] += int(np.sum(none))


def _declared_scale(env: DrivingEnv) -> float:
    """The bound of the odometer's scale error that navigation is configured with [-]."""
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
