"""Observation entries, a world and an id from outside: registered, driven alone and by the engine, taken back.

The modules stand in tests/plugins; docs/extending.md shows them.
"""

from __future__ import annotations

import importlib
import pickle
from collections.abc import Mapping
from types import ModuleType
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle

from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.benchmark.work import expected_s
from lanebound.agents.episodes import open_env
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs import IDS, make_config
from lanebound.envs.ids import CONTINUOUS, META, LaneKeeping, Preset, register_id, withdraw_id
from lanebound.envs.info import InfoEntry, register_info, withdraw_info
from lanebound.envs.observation import Entry, ObservationConfig, describe, entries, register_entry, withdraw_entry
from lanebound.envs.vector.env import engines
from lanebound.envs.worlds import WorldKind, register_world
from lanebound.envs.worlds.base import Seat, World
from lanebound.envs.worlds.drivers import CityDriver, LeadVehicle
from lanebound.envs.worlds.networks import StreetNetwork
from lanebound.envs.worlds.paths import Path, Pose, straight
from lanebound.integrity.core.errors import ConfigError, InputError
from side_by_side import PERFECT, Tally, drive, pair, require_equal

KEEPING, HAIRPIN = "lanebound/LaneKeeping-v0", "lanebound/Hairpin-v0"
ENGINE: Any = {"vectorization_mode": "vector_entry_point"}
OPEN: dict[str, Any] = {"sky": "open"}


@pytest.fixture
def two_entries() -> dict[str, Entry]:
    """One that reads a field, one that is computed."""
    load = importlib.import_module
    found = load("elapsed_time").ELAPSED_TIME, load("stopping_distance").STOPPING_DISTANCE
    return {entry.name: entry for entry in found}


@pytest.fixture
def hairpin() -> ModuleType:
    return importlib.import_module("hairpin")


def _columns(observation: Any, form: str) -> dict[str, Any]:
    """The entries of an observation (..., n) by name."""
    index = [entry for entry in entries(ObservationConfig()) if form == "flat" or entry.group == "ego"]
    values = observation if form == "flat" else observation["ego"]
    return {entry.column: values[..., n] for n, entry in enumerate(index)}


@pytest.mark.parametrize("form", ["flat", "dict"])
def test_entries_are_shown_by_the_single_environment_and_the_engine(two_entries: dict[str, Entry], form: str) -> None:
    given = {**OPEN, "observation": {"form": form}}
    single, engine = gymnasium.make(KEEPING, config=given), gymnasium.make_vec(KEEPING, 2, config=given, **ENGINE)
    alone, together = single.reset(seed=3)[0], engine.reset(seed=3)[0]
    for n in range(1, 6):
        action = np.array([1.0, 0.0], np.float32)
        alone, *_ = single.step(action)
        together, *_ = engine.step(np.tile(action, (2, 1)))
        found, many = _columns(alone, form), _columns(together, form)
        for name in two_entries:
            assert found[f"ego.{name}"] == many[f"ego.{name}"][0]
        speed = found["ego.speed"] * 40.0
        assert found["ego.elapsed_time"] == pytest.approx(0.2 * n / 60.0, rel=1e-6)
        assert found["ego.stopping_distance"] == pytest.approx(speed**2 / 6.0 / 50.0, rel=1e-5)
    assert single.observation_space.contains(alone)
    assert engine.observation_space.contains(together)
    single.close()
    engine.close()


def test_an_entry_must_give_a_number_for_each_environment() -> None:
    scalar = Entry("constant", "ego", "", 1.0, 0.0, 1.0, "one number for all", source=lambda o: np.float64(3.0))
    register_entry(scalar)
    env = gymnasium.make(KEEPING, config=OPEN)
    with pytest.raises(InputError, match=r"ego.constant must return one number .*shape \(1,\), got shape \(\)"):
        env.reset(seed=1)
    withdraw_entry("ego.constant")
    with pytest.raises(InputError, match=r"entry must be a registered one, got 'ego.constant': none are known"):
        withdraw_entry("ego.constant")


