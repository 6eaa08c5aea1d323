"""Costs, verdicts and motion: what a faultless drive costs, and what may not be dodged."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from highway_env.road.lane import StraightLane
from highway_env.road.road import RoadNetwork

from lanebound.envs import IDS, DrivingEnv, make_config, wrap
from lanebound.envs.batch.costs_kernel import CHANGE_S, _headway, overhang_m, rss_distance_m, shortfall
from lanebound.envs.batch.episodes import Episodes
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.records_kernel import BELIEF, PERCEIVED, SCORE
from lanebound.envs.batch.rules import cost_figures
from lanebound.envs.batch.score_kernel import count_epoch
from lanebound.envs.belief_loop import BeliefLoop
from lanebound.envs.costs import CAUSES, GROUPS, CostConfig
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.records import Records
from vehicles import cars_at, record_of

PERFECT: dict[str, Any] = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "none"}}
LEFT, IDLE, RIGHT = 0, 1, 2


def _loop(env: DrivingEnv) -> BeliefLoop:
    assert env.belief_loop is not None
    return env.belief_loop


def _corridor(env: DrivingEnv) -> tuple[int, bool]:
    """Number of the lane that the car is to keep, and whether it is changing."""
    score = _loop(env).episodes.ego["score"][0]
    return int(score["corridor_side"]), bool(score["leaving_side"] >= 0)


def _car(env: DrivingEnv) -> tuple[Records, Episodes]:
    """The vehicles of an environment as they are now."""
    loop = _loop(env)
    loop.seats.read(full=True)
    e = loop.episodes
    return e.cars[0, : int(e.ego["vehicles"][0])], e


def _costs(env: DrivingEnv, commands: Any, steps: int, seed: int = 0) -> dict[str, float]:
    """Sums of the costs over an episode's first steps, without crashes."""
    env.reset(seed=seed)
    total: dict[str, float] = {}
    for k in range(steps):
        _, _, terminated, truncated, info = env.step(commands(k))
        for name in info:
            if name.startswith("cost"):
                total[name] = total.get(name, 0.0) + info[name]
        if terminated or truncated:
            break
    return total


@pytest.mark.parametrize(
    ("base", "world", "most"),
    [
        ("roundabout-v1", {}, 4.0),  # highway-env's control itself swings wide at the entry, on no lane at all
        ("intersection-v2", {"initial_vehicle_count": 0, "spawn_probability": 0.0}, 0.5),
        ("merge-v1", {}, 0.0),
    ],
)
def test_a_faultless_car_pays_nothing_for_its_lane(base: str, world: dict[str, Any], most: float) -> None:
    """Also where roads join, and the lane of one is not yet that of the next."""
    env = wrap(base, {**PERFECT, "world": world, "actuators": None})
    env.reset(seed=0)
    cost = 0.0
    for _ in range(16):
        env.world.road.vehicles = [env.world.vehicle]
        *_, terminated, truncated, info = env.step(IDLE)
        cost += info["cost_lane"]
        if terminated or truncated:
            break
    assert cost <= most


def test_beside_the_lane_is_paid_by_the_metre_and_the_second() -> None:
    """1 m beside the middle of a 4 m lane the body just touches the line; 1.5 m beside it is out by half a metre."""
    for bias, out in ((0.9, 0.0), (1.5, 0.5)):
        navigation = {"source": "offset", "offset_ct_m": bias}
        env = wrap(
            "highway-v0", {**PERFECT, "navigation": navigation, "world": {"vehicles_count": 0, "initial_lane_id": 1}}
        )
        env.reset(seed=1)
        for _ in range(12):
            *_, info = env.step(IDLE)
        assert info["cost_lane"] == pytest.approx(out * info["speed_mps"] * env.dt_s, abs=0.05 * info["speed_mps"])


def test_a_lane_change_is_free_and_one_without_end_is_not() -> None:
    env = wrap("highway-v0", {**PERFECT, "world": {"vehicles_count": 0, "initial_lane_id": 1}})
    once = _costs(env, lambda k: RIGHT if k == 2 else IDLE, 20)
    assert once["cost_lane"] == 0.0
    env.reset(seed=0)
    changing = 0
    for k in range(79):  # withdrawn before the car arrives, again and again
        env.step(RIGHT if k % 2 else LEFT)
        changing += _corridor(env)[1]
    assert changing * env.dt_s <= 0.5 * 79 * env.dt_s + CHANGE_S


