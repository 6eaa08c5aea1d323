"""UrbanCanyon on a street map: the road, what stands around it, the sky, and the vector engine."""

from __future__ import annotations

import pickle
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from osm_files import blocks, node, osm, way
from recordings import real

from lanebound.envs.registration import make_config
from lanebound.envs.scene import alert_limits_m, navigator_config
from lanebound.envs.sky import SkyLevel, build_street
from lanebound.envs.world import make_world
from lanebound.envs.worlds.street_maps import (
    CUT_M,
    LEAST_RADIUS_M,
    MOVED_M,
    MapRoad,
    map_place,
    map_roads,
    map_roads_of,
)
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.maps.files import map_of
from lanebound.integrity.sky.raytrace import first_hits

ID, MAP = "lanebound/UrbanCanyon-v0", "berlin_kreuzberg"
IDLE, SLOWER = 1, 4


def road(name: str = MAP, route: int = 0, lane_width: float = 3.25, **rest: Any) -> MapRoad:
    [found] = map_roads_of({"map": name, "route": route, "lane_width": lane_width, **rest})
    return found


def poses(of: MapRoad, lane: int = 0) -> list[np.ndarray]:
    """East, North and heading along each road, 1 m apart."""
    network = of.network()
    lanes = [network.get_lane((a, b, lane)) for a, ends in network.graph.items() for b in ends]
    return [
        np.array([(*(one.position(s, 0.0) * (1.0, -1.0)), one.heading_at(s)) for s in np.linspace(0.0, one.length, 99)])
        for one in lanes
    ]


@pytest.mark.parametrize("route", range(4))
def test_the_roads_of_a_way_join(route: int) -> None:
    roads = poses(road(route=route))
    assert len(roads) >= 2
    for before, after in pairwise([*roads, roads[0]]):
        np.testing.assert_allclose(before[-1, :2], after[0, :2], atol=1e-6)
        assert np.cos(before[-1, 2] - after[0, 2]) == pytest.approx(1.0, abs=1e-12)
    turned = sum(float(part[-1, 2] - part[0, 2]) for part in roads)
    assert abs(turned) == pytest.approx(2.0 * np.pi, abs=1e-6)  # once around


@pytest.mark.parametrize("route", range(4))
def test_bends_can_be_driven_and_keep_to_the_streets(route: int) -> None:
    of = road(route=route)
    tightest = max(abs(piece.start) for path, _ in of.roads for piece in path.pieces)
    assert tightest <= 1.0 / LEAST_RADIUS_M + 1e-9
    along = np.concatenate(poses(of))[:, :2]
    streets = np.concatenate([
        start + share * (end - start)
        for street in map_of(MAP).streets
        for start, end in pairwise(street.points_en_m)
        for share in np.linspace(0.0, 1.0, 60)[:, None, None]
    ])  # fmt: skip
    beside = np.linalg.norm(along[:, None] - streets[None], axis=-1).min(1)
    assert np.median(beside) < 2.0
    assert beside.max() < 0.5 * 3.25 + MOVED_M + 2.0 * CUT_M


@pytest.mark.parametrize("name", [MAP, "berlin_neukoelln.osm.gz"])
def test_no_station_of_any_way_lies_in_a_building(name: str) -> None:
    file = name if name == MAP else str(real("maps_osm") / name)
    for of in map_roads(file):
        places = np.concatenate(poses(of))[:, :2]
        up = first_hits(of.city.grid, np.column_stack([places, np.full(len(places), 1.5)]), np.array([0.0, 0.0, 1.0]))
        assert up.clear.all()


def test_ways_are_numbered_by_length_and_limits_are_those_of_the_map() -> None:
    found = map_roads(MAP)
    assert len(found) == 8
    assert [road(route=k).length_m for k in (0, 3)] == [found[k].length_m for k in (0, 3)]
    lengths = [of.length_m for of in found]
    assert all(a > b - 50.0 for a, b in pairwise(lengths))
    assert lengths[0] > 1400.0
    limits = {street.speed_limit_mps for street in map_of(MAP).streets}
    assert {limit for of in found for _, limit in of.roads} <= limits


def test_traffic_keeps_to_the_right(tmp_path: Path) -> None:
    of = road(str(blocks(tmp_path / "map.osm", rows=2, columns=2)))
    assert of.length_m == pytest.approx(4 * 120.0, rel=0.1)
    frame = map_of(str(tmp_path / "map.osm"))
    centre = np.mean([street.points_en_m.mean(0) for street in frame.streets], axis=0)
    for part in poses(of):
        east, north = centre - part[0, :2]  # roads begin in the middle of a side
        on_right = np.cos(part[0, 2]) * north + np.sin(part[0, 2]) * east < 0.0
        gap = np.abs((east, north)).max()
        assert gap == pytest.approx(60.0 + (-1.625 if on_right else 1.625), abs=0.05)