def test_an_entry_without_a_number_is_named_alone_and_in_the_engine() -> None:
    register_entry(Entry("mine", "ego", "", 1.0, 0.0, 1.0, "nothing", source=lambda o: o.belief["speed_mps"] * np.nan))
    for made in (gymnasium.make(KEEPING, config=OPEN), gymnasium.make_vec(KEEPING, 2, config=OPEN, **ENGINE)):
        with pytest.raises(InputError, match=r"source of entry ego\.mine must return numbers, got nan"):
            made.reset(seed=1)


def test_an_entry_whose_function_fails_is_named() -> None:
    register_entry(Entry("mine", "ego", "", 1.0, 0.0, 1.0, "misspelt", source=lambda o: o.belief["sped_mps"]))
    with pytest.raises(InputError, match=r"source of entry ego.mine must return .*no field of name sped_mps"):
        gymnasium.make(KEEPING, config=OPEN).reset(seed=1)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("preview[5].ahead_m", r"source of entry ego.mine must be among the 5 of preview, got 'preview\[5\].ahead_m'"),
        ("vehicle[2].age_s", "must be among the 2 of vehicle"),
        ("sky[15]", "must be among the 15 of sky"),
    ],
)
def test_an_entry_beyond_what_an_observation_has_is_refused(source: str, message: str) -> None:
    config = ObservationConfig(vehicles=2)
    assert len(config.preview_m) == len(config.satellites_m) == 5
    register_entry(Entry("mine", "ego", "", 1.0, 0.0, 1.0, "too far", source))
    with pytest.raises(InputError, match=message):
        entries(config)


def test_an_environment_with_them_is_pickled(two_entries: dict[str, Entry]) -> None:
    env = open_env("LaneKeeping", {**PERFECT, "observation": {"form": "flat"}})
    env.reset(seed=2)
    again = pickle.loads(pickle.dumps(env))
    action = np.array([1.0, 0.0], np.float32)
    np.testing.assert_array_equal(again.step(action)[0], env.step(action)[0])


def test_the_index_lists_them_until_they_are_withdrawn(two_entries: dict[str, Entry]) -> None:
    assert "| ego | 15 | elapsed_time | s | 60 | [0, 1] | time since the start of the episode |" in describe()
    assert "| ego | 16 | stopping_distance | m | 50 | [0, 1] | distance until the car stands at 3 m/s2," in describe()
    for entry in two_entries.values():
        withdraw_entry(entry.column)
    assert not any(name in describe() for name in two_entries)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"group": "eggo"}, "group must be one of ego, integrity, road, traffic, got 'eggo': did you mean 'ego'"),
        ({"name": "speed"}, r"name of an entry of ego must not be taken, got 'speed': choose another"),
        ({"name": "my speed"}, "name of an entry of ego must be an identifier, got 'my speed'"),
        ({"high": np.inf}, "all finite, got 1.0, 0.0, inf"),
        ({"source": 3}, "source of entry ego.mine must be the name of a field or a function, got 3"),
        ({"scale": 0.0}, r"scale must be > 0 and low < high, all finite, got 0\.0, 0\.0, 1\.0"),
        (
            {"source": "belief.speed"},
            "source must name a field of belief, got 'belief.speed': did you mean 'speed_mps'",
        ),
        ({"source": "believe.speed_mps"}, "source must name one of belief, .*: did you mean 'belief'"),
        ({"source": "speed of the car"}, r"source must be as 'belief\.speed_mps' or"),
    ],
)
def test_a_mistaken_entry_is_refused(change: dict[str, Any], message: str) -> None:
    right = {"name": "mine", "group": "ego", "unit": "m/s", "scale": 1.0, "low": 0.0, "high": 1.0, "meaning": "mine"}
    with pytest.raises(InputError, match=message):
        register_entry(Entry(**{**right, "source": "belief.speed_mps", **change}))
    assert "ego.mine" not in {entry.column for entry in entries(ObservationConfig())}