def test_continuous_actions_command_no_change_of_lane() -> None:
    env = DrivingEnv({"base": "UrbanCanyonWorld", "action": "continuous", **PERFECT, "world": {"vehicles_count": 0}})
    env.reset(seed=0)
    lane, _ = _corridor(env)
    for _ in range(8):
        _, _, over, _, _ = env.step(np.array([0.0, 0.15 if lane == 0 else -0.15], dtype=np.float32))
        assert _corridor(env) == (lane, False)
        if over:
            break


def test_rss_distance_by_hand() -> None:
    config = CostConfig(response_s=1.0, accelerate_mps2=2.0, brake_min_mps2=4.0, brake_max_mps2=8.0)
    c = cost_figures(config)[0]
    assert rss_distance_m(10.0, 12.0, c) == pytest.approx(10.0 + 1.0 + 144.0 / 8.0 - 144.0 / 16.0)
    assert rss_distance_m(0.0, 0.0, c) == 0.0
    assert rss_distance_m(5.0, 40.0, c) == 0.0


def test_reversing_is_the_wrong_way_and_earns_nothing() -> None:
    settings = {**PERFECT, "action": "continuous", "world": {"vehicles_count": 0}, "policy_hz": 5}
    env = wrap("highway-v0", settings)
    env.reset(seed=1)
    progress, info = 0.0, {}
    for _ in range(100):
        _, _, over, _, info = env.step(np.array([-1.0, 0.0], dtype=np.float32))
        progress += info["rewards"]["progress"]
        if over:
            break
    assert info["wrong_way"]
    assert not info["is_success"]
    assert progress < 3.0


def test_a_newcomer_is_felt_as_it_drives() -> None:
    """The first epoch of a vehicle that appears shows its speed, not a start from rest."""
    env = wrap("intersection-v2", {"sky": "open", "world": {"spawn_probability": 1.0, "initial_vehicle_count": 2}})
    env.reset(seed=3)
    loop = _loop(env)
    known, levels = set(loop.seats.slot), []
    for _ in range(12):
        *_, terminated, truncated, _ = env.step(IDLE)
        assert loop.solution is not None
        for vehicle, slot in loop.seats.slot.items():
            if vehicle not in known and not vehicle.crashed:
                levels.append(float(loop.solution.pl_at_m[1 + slot]))
        if terminated or truncated:
            break
    assert len(levels) > 5
    assert np.mean(np.isfinite(levels)) > 0.95