def test_a_street_of_two_lanes_each_way_has_two(tmp_path: Path) -> None:
    of = road(str(blocks(tmp_path / "map.osm", columns=2, lanes="4")))
    assert of.lanes == 2
    left, right = poses(of), poses(of, 1)
    for one, other in zip(left, right, strict=True):
        np.testing.assert_allclose(np.linalg.norm(one[[0, -1], :2] - other[[0, -1], :2], axis=1), 3.25, atol=1e-9)


@pytest.mark.parametrize("lanes", [1, 2, 3, 5, 8])
def test_every_lane_of_a_corner_can_be_driven(tmp_path: Path, lanes: int) -> None:
    each = {"lanes:forward": str(lanes), "lanes:backward": str(lanes)}
    found = map_roads(str(blocks(tmp_path / "map.osm", side_m=300.0, **each)))
    assert len(found) == 6  # around each block and both, in either direction
    for of in found:
        assert of.lanes == lanes
        for lane in of.network().lanes_list():
            bends = [abs(lane.curvature_at(s)) for s in np.linspace(0.0, lane.length, 2000)]
            assert max(bends) <= 1.0 / LEAST_RADIUS_M + 1e-9


def test_the_rightmost_lane_of_a_street_of_three_is_beside_its_kerb(tmp_path: Path) -> None:
    file = str(blocks(tmp_path / "map.osm", columns=2, lanes="3"))  # one along the points, two against them
    streets = map_of(file).streets
    assert {(street.lanes, street.lanes_back) for street in streets} == {(1, 2)}
    centre = np.mean([street.points_en_m.mean(0) for street in streets], axis=0)
    for of in map_roads(file):
        assert of.lanes == 1
        for part in poses(of):
            gap = np.abs(centre - part[0, :2]).max()  # roads begin in the middle of a side, 60 m from the centre
            assert abs(gap - 60.0) == pytest.approx(3.25, abs=0.05)