@pytest.mark.parametrize("action", ["continuous", "meta"])
def test_a_world_is_the_same_alone_and_in_the_engine(hairpin: ModuleType, action: str) -> None:
    single, engine = pair("Hairpin", {**PERFECT, "action": action})
    tally = Tally()
    for seed in range(3):
        drive(single, engine, seed, tally, 30)
    require_equal(tally)
    assert tally.steps >= 30


def test_its_navigation_is_the_same_as_well(hairpin: ModuleType) -> None:
    single, engine = pair("Hairpin", OPEN)
    tally = Tally()
    drive(single, engine, 5, tally, 25)
    require_equal(tally)
    assert tally.steps == 25


def test_roads_that_fork_are_the_same_alone_and_in_the_engine(hairpin: ModuleType) -> None:
    class ForkWorld(hairpin.HairpinWorld):  # type: ignore[name-defined, misc]
        ENDS_M = None

        def _network(self) -> StreetNetwork:
            network = super()._network()
            end = network.get_lane(("start", "end", 0)).path.pose[-1]
            for node in ("left", "right"):
                network.add_road(("end", node), Path.of(end, straight(100.0)), 1, 3.25)
            return network

        def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], None]:
            return [Seat(("start", "end", 0), self.road.network.get_lane(("start", "end", 0)).length - 4.0, 8.0)], None

    class Fork(Preset):
        PRESET = {"base": "ForkWorld", **CONTINUOUS}  # noqa: RUF012

    register_world(WorldKind("ForkWorld", ForkWorld, ForkWorld.support))
    register_id(Fork)
    single, engine = pair("Fork", {**PERFECT, "action": "meta"})
    tally = Tally()
    drive(single, engine, 1, tally, 20)
    require_equal(tally)
    assert single.world.vehicle.lane_index[0] == "end"


class BusyWorld(World):
    """A straight road of two lanes with six city drivers."""

    OTHERS, TRAFFIC = CityDriver, "city"
    LANE = ("a", "b", 0)

    def _network(self) -> StreetNetwork:
        network = StreetNetwork()
        network.add_road(("a", "b"), Path.of(Pose(0.0, 0.0, 0.0), straight(500.0)), 2, self.config["lane_width"])
        return network

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        return 7

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Any]:
        others = [Seat(("a", "b", n % 2), 50.0 + 30.0 * n + float(rng.uniform(0.0, 9.0)), 7.0, 9.0, 4.0)
                  for n in range(6)]  # fmt: skip
        return [Seat(self.LANE, 20.0, 10.0), *others], None


class Busy(Preset):
    PRESET: ClassVar[Mapping[str, Any]] = {"base": "BusyWorld", **META}


def _register(world: type[World]) -> None:
    register_world(WorldKind("BusyWorld", world, world.support))
    register_id(Busy)


def test_a_world_with_traffic_is_the_same_alone_and_in_the_engine() -> None:
    _register(BusyWorld)
    single, engine = pair("Busy", PERFECT)
    tally = Tally()
    drive(single, engine, 4, tally, 20)
    require_equal(tally)
    assert tally.steps == 20
    assert single.world.road.vehicles[3].__class__ is CityDriver


