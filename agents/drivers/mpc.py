"""Predictive control within protection levels: gap, speed and lane over a horizon, with room for levels that grow.

Bounds on the believed middle are tightened by the levels at each step ahead: those of the ego, and those that the
leader broadcasts, at an upper quantile of their growth (:mod:`.horizon`), and by the leader's speed error. The plan
ends in a state from which the ego stops behind a leader that brakes as hard as possible. Two quadratic programmes a
decision are solved by daqp (Arnstrom, Bemporad and Axehill 2022).

Guarantees: each level lies below its prediction in nine of ten cases at each step, not at all steps together. The
leader is predicted with constant speed, and braking after the horizon: a plan may have no successor when the leader
brakes within the horizon, or when levels exceed their quantile. So no recursive feasibility is claimed, and this is no
tube in the sense of robust control. The barrier of the first step holds at every decision: without a plan the car
brakes fully, which keeps the gap under the assumptions of :class:`.barrier.BarrierFilter`.

Symbols: p way made [m], v speed [m/s], a acceleration [m/s2], s gap [m], e offset [m], psi heading and u steering less
their steady values in the bend [rad], tau response to spare [s], T length of a step [s],
k = 1 .. N steps, b and B hardest braking of ego and leader [m/s2], s0 gap at rest [m].
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, NamedTuple

import daqp
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.barrier import BarrierConfig, BarrierFilter
from lanebound.agents.drivers.base import Observation, Reader, Starts, States
from lanebound.agents.drivers.horizon import (
    CondensedProblem,
    GrowthConfig,
    condense,
    predicted_levels,
    upper_broadcast,
    upper_levels,
)
from lanebound.agents.drivers.lane_barrier import WALK_MPS
from lanebound.agents.drivers.lateral import LqrConfig, LqrSteering, errors
from lanebound.agents.drivers.leaders import leader_of
from lanebound.agents.drivers.nominal import Nominal
from lanebound.agents.drivers.plan import ContinuousDriver
from lanebound.agents.drivers.plans import EGO_LENGTH_M, FREE_M, CruiseConfig
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError

__all__ = ["Across", "Along", "FreeRoad", "LevelMpc", "MpcConfig", "PredictiveDriver", "make_mpc", "solve"]

Array = NDArray[np.float64]

SOLVED = 1  # daqp: optimal
SPEED_STEP_MPS = 0.5  # speeds nearer than this share matrices
CUT_MPS, CUT_TOP_MPS = 2.0, 40.0  # tangents of the stopping way, at speeds this far apart up to this one


class MpcConfig(CruiseConfig):
    """Horizon, weights and bounds."""

    steps: int = Field(20, ge=2, le=100, description="N, of a decision each; 4 s at 5 Hz, longer than a stop takes")
    lane_steps: int = Field(10, ge=2, le=100, description="N of the lane; 2 s at 5 Hz")
    speed_mps_weight: float = Field(1.0, gt=0, description="deviation of speed that weighs as one of the others")
    weight_mps2: float = Field(1.0, gt=0, description="acceleration that does")
    weight_mps3: float = Field(2.0, gt=0, description="jerk that does; comfort")
    jerk_mps3: float = Field(3.0, gt=0, description="of speeding up at most; braking may come at once")
    slack_weight: float = Field(50.0, gt=0, description="of a metre short of the time gap, squared; chosen")
    lane_slack_weight: float = Field(1e4, gt=0, description="of a metre out of the tightened lane, squared; chosen")
    lane_floor_m: float = Field(0.15, gt=0, description="room for the believed middle at least; a hand's breadth")
    car_width_m: float = Field(2.0, gt=0, description="of highway-env's cars")
    alert_share: float = Field(0.48, gt=0, le=1, description="of the limit where a level is predicted above its limit")
    dead_reckoning_s: float = Field(
        30.0, gt=0, description="without RTK under an alert until it stops; as integrity_aware"
    )
    growth: GrowthConfig = Field(GrowthConfig(), description="of protection levels ahead")
    barrier: BarrierConfig = Field(BarrierConfig(), description="of the first step, from which a stop stays possible")
    lqr: LqrConfig = Field(LqrConfig(), description="weights of the lane")


def solve(H: Array, f: Array, A: Array, upper: Array, lower: Array) -> Array | None:
    """Minimise ``z'Hz/2 + f'z`` within ``lower <= (z, A z) <= upper``; None without a solution."""
    sense = np.zeros(upper.size, dtype=np.int32)
    z, _, flag, _ = daqp.solve(H, f, A, upper, lower, sense)
    return np.asarray(z) if flag == SOLVED else None


class FreeRoad(NamedTuple):
    """Free road for the ego's front bumper: at each step (N,), and beyond the last where the leader may stop [m]."""

    free_m: Array
    stop_m: float


