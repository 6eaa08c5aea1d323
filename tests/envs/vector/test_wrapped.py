"""Ids of highway-env that have none of ours: the engine drives them as ``wrap`` does."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import side_by_side
from lanebound.envs.registration import wrap, wrap_vec
from lanebound.envs.vector.engine import Engine
from lanebound.integrity.core.errors import ConfigError
from side_by_side import PERFECT, Tally, drive, require_equal

OWN: dict[str, Any] = {"reward": {"base": 0.5}}
CASES: list[tuple[str, dict[str, Any], int]] = [
    ("highway-fast-v0", OWN, 15),
    ("highway-fast-v0", {"action": "continuous"}, 6),
    ("exit-v0", OWN, 30),
    ("exit-v1", {"action": "continuous"}, 12),
    ("two-way-v0", OWN, 20),
    ("u-turn-v0", {**OWN, "action": "continuous"}, 12),
    ("u-turn-v1", OWN, 20),
]
SENSED: dict[str, Any] = {"sky": "open", "cities": {"count": 1}, "extent_m": 300.0, "world": {}}


def _named(value: Any) -> str:
    return value if isinstance(value, str) else value.get("action", "") if isinstance(value, dict) else ""


def _driven(base: str, config: dict[str, Any], steps: int, seeds: tuple[int | None, ...]) -> tuple[Tally, Engine]:
    single, engine = wrap(base, config), Engine(wrap(base, config), 2)
    tally = Tally()
    for seed in seeds:
        drive(single, engine, seed, tally, steps, row=1)
    return tally, engine


@pytest.mark.parametrize(("base", "config", "steps"), CASES, ids=_named)
def test_it_drives_as_the_single_environment(base: str, config: dict[str, Any], steps: int) -> None:
    tally, _ = _driven(base, {**PERFECT, **config}, steps, (3, 4, None))
    require_equal(tally, parted=1 if base.startswith("u-turn") else 0)  # whose slow cars crawl
    assert tally.steps >= 12


@pytest.mark.parametrize(
    ("base", "config"),
    [("highway-fast-v0", {**SENSED, "world": {"vehicles_count": 4}}), ("two-way-v0", SENSED), ("u-turn-v1", SENSED)],
    ids=_named,
)
def test_it_navigates_as_the_single_environment(base: str, config: dict[str, Any]) -> None:
    tally, _ = _driven(base, config, 6, (5, None))
    require_equal(tally)
    assert tally.steps >= 8


def test_others_drive_through_each_other_on_the_fast_highway() -> None:
    """They start one in the other; on ``highway-v0`` they crash."""
    config = {**PERFECT, "world": {"vehicles_density": 6.0, "ego_spacing": 0.01, "lanes_count": 2}}
    tally, engine = _driven("highway-fast-v0", config, 2, (1, 2))
    require_equal(tally)
    cars = engine.episodes.cars[1]
    pairs = (np.abs(np.subtract.outer(cars["x"], cars["x"])) < 4.0) & np.equal.outer(cars["lane"], cars["lane"])
    through = pairs[1:, 1:].sum(1) > 1
    assert through.any()
    assert (cars["crashed"][1:][through] == 0).any()


def test_the_lane_of_the_exit_is_rewarded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(side_by_side, "command", lambda single, seen, rng: 2)  # to the right
    config = {**PERFECT, "world": {"lanes_count": 2, "vehicles_count": 1}, "observation": {"form": "dict"}}
    single, engine = wrap("exit-v0", config), Engine(wrap("exit-v0", config), 1)
    tally, best = Tally(), 0.0
    for seed in range(2):
        drive(single, engine, seed, tally, 30)
        best = max(best, float(engine.outcome["base"][0]))
    require_equal(tally)
    assert best > 0.9


@pytest.mark.parametrize(
    ("base", "config", "message"),
    [
        ("two-way-v0", {"action_options": {"target_speeds": [20, 22, 30]}}, "target_speeds must be evenly spaced"),
        ("roundabout-v1", {"action_options": {"target_speeds": [0, 2, 16]}}, "target_speeds must be evenly spaced"),
        ("u-turn-v0", {"world": {"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle"}}, "other_vehic"),
        ("merge-generic-v0", {}, "base must have an engine, as .*two-way-v0.* do, got 'merge-generic-v0': choose one"),
        ("lane-keeping-v0", {}, "base must have an engine"),
        ("parking-v0", {}, "env_id must have lanes"),
    ],
)
def test_what_it_cannot_do_is_refused(base: str, config: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        wrap_vec(base, 2, {**PERFECT, **config})


def test_a_vector_of_a_wrapped_id_does_what_a_vector_of_single_ones_does() -> None:
    config = {**PERFECT, "duration_s": 2.0}
    mode = AutoresetMode.SAME_STEP
    engine, single = wrap_vec("two-way-v0", 2, config, mode), SyncVectorEnv([lambda: wrap("two-way-v0", config)] * 2,
                                                                            autoreset_mode=mode)  # fmt: skip
    assert isinstance(engine, gymnasium.vector.VectorEnv)
    seen, wanted = engine.reset(seed=5)[0], single.reset(seed=5)[0]
    ends = 0
    for n in range(8):
        for group in wanted:
            np.testing.assert_allclose(seen[group], wanted[group], atol=1e-6)
        if n == 4:
            engine = pickle.loads(pickle.dumps(engine))
        actions = np.array([n % 5, 1])
        seen, rewards, *over, _ = engine.step(actions)
        wanted, rewards_too, *over_too, _ = single.step(actions)
        np.testing.assert_allclose(rewards, rewards_too, atol=1e-9)
        np.testing.assert_array_equal(over, over_too)
        ends += int(np.sum(over))
    assert ends >= 2
    single.close()