class HalfBrakes(CityDriver):
    def act(self, action: Any = None) -> None:
        super().act(action)


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"TRAFFIC": "course"}, "OTHERS of the world must be LeadVehicle, which the traffic 'course' moves, .*CityDri"),
        ({"TRAFFIC": "citty"}, r"traffic of a world must be one of .*, got 'citty': did you mean 'city'\?"),
        ({"OTHERS": IDMVehicle, "TRAFFIC": "motorway"}, "TRAFFIC of the world must be course, city or network"),
        ({"OTHERS": HalfBrakes}, "HalfBrakes.act must be that of CityDriver in the vector engine"),
        ({"_is_terminated": lambda self: True}, "World._is_terminated must be that of World, without a support"),
        ({"_reward": lambda self, action: 0.0}, "World._reward must be that of World"),
    ],
)
def test_the_engine_refuses_traffic_and_rules_that_it_would_drive_otherwise(
    declared: dict[str, Any], message: str
) -> None:
    _register(type("OwnWorld", (BusyWorld,), declared))
    single = gymnasium.make("lanebound/Busy-v0", config=PERFECT)
    single.reset(seed=1)
    with pytest.raises(ConfigError, match=message):
        gymnasium.make_vec("lanebound/Busy-v0", 2, config=PERFECT, **ENGINE)


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"most_vehicles": classmethod(lambda cls, config: 3)}, "OwnWorld.most_vehicles must be 7 at least, got 3"),
        ({"LANE": ("a", "c", 0)}, r"seats of OwnWorld must be on lanes of its network, got \('a', 'c', 0\)"),
        ({"LANE": ("a", "b", 2)}, r"seats of OwnWorld must be on lanes of its network, got \('a', 'b', 2\)"),
        ({"draw_seats": lambda self, rng: ([], None)}, "OwnWorld.draw_seats must return the seat of the ego first"),
        ({"OTHERS": LeadVehicle, "TRAFFIC": "course"}, "draw_seats must return a speed profile for LeadVehicle"),
    ],
)
def test_wrong_seats_are_refused_alone_and_in_the_engine(declared: dict[str, Any], message: str) -> None:
    _register(type("OwnWorld", (BusyWorld,), declared))
    with pytest.raises(InputError, match=message):
        gymnasium.make("lanebound/Busy-v0", config=PERFECT)
    with pytest.raises(InputError, match=message):
        gymnasium.make_vec("lanebound/Busy-v0", 2, config=PERFECT, **ENGINE)


def test_a_world_is_a_class_with_a_function_for_its_support() -> None:
    with pytest.raises(InputError, match="world of 'mine' must be a subclass of World, got <class 'object'>"):
        register_world(WorldKind("mine", object))
    with pytest.raises(InputError, match=r"support of 'mine' must be a function, .*: pass MyWorld.support"):
        register_world(WorldKind("mine", BusyWorld, BusyWorld.support()))  # type: ignore[arg-type]


def test_a_number_of_a_monitor_is_in_info_alone_and_in_the_engine() -> None:
    importlib.import_module("interference")
    importlib.import_module("usual_strength")
    name, given = "usual_cn0_dbhz", {"sky": "urban", "duration_s": 2.0, "navigator": {"stages": ["interference"]}}
    single, engine = gymnasium.make(KEEPING, config=given), EngineVecEnv(KEEPING, 2, given, keys=(name,))
    engine.seed(4)
    engine.reset()
    first = single.reset(seed=4)[1][name]
    assert first == engine.reset_infos[0][name]
    assert first > 30.0
    action = np.zeros(2, np.float32)
    for n in range(10):
        info, infos = single.step(action)[4], engine.step(np.tile(action, (2, 1)))[3]
        assert info[name] == infos[0][name], n
    assert infos[0]["TimeLimit.truncated"]  # the info is that of the end, not of the start after it
    assert info[name] != first
    other = gymnasium.make_vec(KEEPING, 2, config={**PERFECT}, **ENGINE)
    infos = other.reset(seed=1)[1]
    assert infos[name].tolist() == [0.0, 0.0]
    assert infos[f"_{name}"].tolist() == [True, True]


