"""Each id's page: its sections, and its figures against the environment itself."""

from __future__ import annotations

import functools
import inspect
import pickle
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from highway_env.road.road import RoadNetwork

from lanebound.envs import IDS, DrivingEnv, make_config
from lanebound.envs.ids import CLASSES, CarFollowing, Highway, LaneKeeping, Preset, UrbanCanyon, id_of, preset_of
from lanebound.envs.manual import SECTIONS, markdown
from lanebound.envs.scene import alert_limits_m
from lanebound.envs.worlds import networks
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sensors.fault_registry import fault_kinds
from lanebound.integrity.sensors.faults import Fault

ROOT = Path(__file__).parents[2]
LIGHT = {"sky": "open", "cities": {"count": 1}}
every_class = pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.__name__)


@functools.cache
def _made(name: str) -> Preset:
    (kind,) = [kind for kind in CLASSES if kind.__name__ == name]
    env = kind(LIGHT)
    env.reset(seed=1)
    return env


def made(kind: type[Preset]) -> Preset:
    """The environment of a class, shared by tests."""
    return _made(kind.__name__)


def page(kind: type[DrivingEnv]) -> str:
    """A class's docstring on one line a paragraph."""
    return re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.getdoc(kind) or "")


def headings(kind: type[DrivingEnv]) -> list[str]:
    return re.findall(r"^## (.+)$", inspect.getdoc(kind) or "", re.MULTILINE)


def section(kind: type[DrivingEnv], name: str) -> str:
    return page(kind).partition(f"## {name}")[2].partition("\n\n## ")[0]


@every_class
def test_pages_keep_the_order(kind: type[Preset]) -> None:
    assert headings(kind) == list(SECTIONS)


def test_the_common_page_has_all_sections_and_info() -> None:
    assert [name for name in headings(DrivingEnv) if name != "Info"] == list(SECTIONS)


@every_class
def test_classes_are_what_the_ids_make(kind: type[Preset]) -> None:
    by_id = gym.make(id_of(kind), config=LIGHT)
    assert type(by_id.unwrapped) is kind
    assert by_id.spec is not None
    assert by_id.spec.entry_point == f"{kind.__module__}:{kind.__name__}"
    assert kind(LIGHT).config == make_config(id_of(kind), LIGHT)
    assert type(pickle.loads(pickle.dumps(made(kind)))) is kind


@every_class
def test_every_class_declares_what_a_second_of_it_costs(kind: type[Preset]) -> None:
    assert 0.0 < vars(kind)["CORE_S"] <= 1.0
    assert preset_of(id_of(kind)) is kind


def test_ids_are_those_of_the_classes() -> None:
    assert list(IDS) == [id_of(kind) for kind in CLASSES]


def test_a_configuration_leaves_what_the_class_presets_alone() -> None:
    before = dict(Highway.PRESET)
    Highway({"world": {"vehicles_count": 1}, **LIGHT})
    assert before == Highway.PRESET


def test_a_class_without_configuration_is_its_preset() -> None:
    assert LaneKeeping().config == make_config("lanebound/LaneKeeping-v0")
    with pytest.raises(ConfigError, match="did you mean 'sky'"):
        LaneKeeping({"sky_": "open"})


@every_class
def test_figures_of_the_page_are_those_of_the_environment(kind: type[Preset]) -> None:
    env, text = made(kind), page(kind)
    config, world = env.config, env.world
    lanes = [lane for ends in world.road.network.graph.values() for road in ends.values() for lane in road]
    along, across = alert_limits_m(world, config)
    assert f"{along:g} m along and {across:g} m across the track" in text
    assert f"`{env.action_space}` at {config.policy_hz} Hz" in text
    (width,) = {float(lane.width_at(0.0)) for lane in lanes}
    assert re.search(rf"{width:.3g} m", text)
    (limit,) = {lane.speed_limit for lane in lanes}
    assert f"{limit:.3g} m/s" in section(kind, "Description")
    assert f"{config.cost.alert_speed_share * limit:.2g} m/s" in section(kind, "Costs")
    if "duration" in world.config:
        assert f"Truncated after {world.config['duration']:g} s" in page(kind).replace("truncated", "Truncated")
    if not config.base.endswith("World"):
        assert f"`{config.base}`" in text


