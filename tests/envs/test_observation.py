"""Observations: every entry against its meaning, inside the space whatever comes in, and the same in a turned world."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from math import cos, inf, isnan, nan, pi, sin

import numpy as np
import pytest
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st

from beliefs import believe
from frames import Viewer
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.observation import ObservationConfig, entries
from lanebound.envs.records import EgoBelief, Traffic
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode, RtkStatus

WIDTH_M = 3.25
SKY = np.array([[5, 10, 20]] * 5)


def turned(xy: tuple[float, float], angle: float) -> list[float]:
    return [xy[0] * cos(angle) - xy[1] * sin(angle), xy[0] * sin(angle) + xy[1] * cos(angle)]


def road(angle: float = 0.0) -> RoadNetwork:
    """Three lanes straight for 60 m, then a right turn of radius 30 m, all turned by an angle about the origin."""
    network = RoadNetwork()
    for lane in range(3):
        y = lane * WIDTH_M
        ends = turned((0.0, y), angle), turned((60.0, y), angle)
        network.add_lane("a", "b", StraightLane(*ends, width=WIDTH_M, speed_limit=14.0))
        arc = CircularLane(turned((60.0, 40.0), angle), 40.0 - y, angle - pi / 2, angle, width=WIDTH_M)
        network.add_lane("b", "c", arc)
    return network


def belief(angle: float = 0.0, **changes: object) -> EgoBelief:
    """At 20 m on the middle lane, half a metre to its right, in RTK."""
    plain = believe(
        time_s=1.0,
        position_m=np.array(turned((20.0, WIDTH_M + 0.5), angle)),
        heading_rad=angle + 0.1,
        speed_mps=10.0,
        yaw_rate_radps=0.2,
        acceleration_mps2=-2.0,
        steering_rad=pi / 12,
        lane_index=("a", "b", 1),
        longitudinal_m=20.0,
        lateral_m=0.5,
        angle_rad=0.1,
        lane_width_m=WIDTH_M,
        target_speed_mps=12.0,
        pl_at_m=0.8,
        pl_ct_m=0.5,
        al_at_m=1.0,
        al_ct_m=0.625,
        hdop=1.2,
        satellites=16,
        excluded=1,
        since_calibration_s=6.0,
        corrections_age_s=0.3,
    )
    return replace(plain, **changes)


def others(angle: float = 0.0, **changes: object) -> Traffic:
    """One ahead in the ego's lane; one crossing from the right on the left lane; one on the curve, seen by sensor."""
    places = [(32.0, WIDTH_M), (14.0, 0.0), (60.0 + 36.75 * sin(0.5), 40.0 - 36.75 * cos(0.5))]
    plain = Traffic(
        key=np.arange(3),
        position_m=np.array([turned(place, angle) for place in places]),
        heading_rad=angle + np.array([0.1, 0.1 - pi / 2, 0.5]),
        speed_mps=np.array([8.0, 4.0, 10.0]),
        pl_at_m=np.array([1.2, 1.0, 0.6]),
        pl_ct_m=np.array([0.6, 0.25, 0.2]),
        age_s=np.array([0.1, 0.2, 0.5]),
        length_m=np.array([5.0, 5.0, 10.0]),
        width_m=np.array([2.0, 2.0, 2.5]),
        relative=np.array([False, False, True]),
    )
    return replace(plain, **changes)


def named(config: ObservationConfig, flat: np.ndarray) -> dict[str, float]:
    """Quantities in their units by name of the column; the newest of a history."""
    index = entries(config)
    return {e.column: float(v) * e.scale for e, v in zip(index, flat[-len(index) :], strict=True)}


def look(
    ego: EgoBelief | None = None,
    traffic: Traffic | None = None,
    sky: np.ndarray | None = SKY,
    network: RoadNetwork | None = None,
    **changes: object,
) -> dict[str, float]:
    """What one observation shows, in units."""
    viewer = Viewer(**{"form": "flat", **changes})
    network = road() if network is None else network
    flat = viewer.observe(ego or belief(), Traffic.none() if traffic is None else traffic, sky, network)
    assert viewer.observer.space.contains(flat)
    return named(viewer.observer.config, flat)


def shown(seen: dict[str, float], prefix: str) -> dict[str, float]:
    return {name.removeprefix(prefix): value for name, value in seen.items() if name.startswith(prefix)}


