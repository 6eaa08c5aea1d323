"""Whether a barrier filter keeps its promise, judged by the truth, decision by decision.

The promise is an induction: from a state with ``h >= 0`` a decision made while all assumptions hold leads to a state
with ``h >= 0``. Each decision is judged for itself, so that one exception does not excuse the rest of an episode.

That levels grow as stated is not among what the promise rests on: it foretells whether the next decision has a safe
acceleration too, short of which the filter brakes fully. It is counted beside the rest, and excuses nothing.

Symbols: s gap between bumpers [m], v and v_l speeds of ego and leader [m/s], s0, tau, b, B as in BarrierConfig.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lanebound.agents.drivers.barrier import BarrierConfig, BarrierFilter
from lanebound.agents.episodes.columns import Moment
from lanebound.envs.core import DrivingEnv

__all__ = ["ASSUMPTIONS", "PromiseWatch", "barrier_m", "exceptions_of", "levels_m"]

ROUNDING_M = 1e-3  # observations are float32 of quantities up to 150 m
ROUNDING_MPS2 = 1e-6
ASSUMPTIONS = {
    "unseen": "the leader is perceived",
    "behind": "the leader is believed ahead, or was a decision ago and its level still reaches over the ego",
    "no level": "protection levels exist, below what observations can show",
    "own level": "the ego's errors lie within its protection levels",
    "leader's level": "the error of the leader's place (if sensed, from the ego) lies within its levels, age included",
    "own speed": "the error of the ego's speed lies within the stated bound",
    "leader's speed": "so does that of the leader's",
    "leader's braking": "the leader brakes no harder than stated",
    "levels' growth": "levels of both together grow no faster than stated; of foresight, and no excuse",
}


def barrier_m(gap_m: float, ego_mps: float, lead_mps: float, c: BarrierConfig) -> float:
    """``h = s + v_l^2 / 2B - s0 - tau v - v^2 / 2b``: what is left of the gap when both have braked to a stop [m]."""
    v, lead = max(ego_mps, 0.0), max(lead_mps, 0.0)
    stops = 0.5 * lead * lead / c.lead_brake_mps2 - 0.5 * v * v / c.brake_mps2
    return gap_m + stops - c.standstill_m - c.response_s * v


def levels_m(env: DrivingEnv, info: Mapping[str, Any]) -> float:
    """Levels of the gap, inf when one is missing, or unseen [m]: of ego and leader, or of a sensed leader alone."""
    assert env.belief_loop is not None
    traffic = env.belief_loop.traffic
    if not traffic.count:
        return math.inf
    own = 0.0 if traffic.relative[0] else float(info["pl_at_m"])
    return own + float(traffic.pl_at_m[0])


def exceptions_of(env: DrivingEnv, barrier: BarrierFilter, info: Mapping[str, Any]) -> set[str]:
    """Which assumptions do not hold of the belief that the next decision is made on; one leader, no other traffic."""
    loop = env.belief_loop
    assert loop is not None
    lead, ego, traffic = env.world.lead, loop.ego, loop.traffic
    found = set()
    if abs(info["err_at_m"]) > info["pl_at_m"] or abs(info["err_ct_m"]) > info["pl_ct_m"]:
        found.add("own level")
    if float(ego.speed) > float(barrier.fastest(loop.belief().speed_mps, barrier.commanded_mps2)):
        found.add("own speed")
    if traffic.count == 0:
        return found | {"unseen"}
    at, ct = float(traffic.pl_at_m[0]), float(traffic.pl_ct_m[0])
    if not max(at + info["pl_at_m"], ct + info["pl_ct_m"]) < 2.0 * env.config.observation.pl_max_m:
        found.add("no level")
    x, y = _misplaced_m(env)
    c, s = math.cos(lead.heading), math.sin(lead.heading)
    if (
        abs(c * x + s * y) > at + float(barrier.strayed(traffic.speed_mps[0], traffic.age_s[0]))
        or abs(c * y - s * x) > ct
    ):
        found.add("leader's level")
    if float(lead.speed) < float(barrier.slowest(float(traffic.speed_mps[0]), float(traffic.age_s[0]))):
        found.add("leader's speed")
    return found | _behind(env)


def _misplaced_m(env: DrivingEnv) -> tuple[float, float]:
    """How far the leader is from its perceived position; of a sensed leader, seen from the ego.

    By the axes of the map, on which the filter finds its lane: a wrong heading of the ego moves it aside.
    """
    loop, lead = env.belief_loop, env.world.lead
    assert loop is not None
    away = loop.traffic.position_m[0] - lead.position
    if loop.traffic.relative[0]:
        away = away - (loop.belief().position_m - loop.ego.position)
    x, y = away.tolist()
    return x, y


def _behind(env: DrivingEnv) -> set[str]:
    """Whether the leader is believed level with the ego or behind it, by their middles along the ego's heading."""
    loop = env.belief_loop
    assert loop is not None
    belief = loop.belief()
    dx, dy = (loop.traffic.position_m[0] - belief.position_m).tolist()
    return {"behind"} if math.cos(belief.heading_rad) * dx + math.sin(belief.heading_rad) * dy <= 0.0 else set()


