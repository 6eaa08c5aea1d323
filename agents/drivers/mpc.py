"""Tube model-predictive control: gap, speed and lane over a horizon, within bounds tightened by protection levels.

The belief is the middle of a tube whose half widths are the protection levels at each step ahead, as they are predicted
to grow (:mod:`.horizon`); constraints on the middle are tightened by them, so that they hold for every state within.
Two quadratic programmes a decision, solved by daqp (Arnstrom, Bemporad and Axehill 2022).

Symbols: p way made [m], v speed [m/s], a acceleration [m/s2], s gap [m], e offset [m], psi heading less its steady
value in the bend [rad], u steering less that of the bend [rad], T length of a step [s], k = 1 .. N steps.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import daqp
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.barrier import BarrierConfig, BarrierFilter
from lanebound.agents.drivers.base import Observation, Reader
from lanebound.agents.drivers.horizon import Condensed, GrowthConfig, condense, predicted_levels
from lanebound.agents.drivers.lateral import LqrConfig, LqrSteering, errors
from lanebound.agents.drivers.nominal import Nominal
from lanebound.agents.drivers.plan import ContinuousDriver
from lanebound.agents.drivers.plans import EGO_LENGTH_M, FREE_M, CruiseConfig
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.config import Field
from lanebound.integrity.errors import InputError

__all__ = ["MpcConfig", "TubeMpc", "make_mpc", "solve"]

Array = NDArray[np.float64]
SOLVED = 1  # daqp: optimal
TIMES_KEPT = 100_000
SLACK_M = 0.01  # less is not counted
SPEED_STEP_MPS = 0.5  # speeds nearer than this share matrices
WALK_MPS = 1.0  # slower, steering moves nothing


class MpcConfig(CruiseConfig):
    """Horizon, weights and bounds."""

    steps: int = Field(20, ge=2, le=100, description="N, of a decision each; 4 s at 5 Hz, longer than a stop takes")
    lane_steps: int = Field(10, ge=2, le=100, description="N of the lane; 2 s at 5 Hz")
    speed_mps_weight: float = Field(1.0, gt=0, description="deviation of speed that weighs as one of the others")
    weight_mps2: float = Field(1.0, gt=0, description="acceleration that does")
    weight_mps3: float = Field(2.0, gt=0, description="jerk that does; comfort")
    jerk_mps3: float = Field(3.0, gt=0, description="of speeding up at most; braking may come at once")
    slack_weight: float = Field(50.0, gt=0, description="of a metre short of the time gap, squared; argued")
    lane_slack_weight: float = Field(1e4, gt=0, description="of a metre out of the tightened lane, squared; argued")
    lane_floor_m: float = Field(0.15, gt=0, description="room for the believed middle at least; a hand's breadth")
    car_width_m: float = Field(2.0, gt=0, description="of highway-env's cars")
    alert_share: float = Field(0.48, gt=0, le=1, description="of the limit where a level is predicted above its limit")
    growth: GrowthConfig = Field(GrowthConfig(), description="of protection levels ahead")
    barrier: BarrierConfig = Field(BarrierConfig(), description="of the first step, from which a stop stays possible")
    lqr: LqrConfig = Field(LqrConfig(), description="weights of the lane")


def solve(H: Array, f: Array, A: Array, upper: Array, lower: Array) -> Array | None:
    """Minimise ``z'Hz/2 + f'z`` within ``lower <= (z, A z) <= upper``; None when nothing lies within."""
    sense = np.zeros(upper.size, dtype=np.int32)
    z, _, flag, _ = daqp.solve(H, f, A, upper, lower, sense)
    return np.asarray(z) if flag == SOLVED else None


class TubeMpc(Nominal):
    """The plan of the predictive driver; a :class:`ContinuousDriver` carries it out.

    Along: ``sum (v - v_ref)^2 + a^2 + jerk^2`` and the square of what is short of the time gap, within ``0 <= v``,
    ``-b <= a <= a_max``, ``jerk <= j_max``, ``p(k) <= s + v_lead k T - s0 - PL_AT(k)``, and for the first step the
    barrier of :class:`BarrierFilter`, which keeps a stop possible whatever the leader does. ``v_ref`` is what the route
    allows, and a share of the limit where a level is predicted above its limit. Across: the linear-quadratic
    regulator's cost within ``|e(k)| <= (w - W) / 2 - PL_CT(k)``, a floor at least, with slack.

    Where nothing satisfies the bounds along, it brakes fully; across, it steers as the regulator does.

    Attributes
    ----------
    counts : decisions, ``following infeasible``, ``lane slack`` and ``lane infeasible``
    solve_s : time that the programmes of each of the last decisions took
    """

    NEEDED = (*Nominal.NEEDED, *(f"integrity.{name}" for name in (
        "pl_at", "pl_ct", "al_at", "al_ct", "since_rtk", "corrections_age", "alert"
    )))  # fmt: skip
    config: MpcConfig

    def __init__(self, env: DrivingEnv, config: MpcConfig) -> None:
        super().__init__(env, config)
        self.dt_s, self.lqr = env.dt_s, LqrSteering(env, self.reader, config.lqr)
        self.steering = self._steer
        self.barrier = BarrierFilter(env, ContinuousDriver(env, self), config.barrier)
        self.counts: Counter[str] = Counter()
        self.solve_s: deque[float] = deque(maxlen=TIMES_KEPT)
        self._along, self._across = _Along(config, env.dt_s), _Across(config, env.dt_s)

    def margins(self, observation: Observation) -> tuple[Array | float, Array | float]:
        """The combined levels."""
        if not self.reader.config.vehicles:
            return 0.0, 0.0
        return self.reader.rows(observation, "pl_at"), self.reader.rows(observation, "pl_ct")

    def acceleration(self, observation: Observation) -> Array:
        """The first acceleration of the plan, or full braking [m/s2]."""
        bound, _ = self.barrier.acceleration_bound(observation)
        found = _each(self._accelerate, self.reader, observation, bound)
        self.barrier.commanded_mps2 = found
        return found

    def _accelerate(self, observation: Observation, bound: float) -> float:
        c, reader = self.config, self.reader
        v = max(float(reader.value(observation, "ego.speed")), 0.0)
        at, ct = self._levels(observation, v, c.steps)
        gap, lead = (float(x) for x in self.lead(observation))
        grown = at - float(reader.value(observation, "integrity.pl_at"))
        room = gap + lead * self._along.time_s - grown if gap < FREE_M else np.full(c.steps, FREE_M)
        wanted, before = self._reference(observation, at, ct), float(reader.value(observation, "ego.acceleration"))
        a = self._timed(lambda: self._along.plan(v, before, wanted, room, bound))
        self.counts["decisions"] += 1
        if a is None:
            self.counts["following infeasible"] += 1
            return max(-c.barrier.brake_mps2, -(v + c.barrier.creep_mps) / self.dt_s)
        return float(a)

    def _reference(self, observation: Observation, at: Array, ct: Array) -> Array:
        """What the route allows, and a share of the limit where levels are predicted above theirs.  (N,) [m/s]."""
        c, reader = self.config, self.reader
        route, limit = float(self.wanted_speed(observation)), float(reader.value(observation, "road.speed_limit"))
        slow = c.alert_share * (limit if limit < reader.scale("road.speed_limit") else c.speed_mps)
        over = (at > float(reader.value(observation, "integrity.al_at"))) | (
            ct > float(reader.value(observation, "integrity.al_ct"))
        )
        return np.where(over, min(slow, route), route)

    def _levels(self, observation: Observation, v: float, steps: int) -> tuple[Array, Array]:
        way = v * self.dt_s * np.arange(1.0, steps + 1.0)
        return predicted_levels(self.reader, observation, way, self.dt_s, self.config.growth)

    def _steer(self, observation: Observation) -> Array:
        """The first steering angle of the plan, or the regulator's [rad]."""
        return _each(self._turn, self.reader, observation)

    def _turn(self, observation: Observation) -> float:
        c, reader = self.config, self.reader
        v = max(float(reader.value(observation, "ego.speed")), 0.0)
        if v < WALK_MPS:
            return float(self.lqr(observation))
        e, psi, _, bend = (float(x) for x in errors(reader, observation))
        _, ct = self._levels(observation, v, c.lane_steps)
        width = float(reader.value(observation, "ego.lane_width"))
        room = np.maximum(0.5 * (width - c.car_width_m) - ct, c.lane_floor_m)
        least, most = (float(x) - bend for x in self.barrier.reachable(observation))
        found = self._timed(lambda: self._across.plan(v, np.array([e, psi]), room, (least, most)))
        if found is None:
            self.counts["lane infeasible"] += 1
            return float(self.lqr(observation))
        u, slack = found
        self.counts["lane slack"] += slack > SLACK_M
        return bend + float(u)

    def _timed(self, work: Any) -> Any:
        begun = time.perf_counter()
        found = work()
        self.solve_s.append(time.perf_counter() - begun)
        return found