class Along:
    """The programme along the track, its matrices made once; z holds N accelerations and the slack.

    The last state can stop: ``p(N) + tau v(N) + v(N)^2 / 2b <= stop``. The square is convex; it is bounded by its
    tangents at speeds d apart, of which the largest lies no more than ``(d / 2)^2 / 2b`` below it, which is taken off.
    """

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
        self._at = np.arange(0.0, CUT_TOP_MPS + CUT_MPS, CUT_MPS)
        self._per = c.barrier.response_s + self._at / c.barrier.brake_mps2
        stop = self.way[-1] + np.outer(self._per, self.speed[-1])
        blocks = ((self.change, none), (self.speed, none), (self.way, none), (headway, -one))
        rows = [*(np.hstack(block) for block in blocks), np.hstack([stop, np.zeros((self._at.size, 1))])]
        self.A = np.ascontiguousarray(np.vstack(rows))

    def plan(self, v: float, before: float, wanted: Array, road: FreeRoad, bound: float) -> float | None:
        """The first acceleration, ``bound`` at most; None when nothing satisfies the bounds.

        A bound that asks for more than standing at the end of the step asks for that.
        """
        c, n, straight = self.config, self.config.steps, v * self.time_s
        f = np.zeros(n + 1)
        f[:n] = self.speed.T @ (v - wanted) / c.speed_mps_weight**2
        f[0] -= before / (c.weight_mps3 * self.dt_s) ** 2
        most = np.full(n, c.accelerate_mps2)
        most[0] = min(most[0], max(bound, -c.barrier.brake_mps2, -v / self.dt_s))
        rise = np.full(n, c.jerk_mps3 * self.dt_s)
        rise[0] += max(before, 0.0)
        free = road.free_m - c.standstill_m - straight
        spare = c.barrier.standstill_m + (0.5 * CUT_MPS) ** 2 / (2.0 * c.barrier.brake_mps2)
        stop = road.stop_m - spare - straight[-1] - self._per * v + 0.5 * self._at**2 / c.barrier.brake_mps2
        upper = np.concatenate([most, [np.inf], rise, np.full(n, np.inf), free, free - c.time_gap_s * v, stop])
        lower = np.full(upper.size, -np.inf)
        lower[: n + 1] = -c.barrier.brake_mps2
        lower[n] = 0.0
        lower[2 * n + 1 : 3 * n + 1] = -v
        z = solve(self.H, f, self.A, upper, lower)
        return None if z is None else float(z[0])


class Across:
    """The programme across the track, its matrices made once for each speed; z holds N angles and the slack."""

    def __init__(self, c: MpcConfig, dt_s: float) -> None:
        self.config, self.dt_s = c, dt_s
        self._weights = np.diag([c.lqr.offset_m**-2, c.lqr.heading_rad**-2])
        self._known: dict[int, tuple[CondensedProblem, Array, Array]] = {}

    def matrices(self, v: float) -> tuple[CondensedProblem, Array, Array]:
        """Dynamics, H and rows of the constraints at the nearest tabulated speed."""
        key = max(round(v / SPEED_STEP_MPS), 1)
        if key not in self._known:
            self._known[key] = self._make(key * SPEED_STEP_MPS * self.dt_s)
        return self._known[key]

    def _make(self, way_m: float) -> tuple[CondensedProblem, Array, Array]:
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


Bools = NDArray[np.bool_]
TIMES_KEPT = 100_000
SLACK_M = 0.01  # less is not counted


