"""The car drives on belief: an error of navigation moves the real car, and nothing else of the truth does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import Road, RoadNetwork
from numpy.typing import NDArray
from scipy.stats import norm

from lanebound.envs import DrivingEnv, make_config, wrap
from lanebound.envs.batch.belief_kernel import settle
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.lanes_kernel import nearest
from lanebound.envs.batch.records_kernel import BELIEF
from lanebound.envs.belief_loop import BeliefLoop
from lanebound.envs.ego import BelievedVehicle, MetaEgo
from lanebound.envs.navigation import Source
from lanebound.envs.scene import map_bound_m, navigator_config
from lanebound.integrity.monitoring.alerts import AlertReason

IDLE = 1
STRAIGHT: dict[str, Any] = {"world": {"vehicles_count": 0}, "sky": "open", "perception": {"source": "none"}}


def _highway(**config: Any) -> DrivingEnv:
    return wrap("highway-v0", {**STRAIGHT, **config})


def _true_offsets(env: DrivingEnv, steps: int, seed: int = 3) -> NDArray[np.float64]:
    """The true lateral offset from the lane after each step without commands."""
    env.reset(seed=seed)
    rows = []
    for _ in range(steps):
        env.step(IDLE)
        car = env.world.vehicle
        lane = env.world.road.network.get_lane(car.target_lane_index)
        rows.append(float(lane.local_coordinates(car.position)[1]))
    return np.array(rows)


@pytest.mark.parametrize("bias_m", [1.0, -1.0])
def test_a_bias_across_the_track_moves_the_real_car(bias_m: float) -> None:
    moved = _true_offsets(_highway(navigation={"source": "offset", "offset_ct_m": bias_m}), 12)
    straight = _true_offsets(_highway(navigation={"source": "perfect"}), 12)
    assert abs(straight[-1]) < 1e-6
    np.testing.assert_allclose(moved[10:], -bias_m, atol=0.02)  # from 5 s on


@pytest.mark.parametrize("many", [False, True], ids=["single", "engine"])
def test_the_level_of_a_given_offset_is_its_size_and_misleads_in_no_step(many: bool) -> None:
    """On bends, where the projection of the offset onto the track rounds to either side of it."""
    config = {"sky": "open", "navigation": {"source": "offset", "offset_at_m": 0.7, "offset_ct_m": -0.4}}
    name = "lanebound/LaneKeeping-v0"
    env = gymnasium.make_vec(name, 2, config=config) if many else gymnasium.make(name, config=config)
    env.reset(seed=3)
    beyond = 0
    for _ in range(8):
        *_, info = env.step(np.full(env.action_space.shape, 0.05, np.float32))
        assert not np.any(info["mi"])
        assert not np.any(info["hmi"])
        beyond += sum(int(np.sum(np.abs(info[f"err_{axis}_m"]) > info[f"pl_{axis}_m"])) for axis in ("at", "ct"))
    assert beyond > 0


def test_a_bias_moves_the_car_in_curves_too() -> None:
    """Compared at equal arc length, on radii of 40 m and more; the low-level control cuts curves by itself."""

    def path(navigation: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        env = DrivingEnv(
            {
                "base": "LaneKeepingWorld",
                "sky": "open",
                "actuators": None,
                "navigation": navigation,
                "off_road_ends": False,
            }
        )
        env.reset(seed=5)
        rows = []
        for _ in range(60):
            env.step(IDLE)
            lane = env.world.road.network.get_lane(env.world.vehicle.target_lane_index)
            rows.append(lane.local_coordinates(env.world.vehicle.position))
        arc, offset = np.array(rows).T
        return arc, offset

    arc, offset = path({"source": "perfect"})
    moved_arc, moved = path({"source": "offset", "offset_ct_m": 0.5})
    common = moved_arc[(moved_arc > moved_arc[10]) & (moved_arc < arc[-1])]
    difference = np.interp(common, moved_arc, moved) - np.interp(common, arc, offset)
    np.testing.assert_allclose(difference, -0.5, atol=0.06)


def test_the_spread_of_the_error_is_the_spread_of_the_drive() -> None:
    """On a straight the real car mirrors the error of its navigation, low-passed by its own steering."""
    env = _highway(sky="urban", actuators=None, navigation={"smoothing_s": 0.0, "jump_m": 50.0}, off_road_ends=False)
    error, offset = [], []
    for seed in range(12):
        env.reset(seed=seed)
        for k in range(50):
            *_, info = env.step(IDLE)
            car = env.world.vehicle
            if k > 10:
                error.append(info["err_ct_m"])
                offset.append(
                    float(env.world.road.network.get_lane(car.target_lane_index).local_coordinates(car.position)[1])
                )
    e, d = np.array(error), np.array(offset)
    assert np.std(e) > 0.03
    assert np.corrcoef(e, d)[0, 1] < -0.8
    assert 0.6 < np.std(d) / np.std(e) < 1.2


def _poisoned(car: Any) -> dict[str, Any]:
    """Put nonsense in the place of the truth, and return what was there."""
    kept = {name: getattr(car, name) for name in ("position", "heading", "speed", "lane_index", "lane")}
    car.position, car.heading, car.speed = kept["position"] + 1e3, kept["heading"] + 2.0, kept["speed"] - 100.0
    car.lane_index = car.lane = None
    return kept


def _restore(car: Any, kept: dict[str, Any]) -> None:
    for name, value in kept.items():
        setattr(car, name, value)


def _drive(seed: int) -> list[tuple[float, ...]]:
    env = wrap("merge-v1", {"sky": "urban", "actuators": None})
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(12):
        observation, _, terminated, truncated, _ = env.step(int(rng.integers(5)))
        car = env.world.vehicle
        rows.append((*car.position, car.heading, car.speed, *(float(part.sum()) for part in observation.values())))
        if terminated or truncated:
            break
    return rows


def test_poisoned_truth_changes_no_decision(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once measured, the truth may be anything: commands, masks and observations stay what they are, to the bit."""
    expected = _drive(4)
    act, observe = MetaEgo.act, DrivingEnv._observe
    decisions = 0

    def blind_act(self: Any, action: Any = None) -> None:
        nonlocal decisions
        kept = _poisoned(self)
        try:
            act(self, action)
        finally:
            _restore(self, kept)
        decisions += 1

    def blind_observe(self: Any) -> Any:
        kept = _poisoned(self.world.vehicle)
        try:
            self.action_masks()
            return observe(self)
        finally:
            _restore(self.world.vehicle, kept)

    monkeypatch.setattr(MetaEgo, "act", blind_act)
    monkeypatch.setattr(DrivingEnv, "_observe", blind_observe)
    assert _drive(4) == expected
    assert decisions > 50


