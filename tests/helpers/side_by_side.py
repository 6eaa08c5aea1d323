"""A vector engine and single environments under the same seeds and commands, compared at every step.

Both drive by themselves; nothing of one is copied into the other. Every pose agrees within 1e-9, and every decision
exactly, up to the step in which rounding may part the two. Rounding itself is unequal: NumPy's arcsine, arctangent and
tangent, by which highway-env steers, differ from the C library's in the last bit. Three causes are accepted.

Crawl: a vehicle that steers by highway-env's law (``ControlledVehicle``) is slow. By that law the offset from the
middle of the lane changes in a simulation step dt at the speed v by the factor ``1 - (L / 2) k_heading k_lateral dt
/ v``: below ``v = (L / 4) k_heading k_lateral dt`` (0.52 m/s at 20 Hz for L = 5 m) its size exceeds 1, and each step
multiplies rounding, by 9 at 0.1 m/s and by 100 at most. The cause holds where the vehicle whose pose differs most has
been slower than 1.5 times that speed in the policy step, without standing all the time; speeds are known at its ends.

Tie: two vehicles crash whose headings agree within 1e-5 rad. highway-env pushes them apart along the side of that body
along which they overlap least; where the bodies are in line, both overlap alike, and rounding chooses the side.

Lanes: two lanes overlap, so that both are as near to a vehicle but for rounding; only racetracks have such lanes.

An episode parts at the first step in which a pose differs by more than 1e-9, if one of the causes holds. It is compared
no further and counted; :func:`require_equal` bounds the count. Any other difference is a failure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle

from lanebound.envs.batch.ego_kernel import KP_HEADING, KP_LATERAL
from lanebound.envs.batch.infos import form_of, infos_of, results, single_info
from lanebound.envs.batch.lanes_kernel import closest
from lanebound.envs.config import ActionKind
from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.support import support_of

PERFECT: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
CLOSE = 1e-9  # of poses [m], [rad], [m/s], rewards and infos
SEEN = 1e-6  # of float32 observations
CRAWL = 1.5  # of the speed below which rounding grows
IN_LINE_RAD = 1e-5
POSE = ("x", "y", "heading", "speed")


class _Episode:
    """What may part the two in the present episode of a single environment."""

    def __init__(self, single: DrivingEnv) -> None:
        self.apart, self.crawled = False, False
        self._before = _now(single)

    def cause(self, single: DrivingEnv, most: int) -> str:
        """Why the two may part in this step, in which vehicle ``most`` differs most; called at every step."""
        (_, _, heading, speed), now = poses(single), _now(single)
        before = [self._before.get(v, now[v]) for v in now]  # one that has entered is as it is
        crashed, speed_before = np.array([c for _, c in now.values()]), np.array([speed for speed, _ in before])
        both = np.abs([speed_before, speed])
        crawl_mps = CRAWL * 0.25 * single.world.vehicle.LENGTH * KP_HEADING * KP_LATERAL / single.config.simulation_hz
        crawls = (both.min(0) < crawl_mps) & (both.max(0) > 0.0) & _steered(single)
        new = crashed & ~np.array([c for _, c in before])
        turned = np.abs(np.sin(heading[new][:, None] - heading[crashed]))
        tie = bool(((turned < IN_LINE_RAD).sum(1) > 1).any())  # each is in line with itself
        self.crawled = self.crawled or bool(crawls.any())
        self._before = now
        return "crawl" if crawls[most] else "tie" if tie and crashed[most] else ""


def _now(single: DrivingEnv) -> dict[Any, tuple[float, bool]]:
    """Speed, and whether it has crashed, of each vehicle."""
    return {v: (float(v.speed), bool(v.crashed)) for v in vehicles_of(single)}


def _steered(single: DrivingEnv) -> Any:
    """Which vehicles steer by highway-env's law; drivers of a straight motorway do not crawl."""
    c, vehicles = single.config, vehicles_of(single)
    pursues = c.actuators is not None and c.actuators.steering_rate_radps is not None
    ego = c.action is ActionKind.META and not pursues
    others = support_of(c).traffic != "motorway"
    return np.array([ego if i == 0 else others and isinstance(v, ControlledVehicle) for i, v in enumerate(vehicles)])


