"""A vector engine and single environments under the same seeds and commands, compared at every step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.infos import infos_of, single_info

PERFECT: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
CLOSE = 1e-9  # of poses [m], [rad], [m/s], rewards and infos
SEEN = 1e-6  # of float32 observations


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
    reward, terminated, truncated, info = step
    cars, whole, out = engine.world.cars[row], engine.world.whole[row], engine.world.out[row]
    vehicles = single.world.road.vehicles
    tally.pose = max(tally.pose, float(np.abs(cars[:4] - poses(single)).max()))
    tally.observation = max(tally.observation, float(np.abs(engine.world.frame[row] - flat(single, seen)).max()))
    tally.reward = max(tally.reward, abs(float(out[k.O_REWARD]) - reward))
    lanes = [single.world.road.network.graph[a][b].index(v.lane) for v in vehicles for a, b, _ in [v.lane_index]]
    facts = {
        "lanes": (whole[k.LANE].tolist(), lanes),
        "crashed": ((whole[k.CRASHED] != 0).tolist(), [bool(v.crashed) for v in vehicles]),
        "ends": ((out[1] > 0.0, out[2] > 0.0), (terminated, truncated)),
    }
    tally.mismatches += [f"{where} {name}: {a} {b}" for name, (a, b) in facts.items() if a != b]
    limits = tuple(engine.rules.figures[[k.F_AL_AT, k.F_AL_CT]].tolist())
    _same_info(tally, where, single_info(infos_of(engine.world, limits), row), info)


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
    assert (engine.world.cars[row, :4] == poses(single)).all(), "an episode must start from the same bits"
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
    assert tally.observation < SEEN, tally
