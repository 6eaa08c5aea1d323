"""Guidance: two roads that look alike, the way to an exit, and what it costs to take the wrong one for the true one."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from lanebound.agents.episodes import full_id
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.batch.costs_kernel import TOLERANCE_MPS
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.worlds.guidance import FORK_M, parallel_roads
from lanebound.envs.worlds.networks import StreetNetwork
from lanebound.envs.worlds.paths import Path, Pose, s_bend, straight
from lanebound.integrity.core.errors import InputError
from side_by_side import Tally, drive, pair, require_equal

IDLE = 1
GIVEN: dict[str, Any] = {
    "sky": "open",
    "navigation": {"source": "perfect"},
    "world": {"vehicles_count": 0},
    "perception": {"source": "none"},
}


def placed(lane: tuple[str, str, int], along_m: float, aside_m: float, speed_mps: float) -> DrivingEnv:
    """The environment, with its car put on a lane after the start."""
    env = DrivingEnv(make_config("lanebound/Guidance-v0", GIVEN))
    env.reset(seed=1)
    car, there = env.world.vehicle, env.world.road.network.get_lane(lane)
    car.position, car.heading, car.speed = there.position(along_m, aside_m), there.heading_at(along_m), speed_mps
    car.lane_index, car.lane, car.target_lane_index = lane, there, lane
    loop = env.belief_loop
    assert loop is not None
    loop.seats.read(full=True)
    row = loop.episodes.table.row[lane]
    loop.episodes.ego["eye"]["target_lane"] = row
    loop.episodes.begin(np.zeros(1, dtype=np.int64), [1], None, np.ones((1, 0), dtype=np.bool_))
    loop.believed.target_speed = speed_mps
    loop._place()
    return env


def test_the_way_to_the_goal() -> None:
    """Lanes to change to the right, by hand; from the motorway only its third lane leads there."""
    table = lane_table(parallel_roads(3.5, 18.0))
    shifts: dict[tuple[str, str], list[int]] = {}
    lost = set()
    for (start, end, _), lane in zip(table.index, table.lanes.table, strict=True):
        shifts.setdefault((start, end), []).append(int(lane["goal_shift"]))
        if lane["lost"]:
            lost.add((start, end))
    assert lost == {("c", "d"), ("s", "w"), ("g", "e")}
    assert shifts["a", "b"] == [1, 0]  # as early as possible
    assert shifts["b", "c"] == [2, 1, 0]
    assert shifts["q", "s"] == [1, 0, -1]
    assert shifts["t", "u"][0] > 0  # a lane that ends
    assert shifts["v", "g"] == [2, 1, 0]
    assert shifts["g", "goal"] == [0]


def test_networks_of_the_same_lanes_with_other_goals_have_tables_of_their_own() -> None:
    def network(goal: tuple[str, str] | None) -> StreetNetwork:
        made = StreetNetwork(goal)
        path = Path.of(Pose(0.0, 0.0, 0.0), straight(50.0))
        made.add_beside(("a", "b"), path, range(2), 3.5, 10.0)
        made.add_beside(("b", "c"), Path.of(Pose(50.0, 0.0, 0.0), straight(50.0)), range(2), 3.5, 10.0)
        return made

    plain, there = lane_table(network(None)), lane_table(network(("b", "c")))
    assert not plain.lanes.table["lost"].any()
    assert not there.lanes.table["lost"].any()
    assert lane_table(network(("a", "b"))).lanes.table["lost"].tolist() == [0, 0, 1, 1]


def test_a_camera_sees_the_same_lanes_on_both_roads_until_the_fork() -> None:
    graph = parallel_roads(3.5, 18.0).graph
    for motorway, collector in ((("a", "b"), ("p", "q")), (("b", "c"), ("q", "s"))):
        one, other = (graph[start][end] for start, end in (motorway, collector))
        assert len(one) == len(other)
        for mine, theirs in zip(one, other, strict=True):
            assert mine.line_types == theirs.line_types
            assert mine.position(0.0, 0.0)[0] == theirs.position(0.0, 0.0)[0]
            assert theirs.position(0.0, 0.0)[1] - mine.position(0.0, 0.0)[1] == pytest.approx(21.5)
    assert graph["b"]["c"][0].position(300.0, 0.0)[0] == FORK_M


def test_a_slip_road_ends_where_the_next_begins() -> None:
    graph = parallel_roads(3.5, 18.0).graph
    slip = graph["c"]["t"][0]
    end, begin = slip.position(slip.length, 0.0), graph["t"]["u"][0].position(0.0, 0.0)
    np.testing.assert_allclose(end, begin, atol=1e-6)
    assert slip.heading_at(slip.length) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(InputError, match="shift_m"):
        s_bend(300.0, 250.0, 20.0)


@pytest.mark.parametrize(
    ("lane", "speed_mps", "excess_mps", "limit_mps"),
    [(("p", "q", 0), 20.0, 6.1, 13.9), (("p", "q", 0), 14.5, 0.0, 13.9), (("a", "b", 0), 27.0, 0.0, 27.8)],
)
def test_the_limit_of_the_true_lane_counts(
    lane: tuple[str, str, int], speed_mps: float, excess_mps: float, limit_mps: float
) -> None:
    env = placed(lane, 100.0, 0.0, speed_mps)
    *_, info = env.step(IDLE)
    excess = max(excess_mps - TOLERANCE_MPS, 0.0) if excess_mps else 0.0
    assert info["cost_speeding"] == pytest.approx(excess / limit_mps * env.dt_s, rel=0.15, abs=1e-9)


@pytest.mark.parametrize(("lane", "lost"), [(("b", "c", 1), True), (("b", "c", 2), False), (("q", "s", 2), True)])
def test_a_missed_exit_and_a_wrong_one_end_the_drive(lane: tuple[str, str, int], lost: bool) -> None:
    env = placed(lane, 290.0, 0.0, 13.9)
    paid, over = 0.0, False
    for _ in range(4):
        *_, over, _, info = env.step(IDLE)
        paid += info["cost_route"]
        if over:
            break
    assert (over, info["lost"], paid) == (lost, lost, float(lost))
    assert not info["is_success"]


@pytest.mark.parametrize(("along_m", "aside_m", "late"), [(200.0, 1.4, False), (270.0, 1.4, True), (270.0, 0.0, False)])
def test_to_change_lanes_at_the_gore_is_late(along_m: float, aside_m: float, late: bool) -> None:
    """A body of 2 m in a lane of 3.5 m is over its line beyond 0.75 m of offset."""
    env = placed(("b", "c", 1), along_m, aside_m, 0.1)
    *_, info = env.step(IDLE)
    assert info["cost_gore"] == pytest.approx(env.dt_s if late else 0.0)


def test_the_exit_of_the_collector_road_is_the_goal() -> None:
    env = placed(("g", "goal", 0), 10.0, 0.0, 13.9)
    over = False
    for _ in range(4):
        *_, over, _, info = env.step(IDLE)
        if over:
            break
    assert over
    assert info["is_success"]


@pytest.mark.parametrize(
    "config",
    [
        {"navigator": "services/spp", "lane_sensor": {"availability": 0.7, "dropout_s": 0.5}},
        {"navigation": {"source": "offset", "offset_ct_m": 21.5}, "observation": {"integrity": "oracle"}},
    ],
    ids=["sensed", "given"],
)
def test_the_engine_drives_as_single_environments_do(config: dict[str, Any]) -> None:
    tally = Tally()
    single, engine = pair("Guidance", {**config, "world": {"duration": 20.0}}, 2)
    for seed in (3, 4):
        drive(single, engine, seed, tally, row=seed % 2)
    require_equal(tally, 1)
    assert tally.steps > 40


def test_it_is_an_id_as_the_others() -> None:
    assert full_id("guidance") == "lanebound/Guidance-v0"
    env = gymnasium.make("lanebound/Guidance-v0", config=GIVEN)
    first, _ = env.reset(seed=7)
    again, _ = env.reset(seed=7)
    assert all(np.array_equal(first[group], again[group]) for group in first)
    assert env.action_space.n == 5  # type: ignore[attr-defined]