def test_ego_shows_the_estimate():
    ego = shown(look(), "ego.")
    assert ego == pytest.approx(
        {
            "speed": 10.0,
            "target_speed": 12.0,
            "acceleration": -2.0,
            "yaw_rate": 0.2,
            "steering": pi / 12,
            "heading_sin": sin(0.1),
            "heading_cos": cos(0.1),
            "lateral_offset": 0.5,
            "lateral_share": 0.5 / (WIDTH_M / 2),
            "lane_width": WIDTH_M,
            "lane_share": 0.5,
            "left_exists": 1.0,
            "right_exists": 1.0,
            "target_left": 0.0,
            "target_right": 0.0,
        },
        rel=1e-6,
    )


@pytest.mark.parametrize(
    ("target", "left", "right"),
    [(("a", "b", 0), 1, 0), (("a", "b", 2), 0, 1), (("b", "c", 1), 0, 0), (("b", "c", 2), 0, 1)],
)
def test_a_commanded_lane_change_is_shown_across_a_joint_too(target, left, right):
    seen = look(belief(target_lane_index=target))
    assert (seen["ego.target_left"], seen["ego.target_right"]) == (left, right)


def test_integrity_shows_levels_limits_and_margins():
    seen = shown(look(), "integrity.")
    expected = {"pl_at": 0.8, "pl_ct": 0.5, "al_at": 1.0, "al_ct": 0.625, "ratio_at": 0.8, "ratio_ct": 0.8}
    expected |= {"margin_at": 0.2, "margin_ct": 0.125, "trend_at": 0.0, "pl_at_exists": 1.0, "pl_ct_exists": 1.0}
    expected |= {"available": 1.0, "alert": 0.0, "alert_age": 0.0, "since_rtk": 0.0, "since_calibration": 6.0}
    expected |= {"corrections_age": 0.3, "satellites": 16, "satellites_doppler": 12, "excluded": 1, "hdop": 1.2}
    assert {name: seen[name] for name in expected} == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("prefix", "field", "codes"),
    [
        ("reason_", "reason", {r.name.lower(): r.code for r in AlertReason if r.name != "CONTEXT_WARNING"}),
        ("mode_", "mode", {m.key: int(m) for m in Mode if m <= Mode.CODE}),  # services have entries where named
        ("rtk_", "rtk", {r.name.lower(): r.code for r in RtkStatus}),
    ],
)
def test_codes_are_one_hot(prefix, field, codes):
    for name, code in codes.items():
        hot = shown(look(belief(**{field: code})), f"integrity.{prefix}")
        assert {key for key, value in hot.items() if value} == {name}
        assert set(hot) == set(codes)


def test_a_missing_level_reads_as_the_maximum_and_not_as_zero():
    lost = belief(pl_at_m=inf, pl_ct_m=inf, available=False, alert=True, alert_age_s=3.0, hdop=inf, since_rtk_s=inf)
    seen = look(lost, others())
    for axis in ("at", "ct"):
        assert seen[f"integrity.pl_{axis}"] == 10.0
        assert seen[f"integrity.pl_{axis}_exists"] == 0.0
        assert seen[f"integrity.margin_{axis}"] == -10.0
        assert seen[f"integrity.ratio_{axis}"] == 3.0
        assert seen[f"traffic.v0_pl_{axis}"] == 20.0
    assert seen["traffic.v0_pl_exists"] == 0.0
    assert seen["traffic.v2_pl_exists"] == 1.0
    ages = seen["integrity.hdop"], seen["integrity.since_rtk"], seen["integrity.alert_age"]
    assert ages == pytest.approx((10.0, 60.0, 3.0))


def test_a_level_beyond_the_scale_exists():
    seen = look(belief(pl_at_m=40.0))
    assert (seen["integrity.pl_at"], seen["integrity.pl_at_exists"]) == (10.0, 1.0)


@pytest.mark.parametrize("al_ct_m", [0.0, -0.2, inf])
def test_odd_limits_stay_numbers(al_ct_m):
    seen = look(belief(al_ct_m=al_ct_m))
    assert seen["integrity.ratio_ct"] == (0.0 if al_ct_m == inf else 3.0)
    assert seen["integrity.margin_ct"] == pytest.approx(min(al_ct_m - 0.5, 10.0), rel=1e-6)