class LevelMpc(Nominal):
    """The plan of the predictive driver; a :class:`PredictiveDriver` executes it.

    Along: ``sum (v - v_ref)^2 + a^2 + jerk^2`` and the square of the shortfall of the time gap, within ``0 <= v``,
    ``-b <= a <= a_max``, ``jerk <= j_max``, ``p(k) <= s + v_lead k T - s0 - PL_AT(k)`` with the least v_lead within
    its error and PL_AT of both, ``p(N) + tau v(N) + v(N)^2 / 2b <= s + v_lead N T + v_lead^2 / 2B - s0 - PL_AT(N)``,
    and for the first step the barrier of :class:`BarrierFilter`, for a leader that brakes at once. ``v_ref`` is the
    speed that the route allows, a share of the limit where a level is expected above its limit, and 0 when RTK has been
    missing under an alert for the allowed time of dead reckoning: errors grow with time. Across: the linear-quadratic
    regulator's cost within ``|e(k)| <= (w - W) / 2 - PL_CT(k)``, with a floor and slack.

    Where nothing satisfies the bounds along, it brakes fully; across, it steers as the regulator. At standstill a gap
    that levels fill does not count as infeasible.

    Attributes
    ----------
    counts : ``decisions``; ``following infeasible``, those whose bounds nothing satisfies or for which full braking
        does not satisfy the barrier either; ``lane infeasible``; ``lane slack``, those with slack, or with the floor
        somewhere in the horizon; ``infeasible`` and ``relaxed``, decisions with any of either
    solve_s : solution times of the last programmes
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
        self._along, self._across = Along(config, env.dt_s), Across(config, env.dt_s)
        self._none: Bools = np.zeros((), dtype=np.bool_)

    def margins(self, observation: Observation) -> tuple[Array | float, Array | float]:
        """The combined levels."""
        if not self.reader.config.vehicles:
            return 0.0, 0.0
        return self.reader.rows(observation, "pl_at"), self.reader.rows(observation, "pl_ct")

    def acceleration(self, observation: Observation) -> Array:
        """The first acceleration of the plan, or full braking [m/s2]."""
        bound, stuck = self.barrier.acceleration_bound(observation)
        found, none, _ = _each(self._accelerate, self.reader, observation, bound, self.barrier.ahead(observation))
        self.barrier.remember(observation)
        self.barrier.commanded_mps2 = found
        self._none = none | stuck
        lost = int(np.sum(self._none))
        self.counts.update({"decisions": found.size, "following infeasible": lost, "infeasible": lost})
        return found

    def _accelerate(self, observation: Observation, bound: float, ahead: Bools) -> tuple[float, bool, bool]:
        c, reader = self.config, self.reader
        shown = float(reader.value(observation, "ego.speed"))
        v = max(shown, 0.0)
        expected = self._levels(observation, v, c.steps)
        road = self._road(observation, v, ahead)
        wanted, before = self._reference(observation, *expected), float(reader.value(observation, "ego.acceleration"))
        a = self._timed(lambda: self._along.plan(v, before, wanted, road, bound))
        hardest = max(-c.barrier.brake_mps2, -(v + c.barrier.creep_mps) / self.dt_s)
        if a is None:
            return hardest, shown > c.barrier.creep_mps, False
        return max(min(a, bound), hardest), False, False

    def _road(self, observation: Observation, v: float, ahead: Bools) -> FreeRoad:
        """Free road behind the leader, shortened by its errors and the levels of both."""
        c, along = self.config, self._along.time_s
        leader = leader_of(self.reader, observation, ahead)
        if leader is None:
            return FreeRoad(np.full(c.steps, FREE_M), FREE_M)
        slow = self.barrier.least_mps(leader.speed_mps)
        at, _ = upper_levels(self.reader, observation, v * along, self.dt_s, c.growth)
        way = max(leader.gap_m, 0.0) + leader.speed_mps * along
        theirs = upper_broadcast(self.reader, observation, leader.broadcast_m, way, self.dt_s, c.growth)
        grown = at - float(self.reader.value(observation, "integrity.pl_at")) + theirs - leader.broadcast_m
        free = leader.gap_m - leader.level_m - self.barrier.strayed(leader.speed_mps, leader.age_s) + slow * along
        free = free - grown
        return FreeRoad(free, float(free[-1]) + 0.5 * slow**2 / c.barrier.lead_brake_mps2)

    def _reference(self, observation: Observation, at: Array, ct: Array) -> Array:
        """Speed of the route, a share of the limit where levels are predicted above theirs, or 0.  (N,) [m/s]."""
        c, reader = self.config, self.reader
        since = float(reader.value(observation, "integrity.since_rtk"))
        if float(reader.value(observation, "integrity.alert")) > 0.5 and since > c.dead_reckoning_s:
            return np.zeros(at.size)
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
        found, none, slack = _each(self._turn, self.reader, observation)
        kept, fresh = int(np.sum(slack)), int(np.sum(none & ~self._none))
        self.counts.update({"lane infeasible": int(np.sum(none)), "lane slack": kept})
        self.counts.update({"infeasible": fresh, "relaxed": kept})
        self._none = np.zeros((), dtype=np.bool_)
        return found

    def _turn(self, observation: Observation) -> tuple[float, bool, bool]:
        c, reader = self.config, self.reader
        v = max(float(reader.value(observation, "ego.speed")), 0.0)
        if v < WALK_MPS:
            return float(self.lqr(observation)), False, False
        e, psi, _, bend = (float(x) for x in errors(reader, observation))
        way = v * self.dt_s * np.arange(1.0, c.lane_steps + 1.0)
        _, ct = upper_levels(reader, observation, way, self.dt_s, c.growth)
        bare = 0.5 * (float(reader.value(observation, "ego.lane_width")) - c.car_width_m) - ct
        floored = bool(np.any(bare < c.lane_floor_m))
        least, most = (float(x) - bend for x in self.barrier.reachable(observation))
        room = np.maximum(bare, c.lane_floor_m)
        found = self._timed(lambda: self._across.plan(v, np.array([e, psi]), room, (least, most)))
        if found is None:
            return float(self.lqr(observation)), True, floored
        u, slack = found
        return bend + float(u), False, floored or slack > SLACK_M

    def _timed(self, work: Any) -> Any:
        begun = time.perf_counter()
        found = work()
        self.solve_s.append(time.perf_counter() - begun)
        return found


class PredictiveDriver(ContinuousDriver):
    """Executes the plan."""

    plan: LevelMpc

    @property
    def counts(self) -> Counter[str]:
        """The counts of the plan."""
        return self.plan.counts

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], States]:
        """As any plan; the memory is cleared where an episode starts."""
        if episode_start is not None:
            shape = self.plan.reader.value(observation, "ego.speed").shape
            self.plan.barrier.begin(np.asarray(episode_start).reshape(shape))
        return super().predict(observation, state, episode_start, deterministic)


def _each(
    work: Callable[..., tuple[float, bool, bool]], reader: Reader, observation: Observation, *given: NDArray[Any]
) -> tuple[Array, Bools, Bools]:
    """``work`` for an observation and further arguments, or for each of a batch; three arrays of its results."""
    batch = reader.value(observation, "ego.speed").shape
    out, none, slack = np.empty(batch), np.zeros(batch, dtype=np.bool_), np.zeros(batch, dtype=np.bool_)
    for i in np.ndindex(batch):
        one: Observation
        if isinstance(observation, np.ndarray):
            one = observation[i]
        else:
            one = {group: vector[i] for group, vector in observation.items()}
        out[i], none[i], slack[i] = work(one, *(value[i] for value in given))
    return out, none, slack


def make_mpc(env: DrivingEnv, config: MpcConfig | None = None) -> PredictiveDriver:
    """The predictive driver.

    Raises
    ------
    InputError
        The actions are not continuous, or the observation shows no protection levels.
    """
    if not (isinstance(env.action_space, spaces.Box) and env.world.action_type.longitudinal):
        raise InputError("action must be continuous with acceleration for agent 'mpc', got others: choose another id")
    return PredictiveDriver(env, LevelMpc(env, config or MpcConfig()))
