"""Streets along real networks: nothing stands on a lane, equal inputs give equal bits, and the mask is the city's."""

from __future__ import annotations

from contextlib import nullcontext
from functools import cache

import numpy as np
import pytest
from highway_env.envs import IntersectionEnv, MergeEnv, RacetrackEnv, RoundaboutEnv
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.sky import SkyLevel, Street, build_street
from lanebound.envs.sky.corridors import CLEARANCE_M, corridors, edges_of
from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.city import CityConfig, SectionConfig, SectionKind
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.raytrace import first_hits
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

ENVS = {"intersection": IntersectionEnv, "merge": MergeEnv, "racetrack": RacetrackEnv, "roundabout": RoundaboutEnv}
BUILT = ("semi_urban", "dense_canyon", "suburban", "trees")
NO_BRIDGES = SkyLevel(
    city=CityConfig(sections=tuple(SectionConfig(kind=SectionKind(kind), length_m=60.0) for kind in BUILT))
)


@cache
def network_of(name: str) -> RoadNetwork:
    env = ENVS[name]()
    env.reset(seed=0)
    return env.road.network


def straight(lanes: int = 2, length_m: float = 120.0) -> RoadNetwork:
    return RoadNetwork.straight_road_network(lanes, length=length_m)


def canyon(kind: SectionKind = SectionKind.DENSE_CANYON) -> SkyLevel:
    return SkyLevel(city=CityConfig.uniform(kind))