def test_trends_are_the_change_over_the_window():
    viewer, network, seen = Viewer(form="flat"), road(), {}
    for k in range(31):
        level = 0.5 + 0.05 * k if k < 30 else inf
        ego = belief(time_s=0.1 * k, pl_at_m=level, pl_ct_m=2.0)
        seen[k] = named(viewer.observer.config, viewer.observe(ego, Traffic.none(), None, network))
    assert [seen[k]["integrity.trend_at"] for k in (0, 4, 10, 29)] == pytest.approx([0.0, 0.2, 0.5, 0.5], abs=1e-6)
    assert seen[30]["integrity.trend_at"] == pytest.approx(10.0 - 1.5)
    assert {seen[k]["integrity.trend_ct"] for k in seen} == {0.0}
    viewer.reset()
    later = named(viewer.observer.config, viewer.observe(belief(time_s=9.0), Traffic.none(), None, network))
    assert later["integrity.trend_at"] == 0.0


def test_road_shows_the_map_ahead_of_the_believed_pose():
    seen = look(range_m=60.0)
    assert (seen["road.speed_limit"], seen["road.junction"]) == pytest.approx((14.0, 40.0))
    assert seen["road.lane_end"] == 60.0
    near = shown(seen, "road.preview_10m_")
    ahead, right = 10.0 * cos(0.1) - 0.5 * sin(0.1), -10.0 * sin(0.1) - 0.5 * cos(0.1)
    expected = {"exists": 1.0, "ahead": ahead, "right": right, "heading": -0.1, "curvature": 0.0}
    assert near == pytest.approx(expected, abs=1e-6)
    far = shown(seen, "road.preview_80m_")
    radius = 40.0 - WIDTH_M
    turn = 40.0 / radius
    x, y = 40.0 + radius * sin(turn), radius * (1.0 - cos(turn)) - 0.5
    assert far["ahead"] == pytest.approx(x * cos(0.1) + y * sin(0.1), abs=1e-4)
    assert far["right"] == pytest.approx(y * cos(0.1) - x * sin(0.1), abs=1e-4)
    assert (far["heading"], far["curvature"]) == pytest.approx((turn - 0.1, 1.0 / radius), abs=1e-6)


def test_beyond_the_map_the_preview_says_so():
    seen = look(belief(longitudinal_m=50.0, position_m=np.array([50.0, WIDTH_M + 0.5])), preview_m=(10.0, 80.0))
    assert (seen["road.preview_10m_exists"], seen["road.preview_80m_exists"]) == (1.0, 0.0)
    assert seen["road.preview_80m_curvature"] == 0.0
    assert seen["road.lane_end"] == pytest.approx(10.0 + (40.0 - WIDTH_M) * pi / 2, rel=1e-6)


def test_the_route_is_followed():
    network = road()
    network.add_lane("b", "d", StraightLane([60.0, WIDTH_M], [160.0, WIDTH_M]))
    viewer = Viewer(form="flat")
    for to, curvature in (("c", 1.0 / (40.0 - WIDTH_M)), ("d", 0.0)):
        flat = viewer.observe(belief(), Traffic.none(), SKY, network, [("a", "b", 1), ("b", to, None)])
        assert named(viewer.observer.config, flat)["road.preview_80m_curvature"] == pytest.approx(curvature)


def test_the_predicted_sky_is_shown_lane_by_lane():
    assert [look()[f"road.sky_0m_{lane}"] for lane in ("left", "own", "right")] == [5.0, 10.0, 20.0]
    assert set(shown(look(sky=None), "road.sky_").values()) == {-40.0}
    leftmost = belief(lane_index=("a", "b", 0))
    assert [look(leftmost)[f"road.sky_20m_{lane}"] for lane in ("left", "own", "right")] == [-40.0, 10.0, 20.0]
    unknown = SKY.copy()
    unknown[1, 1] = -1
    assert look(sky=unknown)["road.sky_20m_own"] == -40.0
    assert look(sky=np.zeros((5, 3)))["road.sky_20m_own"] == 0.0