class _Along:
    """The programme along the track, its matrices made once; z holds N accelerations and the slack."""

    def __init__(self, c: MpcConfig, dt_s: float) -> None:
        n, self.config, self.dt_s = c.steps, c, dt_s
        self.time_s = dt_s * np.arange(1.0, n + 1.0)
        self.speed = dt_s * np.tri(n)
        self.way = 0.5 * dt_s**2 * (2.0 * np.maximum(np.subtract.outer(np.arange(n), np.arange(n)), 0.0) + np.tri(n))
        self.change = np.eye(n) - np.eye(n, k=-1)
        self.H = np.zeros((n + 1, n + 1))
        jerk = c.weight_mps3 * dt_s
        self.H[:n, :n] = self.speed.T @ self.speed / c.speed_mps_weight**2 + np.eye(n) / c.weight_mps2**2
        self.H[:n, :n] += self.change.T @ self.change / jerk**2
        self.H[n, n] = c.slack_weight * n
        none, one = np.zeros((n, 1)), np.ones((n, 1))
        headway = self.way + c.time_gap_s * self.speed
        blocks = ((self.change, none), (self.speed, none), (self.way, none), (headway, -one))
        self.A = np.ascontiguousarray(np.vstack([np.hstack(block) for block in blocks]))

    def plan(self, v: float, before: float, wanted: Array, room: Array, bound: float) -> float | None:
        """The first acceleration; ``room`` (N,) is free road ahead at each step, ``bound`` that of the first step."""
        c, n, straight = self.config, self.config.steps, v * self.time_s
        f = np.zeros(n + 1)
        f[:n] = self.speed.T @ (v - wanted) / c.speed_mps_weight**2
        f[0] -= before / (c.weight_mps3 * self.dt_s) ** 2
        most = np.full(n, c.accelerate_mps2)
        most[0] = min(most[0], bound)
        if most[0] < -c.barrier.brake_mps2:
            return None
        rise = np.full(n, c.jerk_mps3 * self.dt_s)
        rise[0] += max(before, 0.0)
        free = room - c.standstill_m - straight
        upper = np.concatenate([most, [np.inf], rise, np.full(n, np.inf), free, free - c.time_gap_s * v])
        lower = np.full(upper.size, -np.inf)
        lower[: n + 1] = -c.barrier.brake_mps2
        lower[n] = 0.0
        lower[2 * n + 1 : 3 * n + 1] = -v
        z = solve(self.H, f, self.A, upper, lower)
        return None if z is None else float(z[0])


