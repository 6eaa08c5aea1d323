"""A vector engine and single environments under the same seeds and commands, compared at every step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lanebound.envs.batch.infos import form_of, infos_of, results, single_info
from lanebound.envs.config import ActionKind
from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.vector.engine import Engine
from lanebound.envs.worlds.drivers import CityDriver, LeadVehicle

PERFECT: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
CLOSE = 1e-9  # of poses [m], [rad], [m/s], rewards and infos
SEEN = 1e-6  # of float32 observations
CRAWL_MPS = 0.8  # at 20 Hz highway-env's steering swings out below 0.52 m/s, and multiplies what rounding there is
SWUNG = 0.05  # of all numbers of a step in which a driver crawls


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
    swung: float = 0.0
    speeds: dict[int, Any] = field(default_factory=dict)
    mismatches: list[str] = field(default_factory=list)


def pair(name: str, config: dict[str, Any], count: int = 1) -> tuple[DrivingEnv, Engine]:
    """A single environment, and an engine of ``count``, of the same configuration."""
    made = make_config(f"lanebound/{name}-v0", config)
    return DrivingEnv(made), Engine(DrivingEnv(made), count)


def poses(single: DrivingEnv) -> Any:
    return np.array([(*v.position, v.heading, v.speed) for v in single.world.road.vehicles], dtype=np.float64).T


def flat(single: DrivingEnv, observation: Any) -> Any:
    return np.concatenate([observation[group] for group in single.observer.slices])


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
    """Compare everything after a step; where somebody crawls, less closely, and the engine goes on from there."""
    reward, terminated, truncated, info = step
    e, vehicles, true = engine.episodes, single.world.road.vehicles, poses(single)
    out, count = e.ego.outcome[row], len(vehicles)
    driven = np.array([column[row, :count] for column in (e.cars.x, e.cars.y, e.cars.heading, e.cars.speed)])
    part = Tally() if _crawls(tally, single, true[3]) else tally
    part.pose = max(part.pose, float(np.abs(driven - true).max()))
    part.observation = max(part.observation, float(np.abs(e.frame[row] - flat(single, seen)).max()))
    part.reward = max(part.reward, abs(float(out["reward"]) - reward))
    lanes = [e.table.row[v.lane_index] for v in vehicles]
    facts = {
        "there": (int(e.cars.present[row]), count),
        "lanes": (e.cars.lane[row, :count].tolist(), lanes),
        "crashed": ((e.cars.crashed[row, :count] != 0).tolist(), [bool(v.crashed) for v in vehicles]),
        "ends": ((out["terminated"] > 0.0, out["truncated"] > 0.0), (terminated, truncated)),
    }
    tally.mismatches += [f"{where} {name}: {a} {b}" for name, (a, b) in facts.items() if a != b]
    infos = infos_of(results(e.ego.outcome), form_of(np.ones(engine.count, dtype=np.bool_)))
    _same_info(part, where, single_info(infos, row), info)
    if part is not tally:
        tally.mismatches += part.mismatches
        tally.crawls += 1
        tally.swung = max(tally.swung, part.pose, part.observation, part.reward, part.info)
        _go_on_from(engine, row, true, _steers_itself(single))


def _go_on_from(engine: Engine, row: int, true: Any, ego: bool) -> None:
    """Put the vehicles of an engine where those of a single environment are; the ego as well where it says so."""
    cars, drivers, belief = engine.episodes.cars, engine.drivers, engine.episodes.ego.belief
    taken = slice(0 if ego else 1, true.shape[1])
    for column, values in zip((cars.x, cars.y, cars.heading, cars.speed), true, strict=True):
        column[row, taken] = values[taken]
    drivers.cos[row], drivers.sin[row] = np.cos(cars.heading[row]), np.sin(cars.heading[row])
    if ego:
        for name, value in zip(("x_m", "y_m", "heading_rad", "speed_mps"), true[:, 0], strict=True):
            belief[name][row] = value


def _crawls(tally: Tally, single: DrivingEnv, speeds: Any) -> bool:
    """Whether somebody who steers as ControlledVehicle does, and not along a straight lane's middle, has crawled."""
    before = tally.speeds.get(id(single))
    tally.speeds[id(single)] = speeds
    drivers = [i for i, v in enumerate(single.world.road.vehicles) if isinstance(v, CityDriver | LeadVehicle)]
    drivers += [0] if _steers_itself(single) else []
    if not drivers or before is None or before.size != speeds.size:
        return False
    both = np.abs([before[drivers], speeds[drivers]])
    return bool(((both.min(0) < CRAWL_MPS) & (both.max(0) > 0.0)).any())


def _steers_itself(single: DrivingEnv) -> bool:
    """Whether the ego is steered by highway-env's own law, from a pose that it knows."""
    c = single.config
    return c.action is ActionKind.META and not c.navigation.source.senses


def _same_info(tally: Tally, where: str, got: dict[str, Any], info: dict[str, Any]) -> None:
    if set(got) != set(info):
        tally.mismatches.append(f"{where} info: {set(got) ^ set(info)}")
    for name, value in info.items():
        if isinstance(value, dict):
            _same_info(tally, f"{where} {name}", got[name], value)
        elif type(value) is not type(got[name]):
            tally.mismatches.append(f"{where} {name}: {got[name]!r} {value!r}")
        elif isinstance(value, float):
            difference = 0.0 if value == got[name] else abs(value - got[name])
            tally.info = max(tally.info, difference)
        elif value != got[name]:
            tally.mismatches.append(f"{where} {name}: {got[name]!r} {value!r}")


def drive(
    single: DrivingEnv, engine: Engine, seed: int | None, tally: Tally, steps: int = 10_000, row: int = 0
) -> None:
    """One episode of both, until it ends; a seed of None goes on from where both are."""
    rows = np.array([row])
    rng = np.random.default_rng(seed)
    seen, info = single.reset(seed=seed)
    engine.reset(rows, [seed])
    targets = [v.target_lane_index for v in single.world.road.vehicles[1:] if hasattr(v, "timer")]
    begun = poses(single)
    cars = engine.episodes.cars
    placed = [column[row, : begun.shape[1]] for column in (cars.x, cars.y, cars.heading, cars.speed)]
    assert (np.array(placed) == begun).all(), "an episode must start from the same bits"
    same(tally, f"seed {seed} start", engine, row, single, seen, (0.0, False, False, info))
    actions = np.zeros((engine.count, *single.action_space.shape), dtype=single.action_space.dtype)
    for n in range(steps):
        actions[row] = command(single, seen, rng)
        chosen = int(actions[row]) if actions[row].ndim == 0 else actions[row]
        seen, reward, terminated, truncated, info = single.step(chosen)
        engine.step(actions, rows)
        same(tally, f"seed {seed} step {n}", engine, row, single, seen, (reward, terminated, truncated, info))
        now = [v.target_lane_index for v in single.world.road.vehicles[1:] if hasattr(v, "timer")]
        tally.lane_changes += sum(a != b for a, b in zip(targets, now, strict=True))
        tally.steps, targets = tally.steps + 1, now
        if terminated or truncated:
            break
    tally.episodes += 1
    tally.crashes += bool(info["crashed"])


def require_equal(tally: Tally) -> None:
    """No discrete mismatch, and every difference within rounding."""
    assert tally.mismatches == []
    assert max(tally.pose, tally.reward, tally.info) < CLOSE, tally
    assert tally.swung < SWUNG, tally
    assert tally.observation < SEEN, tally