def test_traffic_is_relative_to_the_estimate():
    seen = look(traffic=others())
    lead = shown(seen, "traffic.v0_")
    expected = {"present": 1.0, "length": 5.0, "width": 2.0, "age": 0.1, "sensor": 0.0, "own_lane": 1.0}
    expected |= {"ahead": 12.0 * cos(0.1) - 0.5 * sin(0.1), "right": -12.0 * sin(0.1) - 0.5 * cos(0.1)}
    expected |= {"velocity_ahead": -2.0, "velocity_right": 0.0, "heading_sin": 0.0, "heading_cos": 1.0}
    expected |= {"lane_gap": 12.0, "lane_offset": 0.0, "left_lane": 0.0, "right_lane": 0.0}
    assert {name: lead[name] for name in expected} == pytest.approx(expected, abs=1e-5)
    crossing = shown(seen, "traffic.v1_")
    assert (crossing["left_lane"], crossing["own_lane"], crossing["right_lane"]) == (1.0, 0.0, 0.0)
    assert (crossing["lane_gap"], crossing["lane_offset"]) == pytest.approx((-6.0, -WIDTH_M), abs=1e-5)
    assert (crossing["velocity_ahead"], crossing["velocity_right"]) == pytest.approx((-10.0, -4.0), abs=1e-5)
    curve = shown(seen, "traffic.v2_")
    assert (curve["lane_gap"], curve["lane_offset"]) == pytest.approx((40.0 + 0.5 * 36.75, 0.0), abs=0.01)
    assert curve["sensor"] == 1.0


def test_combined_levels_lie_on_the_axes_of_the_ego():
    seen = look(traffic=others())
    levels = [(seen[f"traffic.v{k}_pl_at"], seen[f"traffic.v{k}_pl_ct"]) for k in range(3)]
    assert levels[0] == pytest.approx((0.8 + 1.2, 0.5 + 0.6))
    assert levels[1] == pytest.approx((0.8 + 0.25, 0.5 + 1.0))
    c, s = cos(0.4), sin(0.4)
    assert levels[2] == pytest.approx((0.6 * c + 0.2 * s, 0.6 * s + 0.2 * c), rel=1e-6)


def test_a_vehicle_without_a_level_reads_as_the_maximum():
    seen = look(traffic=others(pl_ct_m=np.array([inf, 0.1, 0.1])))
    assert [seen[f"traffic.v0_{name}"] for name in ("pl_exists", "pl_at", "pl_ct")] == [0.0, 20.0, 20.0]
    assert seen["traffic.v1_pl_exists"] == 1.0


def test_rows_without_a_vehicle_read_as_far_old_and_unbounded():
    absent = {"ahead": 150.0, "lane_gap": 150.0, "age": 5.0, "pl_at": 20.0, "pl_ct": 20.0}
    row = shown(look(traffic=others()), "traffic.v3_")
    assert {name: value for name, value in row.items() if value} == absent


def test_only_the_nearest_rows_are_shown():
    seen = look(traffic=others(), vehicles=2)
    assert seen["traffic.v1_present"] == 1.0
    assert not shown(seen, "traffic.v2_")
    assert not shown(look(traffic=others(), vehicles=0), "traffic.")


def test_blind_equals_full_without_what_is_hidden():
    full, blind = (look(traffic=others(), integrity=kind) for kind in ("full", "blind"))
    assert blind == {name: full[name] for name in blind}
    doubt = look(belief(pl_at_m=9.0, reason=5, mode=3, alert=True), others(), integrity="blind")
    assert doubt == blind


def test_oracle_trusts_its_state():
    lost = belief(pl_at_m=inf, pl_ct_m=7.0, available=False, alert=True, alert_age_s=4.0, reason=3)
    seen = look(lost, others(), integrity="oracle")
    zero = ("pl_at", "pl_ct", "ratio_at", "trend_at", "alert", "alert_age", "reason_both")
    assert {seen[f"integrity.{name}"] for name in zero} == {0.0}
    assert seen["integrity.margin_at"] == pytest.approx(1.0)
    assert {seen[f"integrity.{name}"] for name in ("available", "pl_at_exists", "reason_none")} == {1.0}
    assert [seen[f"traffic.v0_{name}"] for name in ("pl_exists", "pl_at", "pl_ct")] == [1.0, 0.0, 0.0]


