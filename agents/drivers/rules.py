"""Hard rules of driving under protection levels: which commands they permit, and the nearest permitted command.

Everything is read from observations, and nothing is remembered: equal observations give equal bounds, for a single
observation and for N of them.

| rule | permits |
|---|---|
| ``alert`` | no lane change that begins while an alert is on |
| ``gap`` | a lane change only if every vehicle that may be on that lane is far enough, and one lane at a time |
| ``level`` | speeds up to ``limit c / max(PL / AL, c)``, but always up to ``least_share`` (0.25) of the limit |
| ``rss`` | speeds whose longitudinal RSS distance is at most the gap less PL_AT of both vehicles |
| ``bend`` | speeds that need at most a share of the grip in the bends ahead |
| ``lane`` | steering that keeps the believed car, less PL_CT, in lanes it may use; a room of 0.15 m is always left |

The floors are ``least_share``, and ``barrier.lane_floor_m`` of room across the lane: below them no rule bounds.

``level``: the share of the limit is inverse to the larger ratio of the two axes as shown (3 at most, and where a level
is missing), under an alert to 1 at least. So ``v PL <= c limit AL``: what a level sweeps in a second is at most what it
sweeps at the share c of the limit when it is as large as its alert limit.
The form is chosen; c is the share that ``cost_alert`` permits. Where the environment shows the speed that it permits
under an alert (``cost.alert_speed: level``, the same form with the limits at that speed), the rule takes that one. The
share has a floor, because a level that is missing between buildings does not come back for a car that stands there.

``gap``, ``rss``: definition 1 of Shalev-Shwartz et al. 2017 with the figures of ``cost_headway``; a response time of at
least a decision; gaps bumper to bumper less PL_AT of both; lanes widened by PL_CT of both. For ``gap`` the ego must be
safe behind each vehicle ahead, and each vehicle behind must be safe behind the ego. During a change, and where the
believed body reaches over a lane marking, vehicles ahead on both lanes count for ``rss``. A vehicle that is believed
level with the ego or behind it counts as ahead, with a gap of 0, if its level reaches over the ego; ``gap`` forbids the
change then, as no gap is left in either order. A missing level of a vehicle forbids changes to its lane; ``rss`` counts
it as 40 m at least, as ``cost_headway`` does. A lane that is known to close ends in a standing vehicle for ``rss``,
less PL_AT of the ego, and ``gap`` permits no change to it.

Meta-actions are permitted by the target speed that they set. Where no target is slow enough, only the lowest one that
an action sets is permitted, so that some action always is. A permitted speed u bounds the acceleration of continuous
actions by ``(u - v) / T``, and by no more than the braking of its rule. ``lane`` is the barrier of
:mod:`.lane_barrier`, for continuous steering alone; meta-actions are steered by the environment.

Not bounded: crossing traffic, vehicles that are not among the observed ones, the ends of lanes, reversing. Oncoming
vehicles count as standing ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.agents.drivers.lane_barrier import LaneBarrier, LaneBarrierConfig
from lanebound.agents.drivers.leaders import in_way
from lanebound.agents.drivers.margins import RssConfig, rss_speed
from lanebound.agents.drivers.plans import EGO_LENGTH_M, FREE_M, closure_gap
from lanebound.agents.drivers.shares import share_of, value_of
from lanebound.envs.core import DrivingEnv
from lanebound.envs.worlds.tolling import ClaimAction
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError

__all__ = ["RULES", "Projected", "RuleBook", "SafetyRules"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
RULES = ("alert", "gap", "level", "rss", "bend", "lane")
UNKNOWN_M = 40.0  # what a missing level counts as, as of cost_headway
SIDES = {"LANE_LEFT": -1, "LANE_RIGHT": 1}
TARGET = {-1: "ego.target_left", 1: "ego.target_right"}
EXISTS = {-1: "ego.left_exists", 1: "ego.right_exists"}
EPS = 1e-6  # of shares and accelerations
EPS_MPS = 1e-3  # of target speeds, which are shown in float32


class SafetyRules(Config):
    """Which rules hold, and their figures."""

    alert: bool = Field(True, description="no lane change begins while an alert is on")
    gap: bool = Field(True, description="none into a gap below the RSS distances plus the levels of both vehicles")
    level: bool = Field(True, description="the permitted speed falls as a level fills its alert limit")
    rss: bool = Field(True, description="RSS distance to vehicles ahead, plus the levels of both vehicles")
    bend: bool = Field(True, description="speeds in bends, by a share of the grip; none without a limit of grip")
    lane: bool = Field(True, description="barrier of the lane, less PL_CT; continuous steering alone")
    calm_ratio: float | None = Field(
        None, gt=0, le=1, description="c, PL / AL up to which the limit holds [-]; None: cost.alert_speed_share"
    )
    least_share: float = Field(
        0.25, ge=0, le=1, description="of the limit, below which no level takes it [-]; 0: to c / 3; chosen"
    )
    slow_mps2: float = Field(2.0, gt=0, description="braking for levels at most; comfortable")
    speed_mps: float = Field(14.0, gt=0, description="limit where the map gives none; 50 km/h")
    lane_extra_m: float = Field(
        20.0, ge=0, description="lanes are widened by PL_CT, by this at most; the largest shown"
    )
    barrier: LaneBarrierConfig = Field(
        LaneBarrierConfig(bend_share=0.9),
        description="of lane and bend; at 0.75 of the grip no meta-action drives the circle of Roundabout",
    )


class Projected(NamedTuple):
    """Permitted actions (...), and what was changed.

    Attributes
    ----------
    actions : as given where they are permitted, in the same type
    by : which rules changed the action, by name, each (...)
    change : mean square of the change of shares; 1 for another meta-action, (...)
    """

    actions: NDArray[Any]
    by: Mapping[str, Bools]
    change: Array

    @property
    def changed(self) -> Bools:
        """Whether any rule changed the action, (...)."""
        return np.asarray(np.any(list(self.by.values()), axis=0))


class RuleBook:
    """The rules for the actions of an environment.

    Parameters
    ----------
    env : only its configuration and the figures of its actions are read; it is not driven
    rules : all of them by default

    Raises
    ------
    InputError
        The observation lacks an entry that a rule needs.
    """

    def __init__(self, env: DrivingEnv, rules: SafetyRules | None = None) -> None:
        self.rules = r = SafetyRules() if rules is None else rules
        self.reader, self._dt_s, c = Reader(env.config.observation), env.dt_s, env.config.cost
        self._inner = inner = env.world.action_type
        if isinstance(inner, ClaimAction):
            raise InputError("action must move the car under rules of driving, got claims: choose another id")
        self._meta = not isinstance(env.action_space, spaces.Box)
        self._steers = not self._meta and inner.lateral and (r.lane or r.alert or r.gap)
        self._slows = self._meta or inner.longitudinal
        self.reader.require(_needed(r, self._meta))
        if self.reader.config.closure and (r.gap or r.rss):
            self.reader.require(["integrity.pl_at"])
        if (r.gap or r.rss) and not self.reader.config.vehicles:
            raise InputError(
                "observation.vehicles must be > 0 for the rules gap and rss, got 0: show vehicles, or set both to false"
            )
        if r.gap or r.rss:
            self.reader.require([f"traffic.v0_pl_{name}" for name in ("at", "ct", "exists")])
        self._barrier = LaneBarrier(env, r.barrier) if self._steers or r.bend else None
        self._calm = max(c.alert_speed_share, 1e-3) if r.calm_ratio is None else r.calm_ratio
        self._rss = RssConfig(
            rss_response_s=max(c.response_s, env.dt_s), rss_accelerate_mps2=c.accelerate_mps2,
            rss_brake_min_mps2=c.brake_min_mps2, rss_brake_max_mps2=c.brake_max_mps2,
        )  # fmt: skip
        self._brakes = {"level": r.slow_mps2, "rss": c.brake_min_mps2, "bend": r.barrier.bend_brake_mps2}
        if self._meta:
            self._labels = [inner.actions[code] for code in range(len(inner.actions))]
            self._levels = np.asarray(inner.target_speeds, dtype=np.float64)

    def project(self, observation: Observation, actions: Any) -> Projected:
        """The nearest permitted actions: codes (...) of meta-actions, or shares (..., C).

        Raises
        ------
        InputError
            A code that no meta-action has.
        """
        given = np.asarray(actions)
        if not self._meta:
            return self._clip(observation, given if given.dtype.kind == "f" else given.astype(np.float32))
        if given.dtype.kind not in "iu" or np.any((given < 0) | (given >= len(self._labels))):
            raise InputError(f"actions must be codes from 0 to {len(self._labels) - 1}, got {actions!r}: correct them")
        return self._choose(observation, given)

    # Bounds

    def speeds(self, observation: Observation) -> dict[str, Array]:
        """The highest speed that each rule permits [m/s], each (...); at least 0, inf without a bound."""
        found = {"level": self._level_speed, "rss": self._rss_speed, "bend": self._bend_speed}
        return {name: speed(observation) for name, speed in found.items() if getattr(self.rules, name)}

    def closed(self, observation: Observation, side: int) -> dict[str, Bools]:
        """Whether each rule forbids a change to the left (-1) or to the right (1), each (...)."""
        found: dict[str, Bools] = {}
        if self.rules.alert:
            found["alert"] = self._alert(observation)
        if self.rules.gap:
            found["gap"] = self._lacks_gap(observation, side)
        return found

    def _alert(self, observation: Observation) -> Bools:
        return self.reader.value(observation, "integrity.alert") > 0.5

    def _level_speed(self, observation: Observation) -> Array:
        read = self.reader.value
        ratio = np.maximum(read(observation, "integrity.ratio_at"), read(observation, "integrity.ratio_ct"))
        ratio = np.where(self._alert(observation), np.maximum(ratio, 1.0), ratio)
        limit = read(observation, "road.speed_limit")
        limit = np.where(limit < self.reader.scale("road.speed_limit"), limit, self.rules.speed_mps)
        speed = limit * (self._calm / np.maximum(ratio, self._calm))
        if self.reader.config.permitted_speed:  # by limits at the speed itself, as what costs under an alert
            permitted = read(observation, "integrity.permitted_speed")
            speed = np.where(self._alert(observation), np.minimum(permitted, limit), speed)
        return np.maximum(speed, limit * self.rules.least_share)

    def _rss_speed(self, observation: Observation) -> Array:
        """A gap less levels below 0 counts as 0: the car then falls back behind its leader."""
        free, others, level = self._others(observation)
        way, e = self._in_way(observation, 0), self.reader.value(observation, "ego.lateral_offset")
        over = 0.5 * (self.reader.value(observation, "ego.lane_width") - self.rules.barrier.car_width_m)
        for side, target in TARGET.items():
            both = (self.reader.value(observation, target) > 0.5) | (side * e > over)
            way = way | (both[..., None] & self._in_way(observation, side))
        ahead = way & (self.reader.rows(observation, "lane_gap") + level > 0.0)
        safe = rss_speed(np.maximum(free, 0.0), others, self._rss)
        return np.asarray(np.minimum(np.where(ahead, safe, np.inf).min(axis=-1), self._closure_speed(observation)))

    def _closure_speed(self, observation: Observation) -> Array:
        """Before a closure that is known on the own lane, or on that of a change, as behind a vehicle that stands."""
        room = self._closure_room(observation, 0)
        for side, target in TARGET.items():
            changes = self.reader.value(observation, target) > 0.5
            room = np.where(changes, np.minimum(room, self._closure_room(observation, side)), room)
        return np.where(room < FREE_M, rss_speed(room, np.zeros_like(room), self._rss), np.inf)

    def _closure_room(self, observation: Observation, side: int) -> Array:
        """Road to a closure that is known on a lane, less PL_AT (the largest shown if missing); far off without one."""
        level = self.reader.value(observation, "integrity.pl_at") if self.reader.config.closure else 0.0
        return closure_gap(self.reader, observation, side, level)

    def _bend_speed(self, observation: Observation) -> Array:
        assert self._barrier is not None
        bends, v = self._barrier.bends(observation), self._speed(observation)
        return np.sqrt(self._barrier.bend_squared(observation, bends, v, np.zeros_like(v)))

    def _lacks_gap(self, observation: Observation, side: int) -> Bools:
        """Where the order is uncertain, the level is longer than the gap, and less than 0 is free."""
        free, others, _ = self._others(observation)
        known = self.reader.rows(observation, "pl_exists") > 0.5
        room, own = np.maximum(free, 0.0), self._speed(observation)[..., None]
        ahead = self.reader.rows(observation, "lane_gap") > 0.0
        safe = np.where(ahead, own <= rss_speed(room, others, self._rss), others <= rss_speed(room, own, self._rss))
        lacks = (self._in_way(observation, side) & ~(safe & known & (free >= 0.0))).any(axis=-1)
        return np.asarray(lacks | (self._closure_room(observation, side) < FREE_M))

    def _others(self, observation: Observation) -> tuple[Array, Array, Array]:
        """Free distance along the route less both levels [m], speed [m/s], and both levels [m], each (..., K)."""
        rows = self.reader.rows
        free = np.abs(rows(observation, "lane_gap")) - 0.5 * (rows(observation, "length") + EGO_LENGTH_M)
        speed = self.reader.value(observation, "ego.speed")[..., None] + rows(observation, "velocity_ahead")
        level = rows(observation, "pl_at")
        level = np.where(rows(observation, "pl_exists") > 0.5, level, np.maximum(level, UNKNOWN_M))
        return free - level, np.maximum(speed, 0.0), level

    def _in_way(self, observation: Observation, side: int) -> Bools:
        return in_way(self.reader, observation, self.rules.lane_extra_m, side)

    def _speed(self, observation: Observation) -> Array:
        return np.maximum(self.reader.value(observation, "ego.speed"), 0.0)

    # Meta-actions

    def permitted(self, observation: Observation) -> Bools:
        """Which meta-actions the rules permit, (..., A); one at least.

        Raises
        ------
        InputError
            Under continuous actions.
        """
        if not self._meta:
            raise InputError("action_masks needs meta-actions, got continuous ones: there is nothing to mask")
        return np.asarray(~np.any(list(self._forbidden(observation, self._targets(observation)).values()), axis=0))

    def _targets(self, observation: Observation) -> Array:
        """Target speed after each meta-action [m/s], (..., A): highway-env steps from the present speed."""
        levels, last = self._levels, self._levels.size - 1
        share = (self.reader.value(observation, "ego.speed") - levels[0]) / (levels[-1] - levels[0])
        now = np.clip(np.round(share * last), 0, last).astype(np.int64)
        stays = self.reader.value(observation, "ego.target_speed")
        steps = {"FASTER": levels[np.minimum(now + 1, last)], "SLOWER": levels[np.maximum(now - 1, 0)]}
        return np.stack([steps.get(label, stays) for label in self._labels], axis=-1)

    def _forbidden(self, observation: Observation, targets: Array) -> dict[str, Bools]:
        """Which meta-actions each rule forbids, each (..., A)."""
        spared = targets <= targets.min(axis=-1, keepdims=True) + EPS_MPS
        found = {name: ~spared & (targets > u[..., None] + EPS_MPS) for name, u in self.speeds(observation).items()}
        for code, label in enumerate(self._labels):
            side = SIDES.get(label)
            if side is None:
                continue
            returns = self.reader.value(observation, TARGET[-side]) > 0.5
            for name, forbids in self.closed(observation, side).items():
                if name == "gap":  # traffic on the lane after the next is not judged
                    forbids = forbids | (self.reader.value(observation, TARGET[side]) > 0.5)
                found.setdefault(name, np.zeros(targets.shape, dtype=np.bool_))[..., code] = forbids & ~returns
        return found or {"level": np.zeros(targets.shape, dtype=np.bool_)}

    def _choose(self, observation: Observation, codes: NDArray[Any]) -> Projected:
        """The permitted action with the nearest target speed; no lane change takes the place of another action."""
        targets = self._targets(observation)
        forbidden = self._forbidden(observation, targets)
        given = codes[..., None].astype(np.int64)
        by = {name: np.take_along_axis(forbids, given, -1)[..., 0] for name, forbids in forbidden.items()}
        barred = np.any(list(forbidden.values()), axis=0) | np.array([label in SIDES for label in self._labels])
        second = 1e-6 * np.array([label != "IDLE" for label in self._labels])
        far = np.abs(targets - np.take_along_axis(targets, given, -1)) + second
        nearest = np.argmin(np.where(barred, np.inf, far), axis=-1)
        changed = np.any(list(by.values()), axis=0)
        return Projected(np.where(changed, nearest, codes).astype(codes.dtype), by, changed.astype(np.float64))

    # Continuous actions

    def acceleration_bounds(self, observation: Observation) -> dict[str, Array]:
        """The largest acceleration that each rule permits [m/s2], each (...)."""
        v = self.reader.value(observation, "ego.speed")
        return {
            name: np.maximum((u - v) / self._dt_s, -self._brakes[name]) for name, u in self.speeds(observation).items()
        }

    def steering_bounds(self, observation: Observation) -> tuple[Array, Array, dict[int, dict[str, Bools]]]:
        """Bounds of steering [rad], and by side which rules close a lane that exists there."""
        assert self._barrier is not None
        there = {side: self.reader.value(observation, name) > 0.5 for side, name in EXISTS.items()}
        closed = {
            side: {name: forbids & there[side] for name, forbids in self.closed(observation, side).items()}
            for side in there
        }
        shut = {side: np.any([*rules.values(), np.zeros_like(there[side])], axis=0) for side, rules in closed.items()}
        low, high, _, _ = self._barrier.steering_bounds(observation, *(there[side] & ~shut[side] for side in (-1, 1)))
        if not self.rules.lane:  # only lanes that are closed bound the steering
            low, high = np.where(shut[-1], low, -np.pi), np.where(shut[1], high, np.pi)
        return low, high, closed

    def _clip(self, observation: Observation, shares: NDArray[Any]) -> Projected:
        """Within the bounds; one pair for each command, so that clipping solves the quadratic programme."""
        out, by, column = shares.copy(), dict[str, Bools](), 0
        if self._slows:
            span, found = self._inner.acceleration_range, self.acceleration_bounds(observation)
            wanted = value_of(shares[..., 0].astype(np.float64), span)
            by = {name: wanted > np.maximum(bound, span[0]) + EPS for name, bound in found.items()}
            least = np.min([*found.values(), np.full(wanted.shape, np.inf)], axis=0)
            out[..., 0] = np.where(wanted > least + EPS, share_of(least, span), shares[..., 0])
            column = 1
        if self._steers:
            low, high, closed = self.steering_bounds(observation)
            span = self._inner.steering_range
            wanted = np.clip(value_of(shares[..., column].astype(np.float64), span), *span)
            bounded = np.clip(np.clip(wanted, low, high), *span)
            moved = np.abs(bounded - wanted) > EPS
            out[..., column] = np.where(moved, share_of(bounded, span), shares[..., column])
            sides = {-1: moved & (bounded > wanted), 1: moved & (bounded < wanted)}
            for name in closed[-1]:
                by[name] = (sides[-1] & closed[-1][name]) | (sides[1] & closed[1][name])
            by["lane"] = moved & ~np.any([np.zeros_like(moved), *(by[name] for name in closed[-1])], axis=0)
        change = np.mean((out.astype(np.float64) - np.clip(shares, -1.0, 1.0)) ** 2, axis=-1)
        return Projected(out, by or {"lane": np.zeros(shares.shape[:-1], dtype=np.bool_)}, change)


def _needed(rules: SafetyRules, meta: bool) -> list[str]:
    """Entries of an observation that the rules read, beside those of the traffic and the route."""
    found = ["ego.speed"]
    if rules.alert or rules.level:
        found.append("integrity.alert")
    if rules.level:
        found += ["road.speed_limit", "integrity.ratio_at", "integrity.ratio_ct"]
    if rules.bend or rules.lane:
        found += ["integrity.pl_at", "integrity.pl_ct"]
    return [*found, *(["ego.target_speed"] if meta else []), *TARGET.values(), *EXISTS.values()]