@every_class
def test_speeds_of_the_page_are_those_of_meta_actions(kind: type[Preset]) -> None:
    env = made(kind)
    if env.config.action.value != "meta":
        pytest.skip("continuous")
    *first, last = [f"{speed:g}" for speed in env.world.vehicle.target_speeds]
    assert f"{', '.join(first)} and {last} m/s" in section(kind, "Action Space")


def length_km(road: RoadNetwork) -> float:
    return float(road.get_lane(("start", "end", 0)).length) / 1e3


def test_lengths_of_our_roads() -> None:
    winding = [length_km(networks.winding_road(layout, 1, 3.25)) for layout in range(4)]
    long = [length_km(networks.long_road(layout, 3.25)) for layout in range(4)]
    for kind, lengths in ((LaneKeeping, winding), (CarFollowing, long)):
        assert f"{lengths[0]:.2f} km long" in page(kind)
        assert f"{min(lengths):.2f} to {max(lengths):.2f} km" in page(kind)
    graph = networks.city_loop(3.25).graph
    loop = np.mean([sum(road[side].length for ends in graph.values() for road in ends.values()) for side in (0, 1)])
    assert f"{loop / 1e3:.1f} km" in page(UrbanCanyon)


def test_the_common_page_names_every_info_key_weight_and_term() -> None:
    env, text = made(LaneKeeping), inspect.getdoc(DrivingEnv) or ""
    _, info = env.reset(seed=1)
    assert [key for key in info if f"`{key}`" not in text] == []
    costs, rewards = env.config.cost, env.config.reward
    rows = dict(re.findall(r"^\| `(\w+)` \| (-?[\d.]+) \|", text, re.MULTILINE))
    wanted = {term: getattr(rewards, term) for term in info["rewards"]}
    wanted |= {cause: getattr(costs, cause[5:]) for cause in info if cause.startswith("cost_")}
    assert {name: float(weight) for name, weight in rows.items()} == wanted


def test_the_manual_is_up_to_date() -> None:
    """``python -m lanebound.envs.manual > docs/environments.md`` brings it up to date."""
    assert (ROOT / "docs/environments.md").read_text(encoding="utf-8") == markdown()


def test_the_readme_tells_the_same() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for env_id in IDS:
        config = make_config(env_id)
        row = rf"^\| `{env_id}` \| .+ \| {config.action.value}, {config.policy_hz} Hz \| {config.sky} \|$"
        assert re.search(row, readme, re.MULTILINE), env_id


def test_the_manual_names_every_key_and_kind_of_a_fault() -> None:
    text = markdown()
    for kind in fault_kinds():
        (row,) = re.findall(rf"^\| `{kind.name}` \|.*\|$", text, re.MULTILINE)
        words = [kind.summary, *kind.profiles, *kind.needs, *(m.field for m in kind.magnitudes)]
        assert [word for word in words if word not in row] == []
    assert [key for key in Fault.model_fields if f"`{key}`" not in text and f'"{key}"' not in text] == []


def test_gymnasium_imports_the_package_that_an_id_names() -> None:
    """In a process of its own: importing Gymnasium alone does not import ours, and registers nothing."""
    code = (
        "import gymnasium, sys\n"
        "assert not any(name.startswith('lanebound') for name in [*sys.modules, *gymnasium.registry])\n"
        "print(gymnasium.make('lanebound.envs:lanebound/LaneKeeping-v0').spec.id)\n"
        "print(gymnasium.make_vec('lanebound.envs:lanebound/LaneKeeping-v0', 2).num_envs)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["lanebound/LaneKeeping-v0", "2"]
