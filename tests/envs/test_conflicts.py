"""Conflicts of crossing courses, against closed forms on two straight roads that cross."""

from __future__ import annotations

from typing import Any

import pytest
from highway_env.road.lane import StraightLane
from highway_env.road.road import RoadNetwork

from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.batch.conflict_kernel import STEP_S, second_arrival_s
from lanebound.envs.batch.costs_kernel import _conflict
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.records_kernel import SCORE
from lanebound.envs.batch.rules import cost_figures
from lanebound.envs.costs import CostConfig
from lanebound.integrity.core.records import Records
from vehicles import cars_at, record_of

HORIZON_S = 1.5
HALF_M = 2.5 + 1.0  # half a length and half a width: between the middles of two cars that touch on crossing roads


def crossing() -> Any:
    """A road along x and one along y through the origin, each 200 m long."""
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([-100.0, 0.0], [100.0, 0.0]))
    network.add_lane("c", "d", StraightLane([0.0, -100.0], [0.0, 100.0]))
    return lane_table(network)


def cars(ego_m: float, ego_mps: float, other_m: float, other_mps: float) -> Records:
    """The ego so far before the crossing along x, the other along y; negative beyond it."""
    made = cars_at([[-ego_m, 0.0], [0.0, -other_m]], [0.0, 1.5707963267948966], [ego_mps, other_mps])
    made["lane"][:] = 0, 1
    return made


def t2(made: Records, past_s: float = 0.0) -> float:
    return float(second_arrival_s(made, crossing().lanes, HORIZON_S, past_s))


@pytest.mark.parametrize(("ego_m", "other_m"), [(6.0, 10.0), (10.0, 6.0), (9.0, 9.0)])
def test_on_a_collision_course_it_is_the_time_of_the_second_arrival(ego_m: float, other_m: float) -> None:
    """Both at 8 m/s: the second one touches where the first one is when its front is at the other's side."""
    expected = (max(ego_m, other_m) - HALF_M) / 8.0
    assert t2(cars(ego_m, 8.0, other_m, 8.0)) == pytest.approx(expected, abs=STEP_S)


def test_when_the_first_leaves_it_is_the_post_encroachment_time() -> None:
    """The ego's tail has left the other's lane; the other one is 8 m from it."""
    assert t2(cars(-HALF_M + 0.01, 8.0, 8.0 + HALF_M, 8.0)) == pytest.approx(1.0, abs=STEP_S)
    assert t2(cars(-HALF_M - 0.01, 8.0, 8.0 + HALF_M, 8.0)) == HORIZON_S


def test_an_encroachment_between_two_decisions_counts() -> None:
    """The ego left 0.3 s ago; the other one is 0.6 s away: 0.9 s."""
    gone = cars(-HALF_M - 0.3 * 8.0, 8.0, 0.6 * 8.0 + HALF_M, 8.0)
    assert t2(gone) == HORIZON_S
    assert t2(gone, 0.5) == pytest.approx(0.9, abs=2.0 * STEP_S)


@pytest.mark.parametrize(
    "made",
    [
        cars(8.0, 0.0, 10.0, 8.0),  # the ego waits before the other's lane
        cars(30.0, 8.0, 10.0, 8.0),  # it comes long after the other
        cars(-20.0, 8.0, 10.0, 8.0),  # it has gone
    ],
)
def test_no_conflict(made: Records) -> None:
    assert t2(made, 0.5) == HORIZON_S


def test_who_follows_on_the_same_road_is_in_no_conflict_of_courses() -> None:
    made = cars_at([[0.0, 0.0], [6.0, 0.0]], 0.0, [10.0, 2.0])
    made["lane"][:] = 0
    assert t2(made) == HORIZON_S


def test_a_wreck_is_in_no_conflict() -> None:
    made = cars(9.0, 8.0, 9.0, 8.0)
    made["crashed"][1] = 1
    assert t2(made) == HORIZON_S


def test_the_cost_of_a_conflict_is_its_peak_whatever_the_steps() -> None:
    """Both decisions of a conflict together cost its largest severity; the next conflict costs anew."""
    lanes, figures, score = crossing().lanes, cost_figures(CostConfig())[0], record_of(SCORE)
    near, nearer, none = cars(12.0, 8.0, 12.0, 8.0), cars(8.0, 8.0, 8.0, 8.0), cars(60.0, 8.0, 60.0, 8.0)

    def paid(made: Records, dt: float = 0.5) -> float:
        return float(_conflict(made, score, lanes, figures, dt))

    severity = 1.0 - t2(nearer, 0.5) / HORIZON_S
    assert 0.0 < paid(near) < severity
    assert paid(nearer) + (1.0 - t2(near, 0.5) / HORIZON_S) == pytest.approx(severity)
    assert paid(near) == paid(none) == 0.0
    assert paid(nearer) == pytest.approx(severity)
    score = record_of(SCORE)
    assert paid(nearer, 0.0) == 0.0  # at a start


def test_lanes_that_cross_are_those_of_crossings() -> None:
    """The left turn of the intersection is; motorway, merge and city have no crossing."""
    quiet: dict[str, Any] = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "none"}}
    for name in ("Highway", "Merge", "UrbanCanyon", "LaneKeeping", "CarFollowing"):
        env = DrivingEnv(make_config(f"lanebound/{name}-v0", quiet))
        env.reset(seed=0)
        assert env.belief_loop is not None
        assert not env.belief_loop.episodes.table.has_crossings, name
    env = DrivingEnv(make_config("lanebound/Intersection-v0", quiet))
    env.reset(seed=0)
    assert env.belief_loop is not None
    table = env.belief_loop.episodes.table
    crossed = {table.index[n][:2] for n in range(len(table.index)) if table.lanes.table["crossed"][n]}
    assert ("ir0", "il1") in crossed
    cars_now = env.belief_loop.episodes.cars
    assert table.index[int(cars_now["onward"][0, 0])][:2] == ("ir0", "il1")  # the ego turns left
