"""Where lanes lie among the stations, the way ahead, and the satellites predicted there."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from highway_env.envs import RoundaboutEnv
from highway_env.road.lane import StraightLane
from highway_env.road.road import RoadNetwork
from plain_sky_ahead import ahead, predicted_beside

from lanebound.agents.episodes import open_env
from lanebound.envs.batch.sky_ahead_kernel import NO_LANE
from lanebound.envs.sky import SkyLevel, Street, build_street
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.city import CityConfig, SectionKind
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

CANYON = SkyLevel(city=CityConfig.uniform(SectionKind.DENSE_CANYON))


def fork() -> RoadNetwork:
    """Two lanes "a" -> "b", then one straight on to "c" or two to the right, "d"."""
    network = RoadNetwork()
    for y in (0.0, 4.0):
        network.add_lane("a", "b", StraightLane(np.array([0.0, y]), np.array([103.0, y])))
    network.add_lane("b", "c", StraightLane(np.array([103.0, 4.0]), np.array([160.0, 4.0])))
    for x in (103.0, 107.0):
        network.add_lane("b", "d", StraightLane(np.array([x, 10.0]), np.array([x, 70.0])))
    return network


@cache
def street() -> Street:
    return build_street(fork(), CANYON, 2, reuse=False)


@cache
def sky() -> SkyView:
    config = SkyConfig()
    return SkyTrack.from_config(config, 60.0).at(config.start_gps_s, np.zeros(1, dtype=np.int64))


def test_stations_follow_each_other_edge_by_edge() -> None:
    s = street()
    assert s.mask.path.shape[:2] == (22 + 13 + 13, 2)
    assert s.where(("a", "b", 1), 33.0) == (33.0, 1)
    assert s.where(("b", "c", 0), 0.0) == (110.0, 0)
    assert s.where(("b", "d", 1), 59.9) == (110.0 + 65.0 + 59.9, 1)


@pytest.mark.parametrize(("asked", "arc"), [(-5.0, 110.0), (57.0, 167.0), (500.0, 167.0)])
def test_places_off_a_lane_are_those_of_its_ends(asked: float, arc: float) -> None:
    assert street().where(("b", "c", 0), asked)[0] == pytest.approx(arc)


def test_a_lane_without_a_number_is_the_first() -> None:
    assert street().where(("b", "c", None), 3.0) == street().where(("b", "c", 0), 3.0)


@pytest.mark.parametrize("index", [("a", "c", 0), ("a", "b", 2)])
def test_an_unknown_lane_is_refused(index: tuple[str, str, int]) -> None:
    with pytest.raises(InputError, match="lane_index must be a lane of this street"):
        street().where(index, 0.0)


def test_the_mask_answers_at_stations_as_it_does_for_the_antennas() -> None:
    network, s = fork(), street()
    antennas = s.lanes.antennas(network, 1.5)
    for index, along in ((("a", "b", 1), 50.0), (("b", "d", 0), 20.0)):
        arc, lane = s.where(index, along)
        x, y = network.get_lane(index).position(along, 0.0)
        np.testing.assert_allclose(antennas[round(arc / 5.0), lane], [x, -y, 1.5])


def test_the_way_ahead_follows_the_route_or_the_first_edge() -> None:
    assert ahead(fork(), ("a", "b", 0), 10.0, 50.0) == (("a", "b", 0), 60.0)
    assert ahead(fork(), ("a", "b", 0), 93.0, 30.0) == (("b", "c", 0), 20.0)
    route = [("a", "b", 0), ("b", "d", None)]
    assert ahead(fork(), ("a", "b", 0), 93.0, 30.0, route) == (("b", "d", 0), 20.0)
    assert ahead(fork(), ("a", "b", 1), 93.0, 30.0, route) == (("b", "d", 1), 20.0)
    assert ahead(fork(), ("a", "b", 1), 93.0, 900.0) == (("b", "c", 0), 57.0)


def test_a_ring_has_no_end() -> None:
    env = RoundaboutEnv()
    env.reset(seed=0)
    index, place = ahead(env.road.network, ("se", "ex", 0), 0.0, 1e4)
    assert 0.0 <= place <= env.road.network.get_lane(index).length


def test_predicted_satellites_are_what_the_map_has_there() -> None:
    s, view = street(), sky()
    distances = np.array([0.0, 20.0, 60.0, 90.0])
    found = predicted_beside(s, fork(), ("a", "b", 0), 30.0, distances, view)[:, 1]
    for d, count in zip(distances, found, strict=True):
        arc, lane = s.where(*ahead(fork(), ("a", "b", 0), 30.0, float(d)))
        assert count == s.forecast.count(np.array([arc]), np.array([lane]), view)[0]
    assert (found < view.above[0].sum()).all()
    assert len(set(found)) > 1


def test_what_is_predicted_does_not_follow_from_what_is_received() -> None:
    s, view = street(), sky()
    blind = replace(s, mask=SkyMask.open())
    where = (("a", "b", 0), 30.0, [0.0, 20.0, 60.0], view)
    np.testing.assert_array_equal(predicted_beside(s, fork(), *where), predicted_beside(blind, fork(), *where))


def test_lanes_beside_are_left_own_and_right() -> None:
    s, view = street(), sky()
    distances = [5.0, 40.0, 90.0]
    left_lane = predicted_beside(s, fork(), ("a", "b", 0), 20.0, distances, view)
    right_lane = predicted_beside(s, fork(), ("a", "b", 1), 20.0, distances, view)
    np.testing.assert_array_equal(left_lane[:2, 1:], right_lane[:2, :2])
    assert (left_lane[:, 0] == NO_LANE).all()
    assert (right_lane[:, 2] == NO_LANE).all()
    assert right_lane[2, 0] == NO_LANE  # beyond "b" there is one lane


def test_an_open_sky_predicts_all_that_is_above_the_mask() -> None:
    s = build_street(fork(), SkyLevel.named("open"), 0)
    found = predicted_beside(s, fork(), ("a", "b", 0), 0.0, [0.0, 150.0], sky())
    assert found[:, 1].tolist() == 2 * [int(sky().above.sum())]


@pytest.mark.parametrize("name", ["Roundabout", "Highway"])
def test_an_environment_observes_what_is_predicted_along_its_route(name: str) -> None:
    env = open_env(name, {"sky": "dense", "duration_s": 6.0})
    env.reset(seed=3)
    lanes = set()
    for _ in range(6):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        loop, network = env.belief_loop, env.world.road.network
        belief, measured = loop.belief(), loop.episodes.navigation.measurements
        along = network.get_lane(belief.lane_index).local_coordinates(belief.position_m)[0]
        given = (belief.lane_index, along, env.config.observation.satellites_m, measured.sky, loop.ego.route)
        found = loop.episodes.views.sky[0].reshape(-1, 3)
        np.testing.assert_array_equal(found, predicted_beside(loop.street, network, *given))
        lanes |= {index for index in found.ravel().tolist() if index >= 0.0}
        if terminated or truncated:
            break
    assert len(lanes) > 1


def test_a_copy_shares_the_tables() -> None:
    assert copy.deepcopy(street()) is street()