def test_belief_is_up_to_date_before_anything_is_decided(monkeypatch: pytest.MonkeyPatch) -> None:
    late: list[float] = []
    act = MetaEgo.act

    def noting(self: Any, action: Any = None) -> None:
        late.append(self.loop.world.steps * self.loop.step_s - float(self.loop.episodes.ego["belief"]["time_s"][0]))
        act(self, action)

    monkeypatch.setattr(MetaEgo, "act", noting)
    _drive(1)
    assert np.abs(late).max() < 1e-9
    assert len(late) > 50


def test_a_pose_that_has_yet_to_take_a_jump_over_is_not_called_available() -> None:
    """Smoothing keeps the car where it was; until that has faded the levels, the alert and the reason say so."""
    env = _highway(sky="open")
    env.reset(seed=1)
    env.step(IDLE)
    loop = env.belief_loop
    assert loop is not None
    assert loop.belief().available
    e = loop.episodes
    e.ego["track"]["residual_y_m"] = 3.0
    settle(e.ego["track"][0], e.ego["belief"][0], e.table.lanes, 0.0, e.rules[0])
    belief = loop.belief()
    assert belief.pl_ct_m > 3.0 > belief.al_ct_m
    assert (belief.alert, belief.available, belief.reason) == (True, False, AlertReason.PL_CT.code)


def test_an_ego_that_knows_its_position_still_hears_the_others() -> None:
    env = DrivingEnv({"base": "CarFollowingWorld", "sky": "open", "navigation": {"source": "perfect"}})
    env.reset(seed=1)
    for _ in range(20):
        env.step(IDLE)
    assert env.belief_loop is not None
    assert env.belief_loop.traffic.count == 1


def test_levels_on_the_map_keep_to_the_stated_risk() -> None:
    """What the map is given is taken off the navigator's share, so that both together are the stated total."""
    config = make_config("lanebound/LaneKeeping-v0", {"navigator": {"risk": {"integrity_risk": 1e-4}}})
    navigator = navigator_config(config, (1.5, 0.625))
    bound = map_bound_m(config, navigator)
    by_the_map = 4.0 * norm.sf(bound / config.navigation.map_sigma_m)  # two sides of two axes
    left = float(navigator.risk.axis_budgets(spent=navigator.risk.unmonitored_risk).sum())
    assert by_the_map + left == pytest.approx(1e-4, rel=1e-6)
    assert by_the_map > 0.0
    certain = make_config("lanebound/LaneKeeping-v0", {"navigation": {"map_sigma_m": 0.0}})
    assert navigator_config(certain, (1.5, 0.625)).risk.unmonitored_risk == 0.0
    assert map_bound_m(certain, navigator) == 0.0


@pytest.mark.parametrize(("x", "planned", "lane"), [(51.0, "s", "s"), (51.0, "t", "t"), (80.0, "t", "s")])
def test_where_lanes_part_the_believed_one_is_that_of_the_route_unless_it_is_far(
    x: float, planned: str, lane: str
) -> None:
    """1 m past a fork two lanes are equally near; 30 m past it the turn is 30 m away, whatever was planned."""
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0.0, 0.0], [50.0, 0.0]))
    network.add_lane("b", "s", StraightLane([50.0, 0.0], [100.0, 0.0]))
    network.add_lane("b", "t", CircularLane([50.0, 20.0], 20.0, -np.pi / 2, 0.0))
    car = BelievedVehicle(Road(network, np_random=np.random.default_rng(0)), np.array([40.0, 0.0]), 0.0, 10.0)
    car.route = [("b", planned, None)]
    table, belief = lane_table(network), np.zeros(1, BELIEF)
    for name, value in (("x_m", x), ("y_m", 0.3), ("heading_rad", 0.02), ("speed_mps", 10.0)):
        belief[name] = value
    belief["lane"] = nearest(table.lanes, x, 0.3, 0.02)
    loop: Any = object.__new__(BeliefLoop)
    loop.config = SimpleNamespace(navigation=SimpleNamespace(source=Source.NAVIGATOR), lane_sensor=None)
    loop.episodes, loop.believed = SimpleNamespace(ego={"belief": belief}, table=table), car
    loop._place()
    assert car.lane_index == ("b", lane, 0)