def test_a_number_of_info_is_registered_once_and_named_where_it_fails() -> None:
    importlib.import_module("usual_strength")
    for entry, message in (
        (InfoEntry("cost", "", lambda o: o.belief["speed_mps"]), "name of an entry of info must not be taken, got 'co"),
        (InfoEntry("usual_cn0_dbhz", "", lambda o: o.belief["speed_mps"]), "must not be taken"),
        (InfoEntry("mine", "", 3), "source of info.mine must be a function of Observed, got 3"),
    ):
        with pytest.raises(InputError, match=message):
            register_info(entry)
    register_info(InfoEntry("mine", "", lambda o: o.states["stage missing"]["a"]))
    env = gymnasium.make(KEEPING, config=OPEN)
    with pytest.raises(InputError, match=r"source of info.mine must return one number .*KeyError: 'stage missing'"):
        env.reset(seed=1)
    withdraw_info("mine")
    env = gymnasium.make(KEEPING, config=OPEN)
    assert "mine" not in env.reset(seed=1)[1]
    with pytest.raises(InputError, match="entry of info must be a registered one, got 'mine'"):
        withdraw_info("mine")


def test_a_benchmark_expects_the_time_that_its_preset_declares(hairpin: ModuleType) -> None:
    suite = SuiteConfig.load(
        {"envs": ["Hairpin", "LaneKeeping"], "skies": ["open"], "agents": {"nominal": "nominal"}, "seeds": {"count": 1}}
    )
    assert expected_s(suite, suite.envs) == {
        "Hairpin-v0": 40.0 * hairpin.Hairpin.CORE_S, "LaneKeeping-v0": 60.0 * LaneKeeping.CORE_S
    }  # fmt: skip


def test_its_id_is_one_as_others_until_it_is_withdrawn(hairpin: ModuleType) -> None:
    assert IDS[HAIRPIN]["base"] == make_config(HAIRPIN).base == "HairpinWorld"
    assert isinstance(open_env("hairpin").world, hairpin.HairpinWorld)
    envs = gymnasium.make_vec(HAIRPIN, 3, config={**PERFECT, "world": {"lane_width": 4.0}}, **ENGINE)
    observations, _ = envs.reset(seed=1)
    assert envs.observation_space.contains(observations)
    envs.close()
    with pytest.raises(InputError, match="id must not be taken, got lanebound/Hairpin-v0: set ID in the class"):
        register_id(hairpin.Hairpin)
    with pytest.raises(InputError, match="name of a world must not be taken, got 'HairpinWorld': choose another"):
        register_world(WorldKind("HairpinWorld", hairpin.HairpinWorld))
    withdraw_id("lanebound/Hairpin-v0")
    assert HAIRPIN not in IDS
    assert HAIRPIN not in engines()
    with pytest.raises(gymnasium.error.NameNotFound):
        gymnasium.make(HAIRPIN)
    with pytest.raises(InputError, match=r"env_id must be one of .*, got 'lanebound/Hairpin-v0'"):
        make_config(HAIRPIN)


def test_an_unknown_world_and_one_without_an_engine_are_refused(hairpin: ModuleType) -> None:
    class Lost(Preset):
        PRESET = {"base": "HairpinWorl", **CONTINUOUS}  # noqa: RUF012

    class Alone(Preset):
        PRESET = {"base": "AloneWorld", **CONTINUOUS}  # noqa: RUF012

    with pytest.raises(
        ConfigError,
        match=r"base must be a highway-env id or one of LaneKeepingWorld, .*, HairpinWorld, got 'HairpinWorl': "
        "did you mean 'HairpinWorld'",
    ):
        register_id(Lost)
    assert "lanebound/Lost-v0" not in IDS
    register_world(WorldKind("AloneWorld", hairpin.HairpinWorld))
    register_id(Alone)
    single = gymnasium.make("lanebound/Alone-v0", config=PERFECT)
    assert isinstance(single.unwrapped.world, World)  # type: ignore[attr-defined]
    single.reset(seed=1)
    assert "lanebound/Alone-v0" not in engines()
    with pytest.raises(
        ConfigError,
        match=r"base must have an engine, as LaneKeepingWorld, .*, HairpinWorld do, got 'AloneWorld': choose one "
        "of these, or make the same environments with vectorization_mode='sync' or 'async'",
    ):
        pair("Alone", PERFECT)