@dataclass
class Tally:
    """What has been compared, and the largest differences."""

    steps: int = 0
    episodes: int = 0
    crashes: int = 0
    lane_changes: int = 0
    pose: float = 0.0
    observation: float = 0.0
    reward: float = 0.0
    info: float = 0.0
    crawls: int = 0
    parted: list[str] = field(default_factory=list)
    mismatches: list[str] = field(default_factory=list)
    _now: dict[int, _Episode] = field(default_factory=dict, repr=False)

    def begin(self, single: DrivingEnv) -> None:
        """An episode begins."""
        self.episodes += 1
        self._now[id(single)] = _Episode(single)

    def apart(self, single: DrivingEnv) -> bool:
        """Whether rounding has parted the two in this episode."""
        return self._now[id(single)].apart

    def parts(self, single: DrivingEnv, where: str, off: Any) -> bool:
        """Whether rounding parts the two in a step, in which vehicles differ by ``off`` (V,); called at every step."""
        episode = self._now[id(single)]
        crawled, cause = episode.crawled, episode.cause(single, int(off.argmax()))
        self.crawls += episode.crawled and not crawled
        if cause and off.max() > CLOSE:
            episode.apart = True
            self.parted.append(f"{cause}, {where}: {off.max():.1e}")
        return episode.apart

    def part(self, single: DrivingEnv, cause: str) -> None:
        """Rounding parts the two in this step."""
        self._now[id(single)].apart = True
        self.parted.append(cause)


def pair(name: str, config: dict[str, Any], count: int = 1) -> tuple[DrivingEnv, Engine]:
    """A single environment, and an engine of ``count``, of the same configuration."""
    made = make_config(f"lanebound/{name}-v0", config)
    return DrivingEnv(made), Engine(DrivingEnv(made), count)


def vehicles_of(single: DrivingEnv) -> list[Any]:
    """The ego, and the others in the order of the world."""
    ego = single.world.vehicle
    return [ego, *(v for v in single.world.road.vehicles if v is not ego)]


def poses(single: DrivingEnv) -> Any:
    return np.array([(*v.position, v.heading, v.speed) for v in vehicles_of(single)], dtype=np.float64).T


def flat(single: DrivingEnv, observation: Any) -> Any:
    return np.concatenate([observation[group] for group in single.observer.slices])


def newest(single: DrivingEnv, observation: Any) -> Any:
    """The last observation of a stack, by group."""
    return {group: part[-(s.stop - s.start) :] for (group, s), part in zip(
        single.observer.slices.items(), observation.values(), strict=True)}  # fmt: skip


def command(single: DrivingEnv, observation: Any, rng: np.random.Generator) -> Any:
    """Random meta-actions; or a driver that keeps its lane with unsteady hands."""
    if hasattr(single.action_space, "n"):
        return int(rng.integers(single.action_space.n))
    index = {entry.column: n for n, entry in enumerate(single.observer.index)}
    seen = flat(single, observation)
    bend = seen[index["road.preview_10m_right"]] + 0.3 * rng.standard_normal() * (rng.random() < 0.3)
    both = np.clip([0.4 * rng.standard_normal() + 0.1, 1.2 * bend], -1.0, 1.0)
    return both[: single.action_space.shape[0]].astype(np.float32)


def same(tally: Tally, where: str, engine: Engine, row: int, single: DrivingEnv, seen: Any, step: Any) -> None:
    """Compare everything after a step, up to the step in which rounding may part the two."""
    if tally.apart(single):
        return
    reward, terminated, truncated, info = step
    e, vehicles, true = engine.episodes, vehicles_of(single), poses(single)
    out, count = e.ego["outcome"][row], len(vehicles)
    driven = np.array([e.cars[name][row, :count] for name in POSE])
    off = np.abs(driven - true).max(0)
    if tally.parts(single, where, off):
        return
    tally.pose = max(tally.pose, float(off.max()))
    tally.observation = max(tally.observation, float(np.abs(e.frame[row] - flat(single, seen)).max()))
    tally.reward = max(tally.reward, abs(float(out["reward"]) - reward))
    lanes = [e.table.row[v.lane_index] for v in vehicles]
    if _overlapping(engine, e.cars[row, :count], lanes):
        tally.part(single, f"lanes, {where}")
        return
    facts = {
        "there": (int(e.ego["vehicles"][row]), count),
        "lanes": (e.cars["lane"][row, :count].tolist(), lanes),
        "crashed": ((e.cars["crashed"][row, :count] != 0).tolist(), [bool(v.crashed) for v in vehicles]),
        "ends": ((out["terminated"] > 0.0, out["truncated"] > 0.0), (terminated, truncated)),
    }
    tally.mismatches += [f"{where} {name}: {a} {b}" for name, (a, b) in facts.items() if a != b]
    infos = infos_of(results(e.ego["outcome"]), form_of(np.ones(engine.count, dtype=np.bool_)), engine.own_info)
    _same_info(tally, where, single_info(infos, row), info)


def _overlapping(engine: Engine, cars: Any, lanes: list[int]) -> bool:
    """Whether the lane of a vehicle differs, and rounding decides between two that overlap."""
    other = [i for i, lane in enumerate(lanes) if cars["lane"][i] != lane]
    table, nothing = engine.episodes.table.lanes, np.zeros(len(engine.episodes.table.index))
    poses = [(float(cars["x"][i]), float(cars["y"][i]), float(cars["heading"][i])) for i in other]
    return bool(other) and not any(closest(table, *pose, nothing)[1] for pose in poses)