def roofs(street: Street, en: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether something solid stands over or on points (n, 2)."""
    ground = np.concatenate([en, np.full((len(en), 1), 0.01)], -1)
    return np.asarray(~first_hits(street.city.grid, ground, np.array([0.0, 0.0, 1.0])).clear)


@pytest.fixture
def city_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SkyMask, "of_stations", lambda *args: SkyMask.open())
    monkeypatch.setattr(SkyForecast, "of_stations", lambda *args: SkyForecast.open())


@pytest.mark.usefixtures("city_only")
@pytest.mark.parametrize("name", sorted(ENVS))
@pytest.mark.parametrize("seed", [0, 5])
def test_no_building_stands_on_a_lane_or_closer_than_the_clearance(name: str, seed: int) -> None:
    network = network_of(name)
    street = build_street(network, NO_BRIDGES, seed, reuse=False)
    assert len(street.city) > 200
    for lane in network.lanes_list():
        side = 0.5 * lane.width_at(0.0) + CLEARANCE_M - 0.1
        s = np.arange(0.0, lane.length, 1.0)
        points = np.array([lane.position(x, r) for x in s for r in np.linspace(-side, side, 9)])
        assert not roofs(street, points * [1.0, -1.0]).any()


@pytest.mark.usefixtures("city_only")
@pytest.mark.parametrize("name", ["intersection", "roundabout"])
def test_both_sides_of_every_long_road_are_lined(name: str) -> None:
    network = network_of(name)
    street = build_street(network, canyon(), 1, reuse=False)
    for (start, end), lanes in edges_of(network):
        if lanes[0].length < 80.0:
            continue
        middle = [lanes[0].position(s, 0.0) * [1.0, -1.0] for s in np.arange(20.0, 80.0, 2.0)]
        normal = np.array([-np.sin(lanes[0].heading_at(0.0)), np.cos(lanes[0].heading_at(0.0))]) * [1.0, -1.0]
        for side in (-1.0, 1.0):
            lined = [roofs(street, m + side * r * normal) for m in middle for r in [np.arange(6.0, 26.0)[:, None]]]
            assert np.mean([x.any() for x in lined]) > 0.6, (start, end, side)


def test_equal_inputs_equal_bits_with_and_without_threads() -> None:
    first = build_street(straight(), canyon(), 3, reuse=False)
    for context in (nullcontext, serial):
        with context():
            again = build_street(straight(), canyon(), 3, reuse=False)
        np.testing.assert_array_equal(first.city.triangles_enu_m, again.city.triangles_enu_m)
        np.testing.assert_array_equal(first.mask.path, again.mask.path)
        np.testing.assert_array_equal(first.mask.excess_m, again.mask.excess_m)
        np.testing.assert_array_equal(first.forecast.free, again.forecast.free)
    other = build_street(straight(), canyon(), 4, reuse=False)
    assert other.city.triangles_enu_m.shape != first.city.triangles_enu_m.shape or not np.array_equal(
        other.city.triangles_enu_m, first.city.triangles_enu_m
    )


def test_a_canyon_along_the_road_leaves_the_sky_ahead_and_takes_the_sides() -> None:
    street = build_street(straight(1), canyon(), 0, reuse=False)
    table = street.mask.path.reshape(*street.mask.path.shape[:2], street.mask.azimuths, street.mask.elevations)
    low = 3  # 9 to 12 deg
    east, north = street.mask.azimuths // 4, 0  # the road runs along x, which is East
    assert (table[:12, 0, east, low] == SignalPath.LOS).all()
    assert (table[:, 0, north, low] != SignalPath.LOS).mean() > 0.7


def test_named_sections_lie_where_they_are_named_unless_the_level_ignores_them() -> None:
    level = canyon(SectionKind.OPEN)
    named = [("0", "1", 40.0, 80.0, "tunnel")]
    street = build_street(straight(), level, 0, named, reuse=False)
    zenith = street.mask.path[:, 0, street.mask.elevations - 1] != SignalPath.LOS
    at = 5.0 * np.arange(zenith.size)
    inside, outside = (at > 40.0) & (at < 80.0), (at < 40.0) | (at > 80.0)
    assert zenith[inside].all()
    assert not zenith[outside].any()
    assert not len(build_street(straight(), level.replace(follow_sections=False), 0, named, reuse=False).city)


def test_what_a_world_does_not_name_is_the_levels_own() -> None:
    covered = build_street(straight(), canyon(), 0, [("0", "1", 0.0, np.inf, "open")], reuse=False)
    assert not len(covered.city)
    partly = build_street(straight(), canyon(), 0, [("0", "1", 60.0, np.inf, "open")], reuse=False)
    corners = partly.city.triangles_enu_m[..., 0]
    assert corners.min() < 20.0
    assert 50.0 < corners.max() <= 60.5


def test_an_open_level_needs_no_table() -> None:
    street = build_street(straight(), SkyLevel.named("open"), 0)
    assert len(street.city) == 0
    assert street.mask.path.size == 1


def test_long_edges_are_lined_up_to_the_extent() -> None:
    street = build_street(straight(1, 9000.0), canyon(), 0, extent_m=100.0, reuse=False)
    assert street.mask.path.shape[0] == 21
    assert street.where(("0", "1", 0), 8000.0) == (100.0, 0)
    assert 150.0 < street.city.triangles_enu_m[..., 0].max() < 260.0


def test_edges_that_continue_each_other_are_one_street() -> None:
    found = {c.edge: c for c in corridors(network_of("merge"), 2500.0)}
    assert found["a", "b"].chain == found["b", "c"].chain == found["c", "d"].chain
    assert [found[e].start_m for e in (("a", "b"), ("b", "c"), ("c", "d"))] == pytest.approx([0.0, 230.0, 310.0], abs=2)
    assert found["j", "k"].chain == found["k", "b"].chain != found["a", "b"].chain


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"extent_m": 0.0}, "extent_m must be positive"),
        ({"network": RoadNetwork()}, "network must have lanes"),
        ({"sections": [("0", "9", 0.0, 1.0, "open")]}, "must name edges of the network"),
        ({"sections": [("0", "1", 0.0, 1.0, "jungle")]}, "must name kinds among"),
    ],
)
def test_bad_input_is_refused(change: dict[str, object], message: str) -> None:
    given = {"network": straight(), "level": canyon(), "layout_seed": 0, "reuse": False} | change
    with pytest.raises(InputError, match=message):
        build_street(**given)  # type: ignore[arg-type]
