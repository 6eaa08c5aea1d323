"""The promise of the barrier filter over many random episodes, without faults and with injected ones.

Reckless drivers follow a stop-and-go leader under every sky; the filter is all that is between them and a crash. Every
decision is judged by the truth. With faults the error may leave its level: how often that happens, and how often a
barrier is lost, is compared with the integrity risk.

The promise is an induction: from a state with ``h >= 0`` a decision made while all assumptions hold leads to a state
with ``h >= 0``. Each decision is judged for itself, so that one exception does not excuse the rest of an episode.

That levels grow as stated is not among what the promise rests on: it foretells whether the next decision has a safe
acceleration too, short of which the filter brakes fully. It is counted with the rest, and excuses nothing.

Symbols: s gap between bumpers [m], v and v_l speeds of ego and leader [m/s], s0, tau, b, B as in BarrierConfig.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.drivers.barrier import BarrierConfig, BarrierFilter
from lanebound.agents.drivers.nominal import make_nominal
from lanebound.agents.episodes import drive, open_env
from lanebound.agents.episodes.columns import Moment
from lanebound.agents.studies.study import Shown, claim, parts_of, seed_batches, stored
from lanebound.envs.core import DrivingEnv
from lanebound.envs.scene import alert_limits_m, navigator_config
from lanebound.integrity.assessment.accuracy import clopper_pearson
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sensors.fault_registry import fault_kind
from lanebound.integrity.sensors.faults import Fault
from lanebound.integrity.sky.systems import System

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


PACKAGES = ("lanebound.integrity", "lanebound.envs", "lanebound.agents.drivers", "lanebound.agents.studies")
GROUPS = ("none", "one fault")
MANNERS = ("full throttle", "random", "moody")
FAULTS = (
    ("satellite_range", 0.5, 50.0),
    ("constellation", 0.5, 10.0),
    ("cycle_slip", 1, 10),
    ("spoofing", 2.0, 20.0),
    ("reference_coordinates", 0.2, 2.0),
    ("corrections_loss", 0.0, 0.0),
    ("jamming", 10.0, 40.0),
    ("gyro_bias", 0.1, 2.0),
    ("wheel_slip", 0.05, 0.5),
    ("odometer_frozen", 0.0, 0.0),
    ("v2v_lie", 1.0, 20.0),
    ("wrong_fix", 1, 20),
    ("nlos_burst", 5.0, 60.0),
)
"""Kinds with their smallest and largest sizes; those of sensors/fault_priors_stress have the sizes that it has."""
SYSTEMS = (System.GPS, System.GALILEO)
LIE_M = 2.0  # from which on a lie misleads
PRNS = 24  # of either system, numbers from 1 on; who is below the horizon harms nobody


class BarrierPromiseConfig(Config):
    """How many episodes, and which."""

    episodes: int = Field(1000, ge=1, description="of each group: without faults, and with one fault each")
    first_seed: int = Field(12000, ge=0, description="of the first: held out, nothing of the filter was set there")
    length_s: float = Field(25.0, gt=1, le=600, description="of an episode")
    batch: int = Field(20, ge=1, description="episodes in a part, which is kept once it is done")
    skies: tuple[str, ...] = Field(("open", "suburban", "urban", "dense"), description="taken in turn")
    source: Literal["v2v", "sensor", "both", "cooperative"] = Field(
        "v2v", description="what tells the ego of its leader"
    )
    kind: str | None = Field(None, description="of the fault: only the episodes that have one of it; None: all")
    barrier: BarrierConfig = Field(BarrierConfig(), description="of the filter")

    def one_fault(self, seed: int) -> Fault:
        """The fault of an episode; others lie only where they are heard."""
        return one_fault(seed, self.length_s, self.source != "sensor")

    def drives(self, seed: int) -> bool:
        """Whether an episode is driven."""
        return self.kind is None or self.one_fault(seed).kind == self.kind


class Reckless:
    """Steers well and accelerates as it likes: full throttle, anything at any time, or by mood.

    Parameters
    ----------
    env : to be driven in
    """

    def __init__(self, env: DrivingEnv) -> None:
        self._steering = make_nominal(env)

    def begin(self, seed: int) -> None:
        """A new episode; its seed sets manner and mood."""
        self._rng = named_generator(seed, "recklessness")
        self.manner, self._share = MANNERS[int(self._rng.integers(len(MANNERS)))], 1.0

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """Acceleration at will, steering of the nominal driver."""
        action, after = self._steering.predict(observation, state)
        draw, often = self._rng.uniform(-1.0, 1.0), self._rng.random()
        if self.manner == "random" or (self.manner == "moody" and often < 0.1):
            self._share = draw if self.manner == "random" else 0.3 + 0.7 * draw
        return np.array([self._share, action[1]], dtype=np.float32), after


def one_fault(seed: int, length_s: float, radio: bool = True) -> Fault:
    """The fault of an episode: any kind, from a time in its first half on, the same for all vehicles.

    ``radio``: whether the ego hears others, who may lie.
    """
    rng, able = named_generator(seed, "one fault"), [of for of in FAULTS if radio or of[0] != "v2v_lie"]
    name, low, high = able[int(rng.integers(len(able)))]
    kind = fault_kind(name)
    size, start, azimuth = rng.uniform(low, high), rng.uniform(0.0, 0.5 * length_s), rng.uniform(0.0, 360.0)
    profile = "ramp" if rng.random() < 0.5 and "ramp" in kind.profiles else "step"
    data: dict[str, Any] = {"kind": name, "start_s": start, "duration_s": rng.uniform(1.0, 15.0), "profile": profile}
    if (of := kind.magnitude) is not None:
        data |= {of.field: round(size) if of.whole else size, "azimuth_deg": azimuth, "ramp_s": 5.0}
    if "system" in kind.needs:
        data["system"] = SYSTEMS[int(rng.integers(len(SYSTEMS)))]
    if "prn" in kind.needs:
        data["prn"] = 1 + int(rng.integers(PRNS))
    return Fault.load(data)


class _Faulty:
    """An environment whose every episode has its own fault; drives like the one within."""

    def __init__(self, env: DrivingEnv, config: BarrierPromiseConfig) -> None:
        self._env, self._config = env, config

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self, *, seed: int, options: Mapping[str, Any] | None = None) -> Any:
        """Begin an episode with the fault of its seed, whatever the options."""
        return self._env.reset(seed=seed, options={"faults": [self._config.one_fault(seed)]})


def drive_part(
    config: BarrierPromiseConfig, group: str, seeds: Sequence[int], advance: Advance = ignore
) -> dict[str, Any]:
    """Drive some seeds under the sky that each has; plain figures of all of them."""
    total: dict[str, Any] = {"episodes": 0, "crashes": 0, "least_m": math.inf, "breaches": [], "crashed": []}
    total["excluded"] = []
    counts: dict[str, Counter[str]] = {"counts": Counter(), "exceptions": Counter(), "filter": Counter()}
    for sky in dict.fromkeys(config.skies):
        mine = [seed for seed in seeds if config.skies[seed % len(config.skies)] == sky and config.drives(seed)]
        if not mine:
            continue
        seen = {"perception": {"source": config.source}}
        env = open_env("CarFollowing", {"sky": sky, "world": {"duration": config.length_s}} | seen)
        world: Any = env if group == "none" else _Faulty(env, config)
        reckless = Reckless(env)
        barrier = BarrierFilter(env, reckless, config.barrier)
        for seed in mine:
            watch = PromiseWatch(barrier)
            reckless.begin(seed)
            drive(world, barrier, [seed], [watch])
            total["episodes"] += 1
            advance(total["episodes"] / len(seeds))
            if env.world.vehicle.crashed:
                total["crashes"] += 1
                total["crashed"].append(seed)
            if env.belief_loop is not None and env.belief_loop.info.get("senders_excluded", 0.0) > 0.0:
                total["excluded"].append(seed)
            counts["counts"].update(watch.counts)
            counts["exceptions"].update(watch.exceptions)
            counts["counts"]["episodes with exceptions"] += bool(watch.counts["exceptional"])
            counts["counts"]["episodes with lost barrier"] += bool(watch.counts["lost"] or watch.counts["broken"])
            total["breaches"] += watch.breaches
            total["least_m"] = min(total["least_m"], watch.least_m)
        counts["filter"].update(barrier.counts)
        total["risk"] = navigator_config(env.config, alert_limits_m(env.world, env.config)).risk.integrity_risk
    return total | {name: dict(sorted(counter.items())) for name, counter in counts.items()}


def run_promise(
    config: BarrierPromiseConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing episodes, and write ``promise.json``; returns its data.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    claim(out, "barrier promise study", config, PACKAGES)
    batches = seed_batches(config.first_seed, config.episodes, config.batch)
    names = {group: [_name(group, seeds) for seeds in batches] for group in GROUPS}
    ordered = [name for batch in zip(*names.values(), strict=True) for name in batch]
    found = parts_of(config, drive_named, ordered, out, jobs, on_progress, size=lambda name: len(_seeds(name)))
    result = {group: summarise_promise([found[name] for name in names[group]]) for group in GROUPS}
    result["one fault"]["by_fault"] = _by_fault(config, result["one fault"]["crashed_seeds"])
    result["one fault"]["liars"] = _liars(config, result["one fault"]["excluded_seeds"])
    return stored(result, out, "promise.json")


def _by_fault(config: BarrierPromiseConfig, crashed: Sequence[int]) -> dict[str, dict[str, Any]]:
    """Episodes and crashes by the kind of the fault that each seed has."""
    seeds = range(config.first_seed, config.first_seed + config.episodes)
    of = {seed: config.one_fault(seed).kind for seed in seeds if config.drives(seed)}
    episodes, crashes = Counter(of.values()), Counter(of[seed] for seed in crashed)
    return {
        kind: {"episodes": count, "crashes": crashes[kind], "crash_share_95": clopper_pearson(crashes[kind], count)}
        for kind, count in sorted(episodes.items())
    }


def _liars(config: BarrierPromiseConfig, excluded: Sequence[int]) -> dict[str, int]:
    """Leaders that broadcast positions wrong by 2 m and more, and how many of them are excluded."""
    seeds = filter(config.drives, range(config.first_seed, config.first_seed + config.episodes))
    faults = {seed: config.one_fault(seed) for seed in seeds}
    lying = [seed for seed, fault in faults.items() if fault.kind == "v2v_lie" and fault.magnitude_m >= LIE_M]
    return {"lying": len(lying), "excluded": len({*lying} & {*excluded})}


def _name(group: str, seeds: Sequence[int]) -> str:
    """Name of a part."""
    return f"{group.replace(' ', '-')}-{seeds[0]}-{seeds[-1]}"


def _seeds(name: str) -> range:
    """Seeds of a part."""
    _, first, last = name.rsplit("-", 2)
    return range(int(first), int(last) + 1)


def drive_named(config: BarrierPromiseConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """Drive the part of a name."""
    group = next(group for group in GROUPS if name.startswith(group.replace(" ", "-")))
    return drive_part(config, group, _seeds(name), advance)


def summarise_promise(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Sums over the parts of a group, and rates per decision and per hour of driving."""
    counts, exceptions, filtered = (Counter[str]() for _ in range(3))
    for part in parts:
        counts.update(part["counts"])
        exceptions.update(part["exceptions"])
        filtered.update(part["filter"])
    decisions = max(counts["decisions"], 1)
    hours = decisions * 0.2 / 3600.0  # CarFollowing decides 5 times a second
    lost = counts["lost"] + counts["broken"]
    episodes, crashes = (sum(part[name] for part in parts) for name in ("episodes", "crashes"))
    return {
        "episodes": episodes,
        "crashes": crashes,
        "crash_share_95": clopper_pearson(crashes, episodes),
        "crashed_seeds": [seed for part in parts for seed in part["crashed"]],
        "excluded_seeds": [seed for part in parts for seed in part["excluded"]],
        "least_barrier_m": min((part["least_m"] for part in parts if part["least_m"] is not None), default=None),
        "hours": hours,
        "integrity_risk": next((part["risk"] for part in parts if "risk" in part), math.nan),
        "level_exceeded_per_decision": exceptions["own level"] / decisions,
        "barrier_lost_per_decision": lost / decisions,
        "barrier_lost_per_hour": lost / hours,
        "counts": dict(sorted(counts.items())),
        "exceptions": dict(sorted(exceptions.items())),
        "filter": dict(sorted(filtered.items())),
        "breaches": [breach for part in parts for breach in part["breaches"]],
    }


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """Counts and rates of the groups, and crashes by the fault that was injected."""
    groups = list(result)
    named = sorted({name for group in result.values() for name in group["exceptions"]})
    counted = (
        ("counts", "", ("decisions", "kept", "broken", "exceptional", "lost", "unsafe starts")),
        ("exceptions", "exceptions: ", named),
        ("filter", "", ("following infeasible", "lane slack", "lane infeasible")),
    )
    rows = [("episodes", *(result[g]["episodes"] for g in groups))]
    rows += [
        (f"{head}{key}", *(result[g][kind].get(key, 0) for g in groups)) for kind, head, keys in counted for key in keys
    ]
    for key in ("crashes", "integrity_risk", "level_exceeded_per_decision", "barrier_lost_per_decision"):
        rows.append((key.replace("_", " "), *(result[g][key] for g in groups)))
    rows.append(("crashes, 95 %", *(_interval(result[g]["crash_share_95"]) for g in groups)))
    least = (result[g]["least_barrier_m"] for g in groups)
    rows.append(("least barrier [m]", *("-" if value is None else f"{value:.3f}" for value in least)))
    yield "The barrier's promise, by faults injected", (("", *groups), rows)
    crashes = [
        (kind.replace("_", " "), str(of["episodes"]), str(of["crashes"]), _interval(of["crash_share_95"]))
        for kind, of in result["one fault"]["by_fault"].items()
    ]
    yield "Crashes by the fault that was injected", (("fault", "episodes", "crashes", "share, 95 %"), crashes)
    liars, honest = result["one fault"]["liars"], result["none"]
    yield f"Leaders excluded of {liars['lying']} that lie by {LIE_M:g} m and more: {liars['excluded']}"
    yield f"Leaders excluded in {honest['episodes']} episodes without a fault: {len(honest['excluded_seeds'])}"
    yield "broken: the barrier went negative by a decision for which every assumption held; none may be."


def _interval(share: Sequence[float]) -> str:
    return f"{100.0 * share[0]:.1f} to {100.0 * share[1]:.1f} %"
