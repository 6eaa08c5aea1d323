"""Policies that come along drive the ids that they were learnt in, by themselves and in batches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.learnt import LearntDriver, policies
from lanebound.agents.episodes.opening import open_env
from lanebound.envs.registration import IDS
from lanebound.integrity.core.errors import InputError

LAYERS = [
    (np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], np.float32), np.zeros(3, np.float32)),
    (np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 2.0]], np.float32), np.array([0.0, 0.5], np.float32)),
]

SEEN = {"columns": np.array(["a"]), "scales": np.ones(1), "discrete": np.array(False)}


def _id_of(base: str) -> str:
    return next(name for name in IDS if open_env(name).config.base == base)


def test_every_id_has_one() -> None:
    assert {_id_of(base) for base in policies()} == set(IDS)


@pytest.mark.parametrize("base", sorted(policies()))
def test_each_drives_the_id_that_it_was_learnt_in(base: str) -> None:
    name = _id_of(base)
    file = policies()[base]
    assert len(file.read_bytes()) < 1_000_000
    card = file.with_name(f"{base}.md").read_text(encoding="utf-8")
    assert f"It takes flat observations of `{name}`" in card
    env = open_env(name, {"duration_s": 2.0})
    driver = make_agent("ppo", env)
    observation, _ = env.reset(seed=1000)
    over = False
    while not over:
        action, _ = driver.predict(observation)
        assert env.action_space.contains(action if isinstance(env.action_space, spaces.Box) else int(action))
        observation, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
    env.close()


def test_the_largest_value_is_the_discrete_action() -> None:
    driver = LearntDriver(LAYERS, discrete=True)
    seen = np.array([[3.0, -3.0], [-1.0, 2.0]], np.float32)
    hidden = np.tanh(np.stack([seen[:, 0], seen[:, 1], seen.sum(1)], -1))
    values = np.stack([hidden[:, 0], hidden[:, 1] + 2.0 * hidden[:, 2] + 0.5], -1)
    assert driver.predict(seen)[0].tolist() == values.argmax(-1).tolist() == [0, 1]
    assert driver.predict(seen[0])[0] == 0
    np.testing.assert_allclose(LearntDriver(LAYERS).predict(seen)[0], values.clip(-1.0, 1.0), rtol=1e-6)


def test_other_actions_than_it_learnt_with_are_refused() -> None:
    base = "LaneKeepingWorld"
    differing = r"with actions Box\(2,\), got an environment that takes Discrete\(5\): "
    with pytest.raises(InputError, match=f"'ppo' was learnt in {base} {differing}leave 'action' as it was there"):
        make_agent("ppo", open_env(_id_of(base), {"action": "meta"}))


def test_a_file_of_other_actions_says_which_and_where_it_can_drive(tmp_path: Path) -> None:
    steered, meta = r"Box\(2,\)", r"Discrete\(5\)"
    for world, name, learnt, taken in (
        ("LaneKeepingWorld", "Merge", steered, meta),
        ("merge-v1", "LaneKeeping", meta, steered),
    ):
        path = tmp_path / "mine.npz"
        path.write_bytes(policies()[world].read_bytes())
        told = f"learnt with actions {learnt}, got an environment that takes {taken}: drive an id that has it, or learn"
        with pytest.raises(InputError, match=told):
            make_agent(str(path), open_env(name))


def test_a_file_of_arrays_drives_as_what_came_along(tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    path.write_bytes(policies()["LaneKeepingWorld"].read_bytes())
    env = open_env("LaneKeeping")
    seen = env.observation_space.sample()
    mine = make_agent(str(path), env)
    np.testing.assert_array_equal(mine.predict(seen)[0], make_agent("ppo", env).predict(seen)[0])
    for other, refusal in (
        ({"vehicles": 2}, r"observation must show .*mine\.npz .* without 'traffic\.v2_present' and 75 more"),
        ({"speed_max_mps": 20}, r"the scale of 'ego\.speed' must be 40"),
        ({"history": 2}, r"observation\.history must be 1"),
    ):
        with pytest.raises(InputError, match=refusal):
            make_agent(str(path), open_env("LaneKeeping", {"observation": other}))


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({}, "must be as 'lanebound export' writes it, got .*columns"),
        (dict(list(SEEN.items())[:2]), "must be as 'lanebound export' writes it, got .*discrete"),
        (SEEN, "must hold layers weight_0, bias_0, ..., got none"),
        ({**SEEN, "weight_0": np.ones((2, 2)), "bias_0": np.ones(2)}, r"must be finite, \(m, 1\)"),
        ({**SEEN, "weight_0": np.full((2, 1), np.nan), "bias_0": np.ones(2)}, "must be finite"),
        ({**SEEN, "weight_0": np.array([["x"]]), "bias_0": np.ones(1)}, "must be as 'lanebound export' writes it"),
        ({**SEEN, "weight_0": np.ones(1), "bias_0": np.array(1.0)}, "must be finite"),
        ({**SEEN, "weight_0": np.ones((2, 1))}, "must be as 'lanebound export' writes it"),
    ],
)
def test_a_file_that_is_no_policy_is_refused(tmp_path: Path, arrays: dict[str, Any], reason: str) -> None:
    path = tmp_path / "mine.npz"
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=reason):
        make_agent(str(path), open_env("LaneKeeping"))
    with path.open("wb") as stream:
        np.save(stream, np.ones(3))
    with pytest.raises(InputError, match="must be as 'lanebound export' writes it"):
        make_agent(str(path), open_env("LaneKeeping"))
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match="must be as 'lanebound export' writes it"):
        make_agent(str(path), open_env("LaneKeeping"))