@dataclass
class _Seen:
    """What a moment showed: decisions so far without a safe acceleration, levels, and what came of the step to it."""

    infeasible: int = 0
    levels_m: float = math.inf
    stuck: bool = False
    grown: bool = False


@dataclass
class PromiseWatch:
    """Judges every decision of the episodes that it watches.

    Attributes
    ----------
    counts : decisions, those ``kept`` and ``broken`` while all assumptions held, ``outside`` those judged by no promise
        (an assumption did not hold, or h was negative before), ``negative`` states with h < 0; ``stuck`` those without
        a safe acceleration, ``newly stuck`` those of them after one that had one, ``foreseeable`` those of these before
        which levels grew as stated
    exceptions : number of decisions by assumption that did not hold
    breaches : seed, step, h before and after of each broken decision
    least_m : least h after a decision to which the promise applies
    """

    barrier: BarrierFilter
    counts: Counter[str] = field(default_factory=Counter)
    exceptions: Counter[str] = field(default_factory=Counter)
    breaches: list[dict[str, float]] = field(default_factory=list)
    least_m: float = math.inf
    _before: tuple[float, set[str], float] = (math.nan, set(), 0.0)
    _seen: _Seen = field(default_factory=lambda: _Seen())

    def note(self, moment: Moment) -> None:
        """Judge the decision that led here, and look at what the next one will be made on."""
        world, c = moment.env.world, self.barrier.config
        h = barrier_m(world.gap_m(), float(world.vehicle.speed), float(world.lead.speed), c)
        if moment.step > 0:
            self._judge(moment, h)
        elif h < 0.0:
            self.counts["unsafe starts"] += 1
        self._before = h, exceptions_of(moment.env, self.barrier, moment.info), float(world.lead.speed)
        self._foresee(moment)

    def _foresee(self, moment: Moment) -> None:
        """Count levels that grew faster than stated, and decisions without a safe acceleration, with and without that.

        The last decision was made at the moment before, whose levels had ``grown`` or not.
        """
        before, now = self._seen, _Seen(self.barrier.counts["following infeasible"], levels_m(moment.env, moment.info))
        if moment.step > 0:
            now.stuck = now.infeasible > before.infeasible
            now.grown = now.levels_m - before.levels_m > self.barrier.config.growth_mps * moment.env.dt_s + ROUNDING_M
            fresh = now.stuck and not before.stuck
            self.exceptions["levels' growth"] += now.grown
            self.counts["stuck"] += now.stuck
            self.counts["newly stuck"] += fresh
            self.counts["foreseeable"] += fresh and not before.grown
        self._seen = now

    def _judge(self, moment: Moment, h: float) -> None:
        before, found, lead_mps = self._before
        if self.barrier.followed.all():  # it was taken for one ahead nonetheless
            found = found - {"behind"}
        braking = (lead_mps - float(moment.env.world.lead.speed)) / moment.env.dt_s
        if braking > self.barrier.config.lead_brake_mps2 + ROUNDING_MPS2:
            found = found | {"leader's braking"}
        self.counts["decisions"] += 1
        self.counts["negative"] += h < -ROUNDING_M
        self.exceptions.update(found)
        self.counts["exceptional"] += bool(found)
        if found or before < -ROUNDING_M:
            self.counts["outside"] += 1
            self.counts["lost"] += before >= -ROUNDING_M > h
            return
        self.least_m = min(self.least_m, h)
        self.counts["kept" if h >= -ROUNDING_M else "broken"] += 1
        if h < -ROUNDING_M:
            self.breaches.append({"seed": moment.seed, "step": moment.step, "before_m": before, "after_m": h})