@pytest.mark.parametrize("seed", range(20))
def test_no_bridge_of_the_way_itself_stands_above_it(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = np.array([(0, 0), (200, 0), (200, 200), (0, 200)]) + rng.uniform(-30.0, 30.0, (4, 2))
    deck = {"highway": "residential", "oneway": "yes", "bridge": "yes", "layer": "1"}
    plain = {"highway": "residential", "oneway": "yes"}
    text = "".join(node(k + 1, *place) for k, place in enumerate(corners))
    text += "".join(way(k + 1, [k + 1, (k + 1) % 4 + 1], deck if k == 0 else plain) for k in range(4))
    text += node(9, *(corners[0] - 90.0)) + node(8, *(corners[2] + rng.uniform(50.0, 90.0, 2)))
    text += way(8, [1, 9], deck | {"oneway": "no"}) + way(9, [8, 3], deck)  # side streets that end at junctions
    file = tmp_path / "map.osm"
    file.write_text(osm(text), encoding="utf-8")
    assert len(map_of(str(file)).bridges) == 3
    (of,) = map_roads(str(file))
    assert not len(of.city)


def test_long_ways_are_cut_into_roads_whose_sky_is_known(tmp_path: Path) -> None:
    file = str(blocks(tmp_path / "map.osm", columns=6, rows=6, side_m=620.0))
    of = road(file)
    assert of.length_m > 10_000.0
    assert max(path.length for path, _ in of.roads) <= 2500.0
    config = {"sky": "open", "world": {"map": file}, "extent_m": 300.0}
    with pytest.raises(InputError, match=r"extent_m must be \d+ m or more with this world\.map, got 300"):
        gymnasium.make(ID, config=config).reset(seed=0)


def test_a_covered_street_is_a_tunnel_and_a_bridge_stands_above(tmp_path: Path) -> None:
    railway = node(60, 60.0, -60.0) + node(61, 60.0, 60.0)
    railway += way(300, [60, 61], {"railway": "rail", "bridge": "yes", "layer": "1"})
    below = road(str(blocks(tmp_path / "map.osm", columns=2, streets=railway)))
    assert len(below.city) == 12
    tunnel = road(str(blocks(tmp_path / "tunnel.osm", columns=2, covered="yes")))
    places = np.concatenate(poses(tunnel))[:, :2]
    up = first_hits(tunnel.city.grid, np.column_stack([places, np.full(len(places), 1.5)]), np.array([0.0, 0.0, 1.0]))
    assert (~up.clear).mean() > 0.9


def test_without_a_closed_way_the_map_or_the_places_are_named(tmp_path: Path) -> None:
    file = str(blocks(tmp_path / "map.osm"))
    frame = map_of(file).frame
    same = [frame.lat_lon_of([0.0, 0.0]).tolist()] * 2
    with pytest.raises(InputError, match=r"world\.via must be places of .* that a closed way joins"):
        road(file, via=same)
    with pytest.raises(InputError, match=r"world\.map must hold a closed way that can be driven, got none"):
        road(str(blocks(tmp_path / "line.osm", rows=1)))


def test_by_way_of_places() -> None:
    frame, longest = map_of(MAP).frame, road()
    stops = [frame.lat_lon_of(part[50, :2]).tolist() for part in poses(longest)[:2]]
    of = road(via=stops)
    everything = np.concatenate(poses(of))[:, :2]
    for stop in stops:
        assert np.linalg.norm(everything - frame.en_of(*stop), axis=1).min() < 5.0


@pytest.mark.parametrize(
    ("world", "words"),
    [
        ({"map": MAP, "route": 500}, r"world\.route must be below 1\d in berlin_kreuzberg, got 500"),
        ({"map": MAP, "route": -1}, r"world\.route must be a whole number between 0 and 1000"),
        ({"map": MAP, "via": [[52.5, 13.4]]}, r"world\.via must be two places or more"),
        ({"map": MAP, "via": [["a", 1], [2, 3]]}, r"world\.via must be two places or more"),
        ({"map": MAP, "via": [[52.5, 13.4], [52.5, 13.4, 40]]}, r"world\.via must be two places or more"),
        ({"map": MAP, "via": [[52.5, 13.4], [52.5, 213.4]]}, r"world\.via must be two places or more"),
        ({"map": MAP, "via": [[95.0, 13.4], [52.5, 13.4]]}, r"world\.via must be two places or more"),
        ({"map": MAP, "via": [[0.0, 0.0], [1.0, 1.0]]}, r"world\.via\.0 must lie within 200 m of a street"),
        ({"map": MAP, "via": [[13.4, 52.5]] * 2}, r"world\.via\.0 must lie within 200 m .* write latitude, longitude"),
        ({"map": MAP, "via": [[52.5, 13.4]] * 9}, r"world\.via must hold at most 8 places, got 9"),
        ({"map": MAP, "via": 3}, r"world\.via must be two places or more"),
        ({"map": MAP, "via": [[52.5, float("nan")], [52.5, 13.4]]}, r"world\.via\.0\.1 must be finite, got nan"),
        ({"route": 1}, r"must be left out without world\.map"),
        ({"map": 7}, r"world\.map must be a packaged map or a file"),
        ({"map": "nowhere.osm"}, "must be a packaged one or a file"),
    ],
)
def test_refusals(world: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make_config(ID, {"world": world}) and gymnasium.make(ID, config={"world": world})


def test_the_level_open_has_no_buildings_and_others_those_of_the_map() -> None:
    world = make_world("UrbanCanyonWorld", {"map": MAP}, {"type": "DiscreteMetaAction"}, 20, 2)
    world.reset()
    network, obstacles = world.road.network, world.surroundings[0]
    assert world.sections == ()
    open_sky = build_street(network, SkyLevel.named("open"), 0, world.sections, 2500.0, obstacles, reuse=False)
    assert not len(open_sky.city)
    one, two = (build_street(network, SkyLevel.named("urban"), k, (), 2500.0, obstacles) for k in (0, 1))
    np.testing.assert_array_equal(one.city.triangles_enu_m, obstacles.triangles_enu_m)
    assert (one.city.material != two.city.material).any()
    blocked = (one.mask.path >= 2).mean()
    assert 0.1 < blocked < 0.6
    again = build_street(network, SkyLevel.named("urban"), 0, (), 2500.0, obstacles)
    assert again is one


def test_satellites_are_those_of_the_place() -> None:
    config = make_config(ID, {"world": {"map": MAP}})
    sky = navigator_config(config, (1.5, 0.625)).sky
    frame = map_of(MAP).frame
    assert (sky.lat_deg, sky.lon_deg) == (frame.lat_deg, frame.lon_deg)
    assert map_place({}) == {}
    moved = make_config(ID, {"world": {"map": MAP}, "navigator": {"sky": {"lat_deg": 10.0}}})
    assert navigator_config(moved, (1.5, 0.625)).sky.lat_deg == 10.0
    env = gymnasium.make(ID, config={"world": {"map": MAP}}).unwrapped
    assert alert_limits_m(env.world, env.config)[1] == pytest.approx(0.625)


def test_a_road_can_be_pickled() -> None:
    of = road()
    again = pickle.loads(pickle.dumps(of))
    assert again.roads == of.roads
    assert again.city.digest == of.city.digest


def test_an_episode_in_both_engines() -> None:
    config = {"sky": "urban", "cities": {"count": 1}, "world": {"map": MAP, "duration": 10.0}}
    vector = gymnasium.make_vec(ID, num_envs=1, config=config)
    single = gymnasium.make(ID, config=config)
    (both, _), (one, _) = vector.reset(seed=[4]), single.reset(seed=4)
    total, done = 0.0, False
    actions = iter([SLOWER] * 2 + [IDLE] * 18)
    while not done:
        action = next(actions)
        for key, row in one.items():
            np.testing.assert_array_equal(both[key][0], row)
        both, rewards, *_ = vector.step(np.array([action]))
        one, reward, ended, late, info = single.step(action)
        assert rewards[0] == pytest.approx(reward, abs=1e-12)
        total, done = total + float(reward), ended or late
    assert total > 1.0
    assert info["cost_collision"] == info["cost_off_road"] == 0.0
    vector.close()