class _Across:
    """The programme across the track, its matrices made once for each speed; z holds N angles and the slack."""

    def __init__(self, c: MpcConfig, dt_s: float) -> None:
        self.config, self.dt_s = c, dt_s
        self._weights = np.diag([c.lqr.offset_m**-2, c.lqr.heading_rad**-2])
        self._known: dict[int, tuple[Condensed, Array, Array]] = {}

    def matrices(self, v: float) -> tuple[Condensed, Array, Array]:
        """Dynamics, H and rows of the constraints at the nearest of the speeds that are told apart."""
        key = max(round(v / SPEED_STEP_MPS), 1)
        if key not in self._known:
            self._known[key] = self._make(key * SPEED_STEP_MPS * self.dt_s)
        return self._known[key]

    def _make(self, way_m: float) -> tuple[Condensed, Array, Array]:
        c, n = self.config, self.config.lane_steps
        A = np.array([[1.0, way_m], [0.0, 1.0]])
        B = np.array([[0.5 * way_m + 0.5 * way_m**2 / EGO_LENGTH_M], [way_m / EGO_LENGTH_M]])
        found = condense(A, B, self._weights, c.lqr.steering_rad**-2, n)
        H, offset, one = np.zeros((n + 1, n + 1)), found.forced[::2], np.ones((n, 1))
        H[:n, :n], H[n, n] = found.H, c.lane_slack_weight
        rows = np.ascontiguousarray(np.vstack([np.hstack([offset, -one]), np.hstack([-offset, -one])]))
        return found, H, rows

    def plan(self, v: float, x: Array, room: Array, reach: tuple[float, float]) -> tuple[float, float] | None:
        """The first steering angle beyond the bend's [rad] and the slack [m].

        Parameters
        ----------
        x : (2,) offset and heading
        room : (N,) on each side for the believed middle
        reach : least and largest of the first angle
        """
        if reach[0] > reach[1]:
            return None
        n = room.size
        found, H, rows = self.matrices(v)
        drift, f = found.free[::2] @ x, np.append(found.F @ x, 0.0)
        upper = np.concatenate([np.full(n, np.pi), [np.inf], room - drift, room + drift])
        lower = np.full(upper.size, -np.inf)
        lower[:n], lower[n], lower[0], upper[0] = -np.pi, 0.0, reach[0], reach[1]
        z = solve(H, f, rows, upper, lower)
        return None if z is None else (float(z[0]), float(z[n]))


def _each(work: Callable[..., float], reader: Reader, observation: Observation, *given: Array) -> Array:
    """``work`` for an observation and what is given with it, or for each of a batch."""
    batch = reader.value(observation, "ego.speed").shape
    out = np.empty(batch)
    for i in np.ndindex(batch):
        one: Observation
        if isinstance(observation, np.ndarray):
            one = observation[i]
        else:
            one = {group: vector[i] for group, vector in observation.items()}
        out[i] = work(one, *(float(value[i]) for value in given))
    return out


def make_mpc(env: DrivingEnv, config: MpcConfig | None = None) -> ContinuousDriver:
    """The predictive driver.

    Raises
    ------
    InputError
        The actions are not continuous, or the observation shows no protection levels.
    """
    if not (isinstance(env.action_space, spaces.Box) and env.world.action_type.longitudinal):
        raise InputError("action must be continuous with acceleration for agent 'mpc', got others: choose another id")
    return ContinuousDriver(env, TubeMpc(env, config or MpcConfig()))