def test_both_forms_hold_the_same_numbers():
    flat, parts = (Viewer(form=form) for form in ("flat", "dict"))
    network = road()
    vector, mapping = (o.observe(belief(), others(), SKY, network) for o in (flat, parts))
    assert isinstance(mapping, dict)
    assert parts.observer.space.contains(mapping)
    assert list(mapping) == ["ego", "integrity", "road", "traffic"]
    assert np.concatenate(list(mapping.values())).tolist() == vector.tolist()


@pytest.mark.parametrize("form", ["flat", "dict"])
def test_history_is_filled_by_the_first_and_then_moves_on(form):
    viewer, network = Viewer(form=form, history=3), road()

    def speeds(speed_mps: float) -> list[float]:
        out = viewer.observe(belief(speed_mps=speed_mps), Traffic.none(), None, network)
        assert viewer.observer.space.contains(out)
        group = out if form == "flat" else out["ego"]
        return [float(frame[0]) * 40.0 for frame in np.split(group, 3)]

    assert speeds(4.0) == pytest.approx([4.0, 4.0, 4.0])
    assert speeds(8.0) == pytest.approx([4.0, 4.0, 8.0])
    assert speeds(12.0) == pytest.approx([4.0, 8.0, 12.0])
    viewer.reset()
    assert speeds(20.0) == pytest.approx([20.0, 20.0, 20.0])


def test_an_observation_is_not_touched_by_the_next():
    for history in (1, 2):
        viewer, network = Viewer(form="flat", history=history), road()
        first = viewer.observe(belief(), others(), SKY, network)
        before = first.copy()
        viewer.observe(belief(speed_mps=3.0), Traffic.none(), None, network)
        assert first.tolist() == before.tolist()


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda o: pickle.loads(pickle.dumps(o))])
def test_copies_go_on_alike(clone):
    viewer, network = Viewer(history=2), road()
    viewer.observe(belief(), others(), SKY, network)
    twin = clone(viewer)
    ego = belief(time_s=1.5, pl_at_m=2.0)
    ours, theirs = viewer.observe(ego, others(), SKY, network), twin.observe(ego, others(), SKY, twin._network)
    assert {g: v.tolist() for g, v in ours.items()} == {g: v.tolist() for g, v in theirs.items()}


@settings(max_examples=25, deadline=None)
@given(st.floats(-7.0, 7.0))
def test_nothing_changes_when_the_world_is_turned(angle):
    preview = (5.0, 10.0, 30.0, 60.0, 80.0)  # none at the joint 40 m ahead, where the curvature jumps
    plain = look(traffic=others(), preview_m=preview)
    rotated = look(belief(angle), others(angle), network=road(angle), preview_m=preview)
    assert rotated == pytest.approx(plain, abs=2e-5)


def test_nan_is_refused_by_name():
    assert isnan(Viewer(form="flat").frame(belief(yaw_rate_radps=nan), others(), SKY, road())[3])
    env = DrivingEnv(make_config("lanebound/LaneKeeping-v0", {"navigation": {"source": "perfect"}}))
    env.reset(seed=1)
    env.belief_loop.episodes.frame[0, 3] = nan
    with pytest.raises(InputError, match=r"ego\.yaw_rate must be a number, got nan"):
        env._observe()


WILD = st.floats(allow_nan=False, allow_infinity=False, width=32)
LEVEL = st.one_of(st.floats(0.0, 1e6), st.just(inf))


@settings(max_examples=60, deadline=None)
@given(st.lists(WILD, min_size=9, max_size=9), st.lists(LEVEL, min_size=6, max_size=6), st.integers(-9, 999))
def test_whatever_comes_in_stays_inside_the_space(wild, levels, count):
    ego = belief(
        speed_mps=wild[0],
        yaw_rate_radps=wild[1],
        acceleration_mps2=wild[2],
        steering_rad=wild[3],
        lateral_m=wild[4],
        longitudinal_m=wild[5],
        position_m=np.array(wild[6:8]),
        heading_rad=wild[8],
        pl_at_m=levels[0],
        pl_ct_m=levels[1],
        hdop=levels[2],
        since_rtk_s=levels[3],
        since_calibration_s=levels[4],
        corrections_age_s=levels[5],
        satellites=count,
    )
    cars = others(position_m=np.array(wild[:6]).reshape(3, 2), pl_at_m=np.array(levels[:3]), age_s=np.array(levels[3:]))
    for kind in ("full", "blind", "oracle"):
        assert look(ego, cars, SKY * count, integrity=kind)
