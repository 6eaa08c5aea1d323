"""The context monitor in environments and the engine: entries, cost, read-out, refusals, and the display."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import lanebound.envs  # noqa: F401
from lanebound.envs import make_config
from lanebound.envs.context import context_of
from lanebound.envs.observation.index import entries
from lanebound.envs.rendering.config import ThemeName
from lanebound.envs.rendering.panel import DISPLAY_PX, with_display
from lanebound.envs.rendering.theme import THEMES
from lanebound.envs.road_map import road_map_of
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring.alerts import AlertReason

ENTRIES = ("context_warning", "context_phases", "context_score", "link_probability")
WATCHED: dict[str, Any] = {"sky": "open", "duration_s": 20.0, "navigator": {"context": {}}}
CODES = {"navigator": {"kind": "monitored_codes", "monitor": {"kind": "context"}}}


def place_of(config: Any) -> dict[str, int]:
    """Places of the entries of the monitor in the flat form."""
    return {entry.name: place for place, entry in enumerate(entries(config.observation)) if entry.name in ENTRIES}


def test_the_index_has_the_entries_where_a_monitor_is_configured() -> None:
    for config, count in (({}, 0), (WATCHED, 4), (CODES, 4)):
        made = make_config("lanebound/LaneKeeping-v0", config)
        assert len(place_of(made)) == count
        reasons = [entry.name for entry in entries(made.observation) if entry.name.startswith("reason_")]
        assert ("reason_context_warning" in reasons) is bool(count)
    blind = {**WATCHED, "observation": {"integrity": "blind"}}
    assert not place_of(make_config("lanebound/LaneKeeping-v0", blind))
    with pytest.raises(ConfigError, match=r"context\.alert is not a known key"):
        gymnasium.make("lanebound/LaneKeeping-v0", config={"navigator": {"context": {"alert": True}}})


def test_a_drive_under_an_open_sky_becomes_trusted_and_is_observed() -> None:
    env = gymnasium.make("lanebound/LaneKeeping-v0", config={**WATCHED, "observation": {"form": "flat"}})
    base: Any = env.unwrapped
    observation, _ = env.reset(seed=3)
    places, lights = place_of(base.config), []
    still = np.zeros(2, np.float32)
    for step in range(round(9.0 / base.dt_s)):
        shown = context_of(base)
        seen = {name: float(observation[place]) for name, place in places.items()}
        assert seen["context_phases"] == pytest.approx(shown.phases / 3.0)
        assert seen["context_score"] == pytest.approx(shown.score / 100.0)
        assert seen["link_probability"] == pytest.approx(shown.link_probability)
        assert seen["context_warning"] == (shown.light != "green")
        lights.append(shown.light)
        still[0] = 0.2 if step < 10 else 0.0
        observation = env.step(still)[0]
        assert env.observation_space.contains(observation)
    first = lights.index("green")
    assert 7.5 <= first * base.dt_s <= 8.5  # eleven speeds at one a second, three of them before the episode
    assert set(lights[:first]) == {"amber"}
    assert shown.road
    assert shown.advice
    env.reset(seed=4)
    assert context_of(base).reason == "COLLECTING"  # the memory is that of the episode


def test_a_warning_costs_what_is_asked_for_while_the_car_drives_on() -> None:
    plain, dear = (
        gymnasium.make("lanebound/LaneKeeping-v0", config={**WATCHED, "cost": {"context": weight}})
        for weight in (0.0, 2.0)
    )
    for env in (plain, dear):
        env.reset(seed=1)
    a, b = (env.step(np.zeros(2, np.float32))[-1] for env in (plain, dear))
    assert a["cost_context"] == b["cost_context"] == dear.unwrapped.dt_s  # type: ignore[attr-defined]
    assert b["cost"] - a["cost"] == pytest.approx(2.0 * b["cost_context"])


@pytest.mark.parametrize(
    ("kind", "judges", "score"),
    [
        ("rtk_reckoning", "vehicle", "context"), ("rtk_reckoning", "codes", "context"),
        ("monitored_codes", "codes", "context"), ("rtk_reckoning", "vehicle", "jabbour"),
        ("rtk_reckoning", "vehicle", "yu"),
    ],
)  # fmt: skip
def test_the_engine_has_the_reports_of_single_environments(kind: str, judges: str, score: str) -> None:
    context = {"interval_s": 0.5, "alerts": True, "judges": judges, "map": {"score": score, "threshold": 70.0}}
    navigator = {"kind": kind, "context": context}
    config = {**WATCHED, "navigator": navigator, "observation": {"form": "flat"}}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=config)
    engine = gymnasium.make_vec("lanebound/LaneKeeping-v0", num_envs=2, config=config)
    places = list(place_of(env.unwrapped.config).values())  # type: ignore[attr-defined]
    one, _ = env.reset(seed=5)
    many, _ = engine.reset(seed=5)
    changed, reasons = 0, set()
    for _ in range(44):
        np.testing.assert_allclose(many[0][places], one[places], atol=1e-6)
        before = one[places]
        one, _, over, _, info = env.step(np.zeros(2, np.float32))
        many, *_, infos = engine.step(np.zeros((2, 2), np.float32))
        assert infos["cost_context"][0] == info["cost_context"]
        assert infos["alert"][0] == info["alert"]
        assert infos["reason"][0] == info["reason"]
        reasons.add(AlertReason.from_code(info["reason"]).name)
        changed += bool((one[places] != before).any())
        if over:
            break
    assert changed
    said = "BOTH" if kind == "monitored_codes" else "CONTEXT_WARNING"  # levels of codes exceed the limits of a lane
    assert said in reasons
    env.close()
    engine.close()


def test_without_a_monitor_there_is_nothing_to_read() -> None:
    env = gymnasium.make("lanebound/LaneKeeping-v0", config={"sky": "open"})
    env.reset(seed=1)
    with pytest.raises(InputError, match=r"navigator\.context must be configured"):
        context_of(env.unwrapped)  # type: ignore[arg-type]


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
