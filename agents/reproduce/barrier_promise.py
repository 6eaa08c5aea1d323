"""The promise of the barrier filter over many random episodes, without faults and with injected ones.

Reckless drivers follow a stop-and-go leader under every sky; the filter is all that is between them and a crash. Every
decision is judged by the truth (see :mod:`.barrier_score`). With faults the error may leave its level: how often that
happens, and how often a barrier is lost, is set beside the integrity risk.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lanebound.agents.checkpointing.files import write_json
from lanebound.agents.checkpointing.folder import ResultFolder, code_digest
from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore, run_parts
from lanebound.agents.drivers.barrier import BarrierConfig, BarrierFilter
from lanebound.agents.drivers.nominal import make_nominal
from lanebound.agents.episodes import drive, open_env
from lanebound.agents.reproduce.barrier_score import PromiseWatch
from lanebound.envs.core import DrivingEnv
from lanebound.envs.scene import alert_limits_m, navigator_config
from lanebound.integrity.assessment.bounding import clopper_pearson
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sensors.fault_registry import fault_kind
from lanebound.integrity.sensors.faults import Fault
from lanebound.integrity.sky.systems import System

__all__ = ["BarrierPromiseConfig", "Reckless", "one_fault", "run_promise", "summarise_promise"]

PACKAGES = ("lanebound.integrity", "lanebound.envs", "lanebound.agents.drivers", "lanebound.agents.reproduce")
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
PRNS = 24  # of either system, numbers from 1 on; who is below the horizon harms nobody


class BarrierPromiseConfig(Config):
    """How many episodes, and which."""

    episodes: int = Field(1000, ge=1, description="of each group: without faults, and with one fault each")
    first_seed: int = Field(12000, ge=0, description="of the first: held out, nothing of the filter was set there")
    length_s: float = Field(25.0, gt=1, le=600, description="of an episode")
    batch: int = Field(20, ge=1, description="episodes in a part, which is kept once it is done")
    skies: tuple[str, ...] = Field(("open", "suburban", "urban", "dense"), description="taken in turn")
    source: Literal["v2v", "sensor", "both"] = Field("v2v", description="what tells the ego of its leader")
    barrier: BarrierConfig = Field(BarrierConfig(), description="of the filter")


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


def one_fault(seed: int, length_s: float) -> Fault:
    """The fault of an episode: any kind, from a time in its first half on, the same for all vehicles."""
    rng = named_generator(seed, "one fault")
    name, low, high = FAULTS[int(rng.integers(len(FAULTS)))]
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

    def __init__(self, env: DrivingEnv, length_s: float) -> None:
        self._env, self._length_s = env, length_s

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self, *, seed: int) -> Any:
        """Begin an episode with the fault of its seed."""
        return self._env.reset(seed=seed, options={"faults": [one_fault(seed, self._length_s)]})


def drive_part(
    config: BarrierPromiseConfig, group: str, seeds: Sequence[int], advance: Advance = ignore
) -> dict[str, Any]:
    """Drive some seeds under the sky that each has; plain figures of all of them."""
    total: dict[str, Any] = {"episodes": 0, "crashes": 0, "least_m": math.inf, "breaches": [], "crashed": []}
    counts: dict[str, Counter[str]] = {"counts": Counter(), "exceptions": Counter(), "filter": Counter()}
    for sky in dict.fromkeys(config.skies):
        mine = [seed for seed in seeds if config.skies[seed % len(config.skies)] == sky]
        if not mine:
            continue
        seen = {"perception": {"source": config.source}}
        env = open_env("CarFollowing", {"sky": sky, "world": {"duration": config.length_s}} | seen)
        world: Any = env if group == "none" else _Faulty(env, config.length_s)
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
    ResultFolder(out, "barrier promise study", config.to_dict(), code_digest(*PACKAGES)).claim()
    names = {group: [_name(group, seeds) for seeds in _batches(config)] for group in GROUPS}
    ordered = [name for batch in zip(*names.values(), strict=True) for name in batch]
    drive_one = partial(drive_named, config)
    found = run_parts(out, ordered, drive_one, jobs, on_progress, size=lambda name: len(_seeds(name)))
    result = {group: summarise_promise([found[name] for name in names[group]]) for group in GROUPS}
    result["one fault"]["by_fault"] = _by_fault(config, result["one fault"]["crashed_seeds"])
    write_json(out / "promise.json", result)
    return result


def _by_fault(config: BarrierPromiseConfig, crashed: Sequence[int]) -> dict[str, dict[str, Any]]:
    """Episodes and crashes by the kind of the fault that each seed has."""
    seeds = range(config.first_seed, config.first_seed + config.episodes)
    of = {seed: one_fault(seed, config.length_s).kind for seed in seeds}
    episodes, crashes = Counter(of.values()), Counter(of[seed] for seed in crashed)
    return {
        kind: {"episodes": count, "crashes": crashes[kind], "crash_share_95": clopper_pearson(crashes[kind], count)}
        for kind, count in sorted(episodes.items())
    }


def _batches(config: BarrierPromiseConfig) -> Iterator[range]:
    last = config.first_seed + config.episodes
    for first in range(config.first_seed, last, config.batch):
        yield range(first, min(first + config.batch, last))


def _name(group: str, seeds: range) -> str:
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
        "least_barrier_m": min((part["least_m"] for part in parts if part["least_m"] is not None), default=None),
        "hours": hours,
        "integrity_risk": parts[0]["risk"],
        "level_exceeded_per_decision": exceptions["own level"] / decisions,
        "barrier_lost_per_decision": lost / decisions,
        "barrier_lost_per_hour": lost / hours,
        "counts": dict(sorted(counts.items())),
        "exceptions": dict(sorted(exceptions.items())),
        "filter": dict(sorted(filtered.items())),
        "breaches": [breach for part in parts for breach in part["breaches"]],
    }
