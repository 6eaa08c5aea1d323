"""The context-aware monitor in environments: entries, verdicts, log, refusals, and the display."""

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401
from lanebound.envs.context import CONTEXT_ENTRIES, ContextMonitoring, road_map_of
from lanebound.envs.rendering.config import ThemeName
from lanebound.envs.rendering.driver_display import DISPLAY_PX, with_display
from lanebound.envs.rendering.theme import THEMES
from lanebound.integrity.core.errors import InputError

RAW = {"sky": "open", "duration_s": 20.0, "navigator": {"gnss": {"undifferenced": True}}}


def driven(env, seconds: float = 12.0, seed: int = 3):
    """Info of each step of a drive straight on."""
    env.reset(seed=seed)
    still = np.zeros(env.action_space.shape, np.float32)
    return [env.step(still)[-1]["context"] for _ in range(round(seconds / env.unwrapped.dt_s))]


def test_a_drive_under_an_open_sky_becomes_trusted() -> None:
    env = ContextMonitoring(gymnasium.make("lanebound/LaneKeeping-v0", config=RAW))
    found = driven(env)
    assert found[0]["reason"] in ("COLLECTING", "SLOW", "UNAVAILABLE")
    assert found[-1]["light"] in ("green", "amber")
    assert any(f["phases"] == 3 and f["light"] == "green" and f["score"] > 71.0 for f in found)
    assert found[-1]["road"] != ""
    log = env.context.log
    assert [entry["light"] for entry in log][:2] == ["amber", "green"]
    assert env.context.advice
    env.reset(seed=4)
    assert len(env.context.log) <= 1  # the log is that of the episode


@pytest.mark.parametrize("form", ["dict", "flat"])
def test_observations_have_the_entries_and_follow_the_contract(form) -> None:
    config = {**RAW, "observation": {"form": form}}
    env = ContextMonitoring(gymnasium.make("lanebound/LaneKeeping-v0", config=config, disable_env_checker=True))
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    last = observation["context"] if form == "dict" else observation[-len(CONTEXT_ENTRIES) :]
    n = info["context"]
    np.testing.assert_allclose(last, [n["phases"] / 3, n["score"] / 100, n["link_probability"], n["warn"]], atol=1e-6)


def test_warnings_cost_what_is_asked_for() -> None:
    plain, dear = (
        ContextMonitoring(gymnasium.make("lanebound/LaneKeeping-v0", config=RAW), warning_cost=cost)
        for cost in (0.0, 2.0)
    )
    still = np.zeros(plain.action_space.shape, np.float32)
    for env in (plain, dear):
        env.reset(seed=1)
    a, b = plain.step(still)[-1], dear.step(still)[-1]
    assert a["context"]["warn"]
    assert b["cost_context"] == plain.unwrapped.dt_s
    assert b["cost"] - a["cost"] == pytest.approx(2.0 * plain.unwrapped.dt_s)
    with pytest.raises(InputError, match="warning_cost must be >= 0"):
        ContextMonitoring(gymnasium.make("lanebound/LaneKeeping-v0", config=RAW), warning_cost=-1.0)


def test_without_undifferenced_codes_it_is_refused() -> None:
    env = ContextMonitoring(gymnasium.make("lanebound/LaneKeeping-v0", config={"sky": "open"}))
    with pytest.raises(InputError, match=r"navigator\.gnss\.undifferenced must be true"):
        env.reset(seed=1)
    with pytest.raises(InputError, match="must be an environment of lanebound"):
        ContextMonitoring(gymnasium.make("CartPole-v1"))


@pytest.mark.parametrize("world", ["Roundabout", "Intersection", "Highway"])
def test_networks_become_maps(world) -> None:
    env = gymnasium.make(f"lanebound/{world}-v0", config={"sky": "open"})
    env.reset(seed=1)
    network = env.unwrapped.world.road.network
    road_map, names = road_map_of(network)
    assert len(names) == road_map.links == sum(len(onward) for onward in network.graph.values())
    for (a, b, _), lane in list(network.lanes_dict().items())[:8]:
        x, y = lane.position(0.5 * lane.length, 0.0)
        near = road_map.near([[x, -y]], 20.0, 8)
        assert names.index(f"{a}-{b}") in near.link[0]


def test_the_display_shows_the_light_above_the_picture() -> None:
    theme, picture = THEMES[ThemeName.DARK], np.zeros((120, 400, 3), np.uint8)
    shown = {light: with_display(picture, light, "words", "a-b", 80.0, theme) for light in ("green", "amber", "red")}
    for image in shown.values():
        assert image.shape == (120 + DISPLAY_PX, 400, 3)
        assert (image[DISPLAY_PX:] == 0).all()
    middle = DISPLAY_PX // 2
    assert len({tuple(image[middle, middle]) for image in shown.values()}) == 3
    assert tuple(shown["red"][middle, middle]) == theme.alert
