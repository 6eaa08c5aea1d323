"""A cold start: nobody tells the ego its pose, and there is no level before its heading is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.envs import make_config, wrap
from lanebound.envs.scene import navigator_config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.navigators.navigator import Start
from lanebound.integrity.positioning.modes import Mode
from side_by_side import pair

COLD: dict[str, Any] = {"sky": "open", "navigation": {"start": "cold", "warm_up_s": 0.5}, "duration_s": 12.0}


def test_the_default_start_is_told() -> None:
    config = make_config("lanebound/LaneKeeping-v0")
    assert config.navigation.start is Start.TOLD
    assert navigator_config(config, (1.5, 1.0)).start is Start.TOLD


def test_a_single_environment_starts_cold_and_finds_its_pose() -> None:
    env = wrap("highway-v0", {**COLD, "world": {"vehicles_count": 0}, "perception": {"source": "none"}})
    env.reset(seed=3)
    beliefs = []
    for _ in range(20):
        env.step(1)
        b = env.belief_loop.belief()
        car = env.world.vehicle
        beliefs.append((b.pl_ct_m, b.alert, b.mode, np.hypot(*(b.position_m - car.position))))
    levels, alerts, modes, errors = map(np.array, zip(*beliefs, strict=True))
    assert np.isfinite(levels[-1])
    assert modes[-1] == Mode.RTK
    assert errors[-1] < 0.5
    assert (errors < 15.0).all()
    assert alerts[~np.isfinite(levels)].all()


def test_the_level_is_missing_until_the_heading_is_known() -> None:
    """A car that stands has no course: its position may be fixed, but it has no level."""
    config = {**COLD, "navigation": {"start": "cold", "warm_up_s": 3.0}, "world": {"vehicles_count": 0}}
    for start, known in (("cold", False), ("told", True)):
        env = wrap("highway-v0", {**config, "navigation": {"start": start, "warm_up_s": 0.1}})
        observation, _ = env.reset(seed=3)
        assert np.isfinite(env.belief_loop.belief().pl_ct_m) == known
        assert all(np.isfinite(part).all() for part in _arrays(observation))


def _arrays(observation: Any) -> list[Any]:
    return list(observation.values()) if isinstance(observation, dict) else [observation]


def test_the_engine_starts_cold_as_the_single_environment_does() -> None:
    single, engine = pair("LaneKeeping", COLD)
    single.reset(seed=5)
    engine.reset(np.array([0]), [5])
    levels = []
    for _ in range(12):
        single.step(np.zeros(single.action_space.shape, np.float32))
        engine.step(np.zeros((1, *single.action_space.shape), np.float32))
        mine, theirs = single.belief_loop.belief(), engine.episodes.ego["belief"][0]
        levels.append(mine.pl_ct_m)
        assert (mine.mode, mine.alert) == (theirs["mode"], bool(theirs["alert"]))
        np.testing.assert_allclose(mine.position_m, [theirs["x_m"], theirs["y_m"]], atol=1e-6)
        np.testing.assert_allclose(mine.pl_ct_m, theirs["pl_ct_m"], atol=1e-6)
    assert np.isfinite(levels[-1])


@pytest.mark.parametrize("value", ["warm", 3])
def test_another_start_is_refused(value: Any) -> None:
    with pytest.raises(ConfigError, match=r"navigation\.start"):
        make_config("lanebound/LaneKeeping-v0", {"navigation": {"start": value}})