def test_a_lie_moves_the_vehicle_that_is_perceived() -> None:
    def lead(faults: list[dict[str, Any]]) -> float:
        env = DrivingEnv(make_config("lanebound/CarFollowing-v0", {"sky": "open"}))
        env.reset(seed=2, options={"faults": faults})
        for _ in range(15):
            env.step(np.zeros(2, dtype=np.float32))
        loop = _loop(env)
        return float(math.hypot(*(loop.traffic.position_m[0] - loop.ego.position)))

    lie = {"kind": "v2v_lie", "magnitude_m": 20.0, "azimuth_deg": 90.0, "duration_s": 60.0}
    assert abs(lead([lie]) - lead([])) > 5.0


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"action_options": {"target_speed": [0, 5]}}, "did you mean 'target_speeds'"),
        ({"action_options": {"target_speeds": []}}, "two or more rising speeds"),
        ({"world": {"duration": "x"}}, "world.duration must be a number"),
        ({"world": {"vehicles_count": -1}}, "vehicles_count must be >= 0"),
        ({"policy_hz": 20}, "policy_hz must divide navigation.rate_hz"),
        ({"navigator": {"risk": {"integrty_risk": 1e-5}}}, "integrty_risk"),
    ],
)
def test_mistakes_are_refused_when_the_environment_is_made(config: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        DrivingEnv(make_config("lanebound/Highway-v0", config))


def test_the_others_have_been_heard_when_an_episode_begins() -> None:
    env = DrivingEnv(make_config("lanebound/CarFollowing-v0", {"sky": "open", "perception": {"v2v": {"loss": 0.0}}}))
    env.reset(seed=2)
    traffic = _loop(env).traffic
    lead = next(v for v in env.world.road.vehicles if v is not env.world.vehicle)
    assert traffic.count == 1
    assert math.hypot(*(traffic.position_m[0] - lead.position)) < traffic.pl_at_m[0] < 1.0


def _behind(gap_m: float, speed_mps: float, **perception: Any) -> DrivingEnv:
    """Our car behind a standing one in an empty street."""
    env = DrivingEnv(make_config("lanebound/CarFollowing-v0", {"sky": "open", "perception": perception}))
    env.reset(seed=2)
    ego = env.world.vehicle
    lead = next(v for v in env.world.road.vehicles if v is not ego)
    lead.position = ego.lane.position(ego.lane.local_coordinates(ego.position)[0] + gap_m + ego.LENGTH, 0.0)
    lead.speed, ego.speed = 0.0, speed_mps
    return env


@pytest.mark.parametrize(
    ("gap_m", "speed_mps", "lacks"),
    [(10.2, 10.0, 0.5), (40.0, 10.0, 0.0), (1.0, 0.0, 0.0), (-30.0, 10.0, 0.0)],
)
def test_what_lacks_of_the_distance_is_a_question_of_the_true_gap(gap_m: float, speed_mps: float, lacks: float) -> None:
    """From 10 m/s a standing vehicle asks for 5.25 + 11^2 / 8 = 20.4 m; at rest no gap is too short."""
    env = _behind(gap_m, speed_mps, source="none")
    car, e = _car(env)
    found = shortfall(car, e.table.lanes, cost_figures(env.config.cost)[0])
    assert found == pytest.approx(lacks, abs=0.01)


@pytest.mark.parametrize(("bound_m", "share"), [(0.0, 0.02), (5.0, 0.27), (20.0, 1.0), (math.inf, 1.0)])
def test_a_missing_level_of_the_gap_costs_as_the_largest(bound_m: float, share: float) -> None:
    """20 m of 20.4 m: a gap just too short, less what bounds its error."""
    assert _share_lacking(_behind(20.0, 10.0, source="none"), 20.0, bound_m) == pytest.approx(share, abs=0.02)


def test_a_nearer_leader_unseen_costs_by_the_true_gap() -> None:
    env = _behind(10.2, 10.0, source="none")
    assert _share_lacking(env, 90.0, 0.5) == pytest.approx(0.5, abs=0.01)


def _share_lacking(env: DrivingEnv, gap_m: float, bound_m: float) -> float:
    """Of the RSS distance, by a standing leader that is perceived at a gap with a level."""
    car, e = _car(env)
    belief, lane = e.ego["belief"].copy(), env.world.vehicle.lane
    belief["speed_mps"] = 10.0
    x, y = lane.position(float(belief["longitudinal_m"][0]) + gap_m + env.world.vehicle.LENGTH, 0.0)
    seen = np.zeros(1, PERCEIVED)
    for name, value in (("x_m", x), ("y_m", y), ("length_m", env.world.vehicle.LENGTH), ("pl_at_m", bound_m)):
        seen[name] = value
    seen["relative"] = 1
    return float(_headway(belief[0], car, seen, 1, e.table.lanes, cost_figures(CostConfig())[0]))


@pytest.mark.parametrize("env_id", IDS)
def test_to_end_an_episode_badly_costs_more_than_any_limit(env_id: str) -> None:
    config = make_config(env_id)
    assert min(config.cost.collision, config.cost.off_road) > config.cost_limit


def test_groups_are_parts_of_the_weighted_cost() -> None:
    """Each cause is in one group at most, and with crashes, exits and context they are the whole."""
    grouped = [cause for causes in GROUPS.values() for cause in causes]
    assert set(CAUSES) - set(grouped) == {"cost_collision", "cost_off_road", "cost_context"}
    assert len(grouped) == len(set(grouped))
    env = DrivingEnv(make_config("lanebound/CarFollowing-v0", {"sky": "dense", "cost": {"context": 0.3}}))
    env.reset(seed=3)
    env.action_space.seed(3)
    seen = np.zeros(len(CAUSES))
    for _ in range(40):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        parts = [info["costs"] @ env.config.cost.weights_of(group) for group in GROUPS]
        assert parts == pytest.approx([env.config.cost.of_group(group, info) for group in GROUPS])
        rest = 200.0 * (info["cost_collision"] + info["cost_off_road"]) + 0.3 * info["cost_context"]
        assert sum(parts) + rest == pytest.approx(info["cost"])
        seen += info["costs"]
        if terminated or truncated:
            break
    assert np.count_nonzero(seen) >= 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cost_limits": {"lane": -1.0}}, r"cost_limits.lane must be >= 0, got -1"),
        ({"cost_limits": {"lanes": 1.0}}, r"cost_limits.lanes .*'cost_limits.lane'"),
        ({"cost_limits": {"hmi": 1.0}, "cost": {"hmi": 0.0}}, r"cost_limits.hmi must be left out .* raise cost.hmi"),
        (
            {"cost_limits": {"lane": 1.0}, "cost": {"lane": 0.0, "lane_integrity": 0.0}},
            r"cost_limits.lane .* got 1: raise cost.lane or cost.lane_integrity",
        ),
    ],
)
def test_a_limit_of_a_group_is_refused_where_it_cannot_hold_anything_back(changes: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_config("lanebound/LaneKeeping-v0", changes)
    half = {"cost_limits": {"lane": 1.0, "alert": 0.0}, "cost": {"lane": 0.0}}
    assert make_config("lanebound/LaneKeeping-v0", half).cost_limits.given == {"lane": 1.0, "alert": 0.0}


def test_leaving_the_road_costs_once() -> None:
    env = DrivingEnv(make_config("lanebound/LaneKeeping-v0", {"sky": "open"}))
    env.reset(seed=0)
    total, over = 0.0, False
    while not over:
        *_, terminated, truncated, info = env.step(np.array([0.0, 1.0], dtype=np.float32))
        total, over = total + info["cost_off_road"], terminated or truncated
    assert info["off_road"]
    assert total == 1.0
    assert info["cost"] >= env.config.cost.off_road


def test_every_epoch_of_a_step_is_judged() -> None:
    """At 2 decisions a second a step has five epochs; three of them hazardous are three fifths of its time."""
    env = DrivingEnv(make_config("lanebound/UrbanCanyon-v0", {"sky": "open", "world": {"vehicles_count": 0}}))
    env.reset(seed=0)
    e, seen = _loop(env).episodes, list[int]()
    count = e.count_epoch

    def displaced(rows: Any) -> None:
        seen.append(len(seen) + 1)
        belief, beside = e.ego["belief"], 5.0 if seen[-1] in (1, 3, 4) else 0.0
        x, y = env.world.vehicle.position
        levels = {"pl_at_m": 0.1, "pl_ct_m": 0.1, "available": 1}
        for name, value in {"fix_x_m": x, "fix_y_m": y + beside, **levels}.items():
            belief[name] = value
        count(rows)

    e.count_epoch = displaced  # type: ignore[method-assign]
    *_, info = env.step(IDLE)
    assert len(seen) == 5
    assert (info["hmi"], info["mi"], info["hmi_share"]) == (True, False, 0.6)
    assert info["cost_hmi"] == pytest.approx(0.6 * env.dt_s)


@pytest.mark.parametrize(
    ("error_ct_m", "level_m", "available", "said"),
    [
        (0.2, 0.3, True, (False, False)),
        (0.4, 0.3, True, (True, False)),
        (0.9, 0.3, True, (False, True)),
        (0.9, 0.7, True, (False, False)),
        (0.9, 0.3, False, (False, False)),
        (0.3 + 1e-12, 0.3, True, (False, False)),  # equal but for rounding
        (0.6 + 1e-12, 0.6, True, (False, False)),
        (0.3 + 1e-8, 0.3, True, (True, False)),
        (0.6 + 1e-8, 0.6, True, (False, True)),
    ],
)
def test_misleading_and_hazardous_exclude_each_other(
    error_ct_m: float, level_m: float, available: bool, said: tuple[bool, bool]
) -> None:
    """With an error along the track that misleads whenever the position is available and the other axis does not."""

    def judged(error_at_m: float) -> tuple[bool, bool]:
        levels = {"pl_at_m": 0.3, "pl_ct_m": level_m, "al_at_m": 1.5, "al_ct_m": 0.6, "available": available}
        score = record_of(SCORE)
        belief = record_of(BELIEF, fix_x_m=error_at_m, fix_y_m=error_ct_m, **levels)
        count_epoch(belief, score, cars_at([[0.0, 0.0]])[0])
        assert score["epochs"] == 1
        return bool(score["mi"]), bool(score["hmi"])

    assert judged(0.0) == said
    assert judged(0.5) == ((False, True) if said[1] else (available, False))


def test_a_leader_that_is_not_perceived_costs_in_full_until_the_car_stands() -> None:
    """To lose the radio saves nothing: the gap is then bounded by nothing."""
    env = _behind(12.0, 10.0, source="none")
    *_, info = env.step(np.array([0.0, 0.0], dtype=np.float32))
    assert info["cost_headway"] == pytest.approx(env.dt_s)
    env.world.vehicle.speed = 0.0
    *_, info = env.step(np.array([-1.0, 0.0], dtype=np.float32))
    assert info["cost_headway"] == 0.0


def test_a_lane_change_is_free_across_the_end_of_a_road() -> None:
    """merge-v1's roads end at 230, 310 and 390 m; the change takes from one to the next, at any moment of it."""
    env = wrap("merge-v1", {**PERFECT, "world": {}})
    for start in range(8, 30, 3):
        env.reset(seed=0)
        cost, over, k = 0.0, False, 0
        while not over:
            env.world.road.vehicles = [env.world.vehicle]
            *_, terminated, truncated, info = env.step(LEFT if k == start else IDLE)
            cost, over, k = cost + info["cost_lane"], terminated or truncated, k + 1
        assert cost == pytest.approx(0.0, abs=1e-6)


def test_the_body_may_stand_on_two_lanes_that_meet() -> None:
    """Half on the first lane, half on the next, which leaves it at an angle: each corner is inside of one of them."""
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0.0, 0.0], [50.0, 0.0]))
    network.add_lane("b", "c", StraightLane([50.0, 0.0], [90.0, 30.0]))
    lanes, corridor = lane_table(network).lanes, record_of(SCORE, leaving_side=-1)

    def out(x: float, y: float, heading_rad: float) -> float:
        return float(overhang_m(cars_at([[x, y]], heading_rad)[0], corridor, lanes, True))

    assert out(50.0, 0.0, 0.32) == 0.0
    assert out(20.0, 1.5, 0.0) == pytest.approx(0.5)
    assert out(-20.0, -1.5, 0.0) == pytest.approx(0.5)


def test_a_car_that_takes_itself_to_stand_does_so() -> None:
    """Below what the wheel pulses show, highway-env's control would let it creep for ever: an alert in a canyon."""
    env = DrivingEnv(make_config("lanebound/UrbanCanyon-v0", {"sky": "urban", "world": {"vehicles_count": 0}}))
    env.reset(seed=1)
    for _ in range(30):
        env.step(4)
    assert env.world.vehicle.speed == pytest.approx(0.0, abs=1e-9)


def test_the_wheels_turn_at_the_stated_rate_towards_what_is_commanded() -> None:
    """0.7 rad/s from step to step of the dynamics, however seldom decisions come."""
    env = DrivingEnv(make_config("lanebound/LaneKeeping-v0", {"sky": "open"}))
    env.reset(seed=0)
    belief = _loop(env).episodes.ego["belief"]
    for command, angle in ((0.5, 0.14), (0.5, 0.2), (-0.5, 0.06)):
        env.step(np.array([-0.5, command], dtype=np.float32))
        assert belief["steering_rad"][0] == pytest.approx(angle, abs=1e-6)
