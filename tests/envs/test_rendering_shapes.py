"""What is drawn, before it is drawn: camera, roads, scenery, series and the derived facts of a frame."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import highway_env  # noqa: F401  registers the environments traced below
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, LineType, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st

from beliefs import believe
from lanebound.envs.records import EgoBelief
from lanebound.envs.rendering import Bodies, Frame, RenderingConfig, Status, Tape, Trace
from lanebound.envs.rendering.camera import Camera, oriented_box
from lanebound.envs.rendering.map_view import camera_of
from lanebound.envs.rendering.roads import RoadDrawing, corridor
from lanebound.envs.rendering.scenery import Scenery
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.sky.scene import City, Surface, prisms

WIDTH_M, RADIUS_M = 3.25, 40.0
SQUARE = np.array([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]])


def area(polygons):
    """Areas of polygons (n, k, 2) by the shoelace formula."""
    x, y = np.moveaxis(polygons, -1, 0)
    return 0.5 * np.abs((x * np.roll(y, -1, -1) - y * np.roll(x, -1, -1)).sum(-1))


def bend() -> RoadNetwork:
    """50 m ahead, then a quarter turn to the right about (50, 40)."""
    lines = (LineType.CONTINUOUS_LINE, LineType.STRIPED)
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0, 0], [50, 0], width=WIDTH_M, line_types=lines))
    turn = CircularLane([50, RADIUS_M], RADIUS_M, -np.pi / 2, 0.0, True, width=WIDTH_M, line_types=lines)
    network.add_lane("b", "c", turn)
    return network


def belief(**changes) -> EgoBelief:
    """20 m along the straight."""
    place = {"position_m": np.array([20.0, 0.0]), "longitudinal_m": 20.0, "al_at_m": 1.0, "al_ct_m": 0.6}
    return believe(**(place | changes))


def frame(heading=0.0, **changes) -> Frame:
    bodies = Bodies(np.array([[20.0, 0.0]]), np.array([heading]), np.array([5.0]), np.array([2.0]), np.array([False]))
    return Frame(bend(), bodies, 0, belief(**changes), time_s=1.0, speed_mps=10.0)


@given(st.floats(-4, 4), st.floats(-300, 300), st.floats(-300, 300))
@settings(max_examples=30, deadline=None)
def test_the_camera_turns_its_heading_up_and_keeps_distances(up, x, y):
    camera = Camera(np.array([x, y]), up, 8.0, (330.0, 356.0), (660.0, 540.0))
    ahead = np.array([x + 10 * np.cos(up), y + 10 * np.sin(up)])
    right = np.array([x - 10 * np.sin(up), y + 10 * np.cos(up)])
    np.testing.assert_allclose(camera.px([x, y]), [330, 356], atol=1e-9)
    np.testing.assert_allclose(camera.px(ahead), [330, 276], atol=1e-9)
    np.testing.assert_allclose(camera.px(right), [410, 356], atol=1e-9)


@given(st.floats(-4, 4), st.floats(0, 660), st.floats(0, 540))
@settings(max_examples=50, deadline=None)
def test_whatever_is_on_the_map_is_seen(up, u, v):
    camera = Camera(np.array([3.0, 4.0]), up, 8.0, (330.0, 356.0), (660.0, 540.0))
    point = np.linalg.solve(camera.matrix, np.array([u, v]) - camera.anchor_px) + camera.centre_m
    assert camera.sees(point[None], np.array([1e-6])).all()


def test_a_shape_with_a_corner_on_the_map_is_shown():
    camera = Camera(np.array([0.0, 0.0]), -np.pi / 2, 10.0, (100.0, 100.0), (200.0, 200.0))  # 10 m to each edge
    boxes = oriented_box([[0.0, 0.0], [11.5, 0.0], [12.5, 0.0], [0.0, -12.5], [11.5, 11.5]], 0.0, 2.0, 1.0)
    assert camera.shows(boxes).tolist() == [True, True, False, False, False]
    assert camera.shows(np.zeros((0, 4, 2))).shape == (0,)


def test_north_up_is_the_plane_as_it_is():
    camera = camera_of(frame(0.7), RenderingConfig(orientation="north_up"))
    here = camera.px([20.0, 0.0])
    np.testing.assert_allclose(camera.px([21.0, 0.0]) - here, [8, 0], atol=1e-9)
    np.testing.assert_allclose(camera.px([20.0, 1.0]) - here, [0, 8], atol=1e-9)


def test_boxes_have_their_lengths_along_their_headings():
    box = oriented_box([[1.0, 2.0], [0.0, 0.0]], [0.0, np.pi / 2], [2.5, 2.5], 1.0)
    np.testing.assert_allclose(box[0], [[3.5, 1.0], [3.5, 3.0], [-1.5, 3.0], [-1.5, 1.0]])
    np.testing.assert_allclose(box[1], [[1.0, 2.5], [-1.0, 2.5], [-1.0, -2.5], [1.0, -2.5]], atol=1e-12)


def test_asphalt_covers_the_lanes():
    drawing = RoadDrawing.of(bend())
    true = (50.0 + RADIUS_M * np.pi / 2) * WIDTH_M
    assert area(drawing.asphalt.corners_m).sum() == pytest.approx(true, rel=0.02)
    assert area(drawing.kerb.corners_m).sum() > area(drawing.asphalt.corners_m).sum()


def test_dashes_and_lines_lie_on_the_edges():
    corners = RoadDrawing.of(bend()).marking.corners_m
    straight = corners[corners[:, :, 0].max(1) <= 50.0]
    left = straight[np.abs(straight[:, :, 1].mean(1) + WIDTH_M / 2) < 0.01]
    right = straight[np.abs(straight[:, :, 1].mean(1) - WIDTH_M / 2) < 0.01]
    assert area(left).sum() == pytest.approx(50.0 * 0.15)
    assert area(right).sum() == pytest.approx(0.15 * (6 * 3.0 + 3.0))  # a dash begins at 0, 7.5, ... 45 m


@pytest.mark.parametrize("name", ["highway", "merge", "roundabout", "intersection", "racetrack"])
def test_every_network_of_highway_env_can_be_traced(name):
    newest = max(key for key in gymnasium.registry if key.startswith(f"{name}-v"))
    env = gymnasium.make(newest)
    env.reset(seed=0)
    drawing = RoadDrawing.of(env.unwrapped.road.network)
    assert np.isfinite(drawing.asphalt.corners_m).all()
    assert len(drawing.marking.corners_m) > 0


def test_the_corridor_keeps_its_distance_round_the_bend():
    lines = corridor(bend(), ("a", "b", 0), (), 30.0, 90.0, np.array([-1.0, 0.5]))
    for line, radius in zip(lines, (RADIUS_M + 1.0, RADIUS_M - 0.5), strict=True):
        assert line[0, 0] == pytest.approx(30.0)
        turned = line[line[:, 0] > 50.0 + 1e-9]
        np.testing.assert_allclose(np.hypot(turned[:, 0] - 50.0, turned[:, 1] - RADIUS_M), radius)
        assert np.hypot(*np.diff(line, axis=0).T).sum() == pytest.approx(20.0 + 40.0 * radius / RADIUS_M, rel=1e-3)


def test_the_corridor_needs_a_route_at_a_fork():
    network = bend()
    network.add_lane("b", "d", StraightLane([50, 0], [100, 0], width=WIDTH_M))
    alone = corridor(network, ("a", "b", 0), (), 40.0, 80.0, np.zeros(1))[0]
    routed = corridor(network, ("a", "b", 0), [("a", "b", 0), ("b", "d", 0)], 40.0, 80.0, np.zeros(1))[0]
    assert alone[:, 0].max() == pytest.approx(50.0)
    assert routed[:, 0].max() == pytest.approx(80.0)


def test_the_corridor_of_a_loop_ends():
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0, 0], [10, 0]))
    network.add_lane("b", "a", StraightLane([10, 0], [0, 0]))
    assert corridor(network, ("a", "b", 0), (), 0.0, 500.0, np.zeros(1)).shape == (1, 4, 2)
    assert corridor(network, ("a", "b", 0), (), 20.0, 10.0, np.zeros(1)).shape == (1, 0, 2)


def test_a_building_is_seen_as_its_footprint_on_the_right_side():
    city = City.of(prisms(SQUARE[None] + [100.0, 30.0], 0.0, 25.0))
    scenery = Scenery.of(city)
    assert area(scenery.roof_m).sum() == pytest.approx(100.0)
    np.testing.assert_allclose(scenery.roof_m.reshape(-1, 2).mean(0), [100.0, -30.0], atol=2.0)
    assert np.hypot(*(scenery.edge_m[:, 1] - scenery.edge_m[:, 0]).T).sum() == pytest.approx(40.0)
    assert (scenery.height_m == 25.0).all()
    assert not scenery.overhead.any()


def test_slabs_are_overhead_and_leaves_are_trees():
    slab = City.of(prisms(SQUARE[None], 6.0, 7.5, floor=True))
    crown = City.of(prisms(SQUARE[None] + 40.0, 4.5, 9.0), Surface.FOLIAGE)
    wood = City.of(prisms(4.0 * SQUARE[None] + 90.0, 4.5, 9.0), Surface.FOLIAGE)
    scenery = Scenery.of(slab + crown + wood)
    assert area(scenery.roof_m[scenery.overhead]).sum() == pytest.approx(100.0)
    np.testing.assert_allclose(scenery.crown_m, [[40.0, -40.0]])
    np.testing.assert_allclose(scenery.crown_radius_m, np.sqrt(100.0 / np.pi))
    assert area(scenery.roof_m[scenery.leaves]).sum() == pytest.approx(1600.0)


def test_an_empty_city_is_empty_ground():
    scenery = Scenery.of(City.empty())
    assert scenery.roof_m.shape == (0, 3, 2)
    assert scenery.edge_m.shape == (0, 2, 2)
    assert scenery.crown_m.shape == (0, 2)


def test_the_tape_forgets_what_is_old():
    tape = Tape(window_s=3.0)
    assert len(tape.trace) == len(Trace.empty()) == 0
    for k in range(60):
        tape.add(0.1 * k, err_at_m=k, pl_at_m=1, al_at_m=2, err_ct_m=3, pl_ct_m=np.inf, al_ct_m=5, alert=k > 50)
    trace = tape.trace
    assert trace.time_s[0] == pytest.approx(2.9)
    assert trace.err_at_m[-1] == 59
    assert np.isinf(trace.pl_ct_m).all()
    assert trace.alert.sum() == 9
    tape.clear()
    assert len(tape.trace) == 0


def test_errors_are_belief_less_truth_along_the_true_track():
    shifted = frame(np.pi / 2, position_m=np.array([19.8, 0.3]))
    np.testing.assert_allclose(shifted.error_m, (0.3, 0.2))
    assert not shifted.exceeds_level
    assert frame(np.pi / 2, position_m=np.array([19.6, 0.3])).exceeds_level
    assert not frame(np.pi / 2, position_m=np.array([19.6, 0.3]), available=False).exceeds_level


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, Status.NORMAL),
        ({"pl_ct_m": 0.5}, Status.CAUTION),
        ({"pl_at_m": 0.8}, Status.CAUTION),
        ({"alert": True}, Status.ALERT),
        ({"available": False, "pl_at_m": np.inf}, Status.ALERT),
    ],
)
def test_the_light(changes, status):
    assert frame(**changes).status is status


def test_bodies_are_copied_and_checked():
    class Car:
        position, heading, LENGTH, WIDTH, crashed = np.array([1.0, 2.0]), 0.5, 5.0, 2.0, True

    car = Car()
    bodies = Bodies.of([car, car])
    car.position[0] = 9.0
    assert bodies.position_m[0, 0] == 1.0
    assert len(bodies) == 2
    assert len(Bodies.of([])) == 0
    with pytest.raises(InputError, match="one row each"):
        replace(bodies, length_m=np.ones(3))
    with pytest.raises(InputError, match="row of the 1 bodies, got 1"):
        replace(frame(), ego=1)


def test_sizes_and_names_are_checked():
    with pytest.raises(ConfigError, match="width_px"):
        RenderingConfig(width_px=10)
    with pytest.raises(ConfigError, match="orientation"):
        RenderingConfig(orientation="sideways")
    assert RenderingConfig(width_px=500).panel_width_px == 0
    assert RenderingConfig().map_width_px + RenderingConfig().panel_width_px == 960
