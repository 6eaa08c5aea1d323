"""Extensions of docs/extending.md that environments and logs show; those of navigators and sensors have tests there."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from types import ModuleType

import gymnasium
import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes import EpisodeLog, drive, open_env
from lanebound.agents.episodes.columns import COLUMNS, columns, register_column, withdraw_column
from lanebound.envs.ids import withdraw_id
from lanebound.envs.observation import ObservationConfig, entries, withdraw_entry
from lanebound.envs.worlds import withdraw_world
from lanebound.integrity.core.errors import InputError


def _load(name: str) -> ModuleType:
    """Import a plug-in anew, as a first import does."""
    sys.modules.pop(name, None)
    return importlib.import_module(name)


@pytest.fixture
def stopping_distance() -> Iterator[int]:
    """Where the entry stands in the flat form."""
    entry = _load("stopping_distance").STOPPING_DISTANCE
    yield [other.column for other in entries(ObservationConfig())].index("ego.stopping_distance")
    withdraw_entry(entry)


@pytest.fixture
def hairpin() -> Iterator[str]:
    kind = _load("hairpin").Hairpin
    yield "lanebound/Hairpin-v0"
    withdraw_id(kind)
    withdraw_world("HairpinWorld")


def test_an_observation_entry_is_shown_by_environments_and_the_engine(stopping_distance: int) -> None:
    config = {"sky": "open", "observation": {"form": "flat"}, "navigation": {"source": "perfect"}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=config)
    observation, info = env.reset(seed=1)
    env.close()
    wanted = info["speed_mps"] ** 2 / 6.0 / 50.0
    assert observation[stopping_distance] == pytest.approx(wanted, rel=0.02)
    engine = gymnasium.make_vec("lanebound/LaneKeeping-v0", num_envs=2, config=config)
    observations, _ = engine.reset(seed=1)
    engine.close()
    np.testing.assert_allclose(observations[0, stopping_distance], observation[stopping_distance], rtol=1e-5)


def test_a_world_drives_alone_and_in_the_engine(hairpin: str) -> None:
    env = gymnasium.make(hairpin, config={"sky": "open"})
    observation, _ = env.reset(seed=1)
    agent, turned, done = make_agent("cruise", env.unwrapped), 0.0, False
    while not done:
        observation, _, terminated, truncated, _ = env.step(agent.predict(observation)[0])
        done, turned = terminated or truncated, max(turned, abs(env.unwrapped.world.vehicle.heading))
    env.close()
    assert (terminated, truncated) == (False, True)
    assert turned > 3.0
    engine = gymnasium.make_vec(hairpin, num_envs=2, config={"sky": "open"})
    engine.reset(seed=1)
    infos = engine.step(np.zeros((2, 2), dtype=np.float32))[4]
    engine.close()
    assert (infos["speed_mps"] > 7.0).all()


def test_a_column_is_logged() -> None:
    module = _load("headway_column")
    try:
        assert columns() == (*COLUMNS, columns()[-1])
        env, log = open_env("CarFollowing", {"sky": "open", "duration_s": 2.0}, None), EpisodeLog()
        drive(env, make_agent("cruise", env), [1], [log])
        env.close()
        table = log.to_table()
        assert table.schema.field("headway_s").metadata[b"unit"] == b"s"
        found, gap = (table[name].to_numpy() for name in ("headway_s", "gap_m"))
        assert (found > 0.0).all()
        near = gap < 100.0
        np.testing.assert_allclose((found * table["speed_mps"].to_numpy())[near], gap[near])
        with pytest.raises(InputError, match="name of a column must not be taken, got 'headway_s'"):
            register_column(columns()[-1])
    finally:
        withdraw_column("headway_s")
    assert columns() == COLUMNS
    assert module.headway_s