def _same_info(tally: Tally, where: str, got: dict[str, Any], info: dict[str, Any]) -> None:
    if set(got) != set(info):
        tally.mismatches.append(f"{where} info: {set(got) ^ set(info)}")
    for name, value in info.items():
        if isinstance(value, dict):
            _same_info(tally, f"{where} {name}", got[name], value)
        elif type(value) is not type(got[name]):
            tally.mismatches.append(f"{where} {name}: {got[name]!r} {value!r}")
        elif isinstance(value, np.ndarray):
            tally.info = max(tally.info, float(np.abs(value - got[name]).max()))
        elif isinstance(value, float):
            difference = 0.0 if value == got[name] else abs(value - got[name])
            tally.info = max(tally.info, difference)
        elif value != got[name]:
            tally.mismatches.append(f"{where} {name}: {got[name]!r} {value!r}")


def _targets(single: DrivingEnv) -> dict[Any, Any]:
    """Where the others that change lanes want to be."""
    return {v: v.target_lane_index for v in vehicles_of(single)[1:] if hasattr(v, "timer")}


def drive(
    single: DrivingEnv, engine: Engine, seed: int | None, tally: Tally, steps: int = 10_000, row: int = 0
) -> None:
    """One episode of both, until it ends; a seed of None goes on from where both are."""
    rows = np.array([row])
    rng = np.random.default_rng(seed)
    seen, info = single.reset(seed=seed)
    engine.reset(rows, [seed])
    targets = _targets(single)
    begun = poses(single)
    cars = engine.episodes.cars
    placed = [cars[name][row, : begun.shape[1]] for name in POSE]
    rounding = CLOSE if engine.before else 0.0  # where the traffic has driven before the start
    assert np.abs(np.array(placed) - begun).max() <= rounding, "an episode must start from the same bits"
    tally.begin(single)
    same(tally, f"seed {seed} start", engine, row, single, seen, (0.0, False, False, info))
    actions = np.zeros((engine.count, *single.action_space.shape), dtype=single.action_space.dtype)
    for n in range(steps):
        actions[row] = command(single, seen, rng)
        chosen = int(actions[row]) if actions[row].ndim == 0 else actions[row]
        seen, reward, terminated, truncated, info = single.step(chosen)
        engine.step(actions, rows)
        same(tally, f"seed {seed} step {n}", engine, row, single, seen, (reward, terminated, truncated, info))
        now = _targets(single)
        tally.lane_changes += sum(v in now and now[v] != lane for v, lane in targets.items())
        tally.steps, targets = tally.steps + 1, now
        if terminated or truncated or tally.apart(single):
            break
    tally.crashes += bool(info["crashed"])


def require_equal(tally: Tally, parted: int = 0) -> None:
    """No discrete mismatch, every difference within rounding, and ``parted`` episodes at most that part."""
    assert tally.mismatches == []
    assert max(tally.pose, tally.reward, tally.info) < CLOSE, tally
    assert tally.observation < SEEN, tally
    assert len(tally.parted) <= parted, tally.parted


class Pairs:
    """Single environments and an engine, started at once and driven by the same commands."""

    def __init__(self, name: str, config: dict[str, Any], count: int, seed: int, tally: Tally | None = None) -> None:
        made = make_config(f"lanebound/{name}-v0", config)
        self.singles, self.engine = [DrivingEnv(made) for _ in range(count)], Engine(DrivingEnv(made), count)
        self.tally, self._rng = tally or Tally(), np.random.default_rng(seed)
        self._views: list[Any] = [None] * count
        self.reset(np.arange(count), seed)

    def reset(self, rows: Any, seed: int | None, faults: Sequence[Any] = ()) -> None:
        """Start some of them anew, under this seed and those after it, or where their generators are.

        faults: of each of them, None for random ones.
        """
        seeds: list[int | None] = [None if seed is None else seed + n for n in range(rows.size)]
        given = faults or [None] * rows.size
        self.engine.reset(rows, seeds, given)
        for row, own, some in zip(rows.tolist(), seeds, given, strict=True):
            options = None if some is None else {"faults": list(some)}
            self._views[row], info = self.singles[row].reset(seed=own, options=options)
            self.tally.begin(self.singles[row])
            self._compare(f"{row} start", row, (0.0, False, False, info))

    def step(self, count: int) -> None:
        """Drive on by so many steps, or until the first episode is over."""
        for n in range(count):
            actions = [
                command(single, newest(single, seen), self._rng)
                for single, seen in zip(self.singles, self._views, strict=True)
            ]
            self.engine.step(np.array(actions))
            over = False
            for row, single in enumerate(self.singles):
                self._views[row], reward, terminated, truncated, info = single.step(actions[row])
                self._compare(f"{row} step {n}", row, (reward, terminated, truncated, info))
                over = over or terminated or truncated
                self.tally.steps += 1
            if over:
                return

    def _compare(self, where: str, row: int, told: Any) -> None:
        single = self.singles[row]
        same(self.tally, where, self.engine, row, single, newest(single, self._views[row]), told)
