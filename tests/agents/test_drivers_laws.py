"""Laws of steering, following and lane changing: signs, steady states, and cars that stay on their road."""

from __future__ import annotations

import math
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from lanebound.agents.benchmark.scoring import outcome_of
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.lateral import EGO_LENGTH_M, LqrSteering, PursuitSteering, StanleySteering
from lanebound.agents.drivers.mobil import MobilConfig, changes, neighbours
from lanebound.agents.drivers.plans import FREE_M, CruiseConfig, idm_acceleration, in_lane, nearest_ahead
from lanebound.agents.episodes import EpisodeLog, drive, open_env
from lanebound.envs.observation import ObservationConfig

CALM, MOBIL = CruiseConfig(), MobilConfig()
GIVEN: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}
LAWS = (PursuitSteering, StanleySteering, LqrSteering)


@pytest.fixture(scope="module")
def env() -> Any:
    return open_env("LaneKeeping", GIVEN | {"observation": {"form": "flat"}})


@pytest.fixture
def flat() -> Reader:
    return Reader(ObservationConfig(form="flat"))


def observation(reader: Reader, **values: float) -> np.ndarray:
    """A flat observation of zeros but for quantities in their units, dots written as ``__``."""
    out = np.zeros(len(reader.columns), dtype=np.float32)
    for name, value in values.items():
        column = name.replace("__", ".")
        out[reader.columns.index(column)] = value / reader.scale(column)
    return out


def on_circle(reader: Reader, radius_m: float, offset_m: float, heading_rad: float, speed_mps: float) -> np.ndarray:
    """The ego at an offset to the right of a circle that turns right, heading as given against its tangent."""
    values = {"ego__speed": speed_mps, "ego__lateral_offset": offset_m}
    values |= {"ego__heading_sin": math.sin(heading_rad), "ego__heading_cos": math.cos(heading_rad)}
    for d in reader.previews_m:
        turn = d / radius_m
        x, y = radius_m * math.sin(turn), radius_m * (1.0 - math.cos(turn)) - offset_m
        c, s = math.cos(heading_rad), math.sin(heading_rad)
        key = f"road__preview_{d:g}m_"
        values |= {key + "ahead": x * c + y * s, key + "right": y * c - x * s, key + "heading": turn - heading_rad}
    return observation(reader, **values)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("speed_mps", [2.0, 8.0, 14.0])
def test_a_car_that_is_off_or_askew_is_steered_back(env, flat, law, speed_mps):
    steer = law(env, flat)
    assert steer(on_circle(flat, 1e9, 0.0, 0.0, speed_mps)) == pytest.approx(0.0, abs=1e-6)
    for offset, heading in ((0.5, 0.0), (0.0, 0.1), (0.5, 0.1)):
        right = steer(on_circle(flat, 1e9, offset, heading, speed_mps))
        left = steer(on_circle(flat, 1e9, -offset, -heading, speed_mps))
        assert right < -0.005
        assert left == pytest.approx(-float(right), abs=1e-6)


@pytest.mark.parametrize("law", [StanleySteering, LqrSteering])
@pytest.mark.parametrize("radius_m", [25.0, -40.0, 150.0])
def test_steady_on_a_bend_the_wheel_stays_as_the_bend_needs_it(env, flat, law, radius_m):
    """``sin(beta) = L / 2R``, ``tan(delta) = 2 tan(beta)``, heading -beta to the tangent."""
    beta = math.asin(0.5 * EGO_LENGTH_M / radius_m)
    seen = on_circle(flat, radius_m, 0.0, -beta, 8.0)
    assert law(env, flat)(seen) == pytest.approx(math.atan(2.0 * math.tan(beta)), abs=1e-5)


def test_the_regulated_car_returns_to_its_line_at_every_speed(env, flat):
    """Eigenvalues of the closed loop, held for one policy step, lie inside the unit circle."""
    steer = LqrSteering(env, flat)
    for v, gain in zip(range(1, 41), steer.gains, strict=True):
        way = v * env.dt_s
        a = np.array([[1.0, way], [0.0, 1.0]])
        b = np.array([[0.5 * way + 0.5 * way**2 / EGO_LENGTH_M], [way / EGO_LENGTH_M]])
        assert np.abs(np.linalg.eigvals(a - b @ gain[None])).max() < 0.99
        assert np.all(gain > 0.0)


def test_the_intelligent_driver_rests_at_its_gap_and_brakes_when_it_closes():
    v, gap = 10.0, CALM.standstill_m + 10.0 * CALM.time_gap_s
    held = gap / math.sqrt(1.0 - (v / 14.0) ** 4)  # where the acceleration is 0
    assert idm_acceleration(*map(np.array, (v, 14.0, held, v)), CALM) == pytest.approx(0.0, abs=1e-9)
    nearer = [float(idm_acceleration(*map(np.array, (v, 14.0, s, v)), CALM)) for s in (50.0, 30.0, 15.0, 8.0)]
    closing = [float(idm_acceleration(*map(np.array, (v, 14.0, 30.0, u)), CALM)) for u in (12.0, 10.0, 6.0, 0.0)]
    assert nearer == sorted(nearer, reverse=True)
    assert closing == sorted(closing, reverse=True)
    assert nearer[-1] < -2.0


def road(reader: Reader, *cars: tuple[str, float, float], **values: float) -> np.ndarray:
    """The ego at 10 m/s on a long road with lanes on both sides; cars by lane, signed gap and relative speed."""
    shown = {"ego__speed": 10.0, "ego__left_exists": 1.0, "ego__right_exists": 1.0, "ego__lane_width": 4.0}
    shown |= {"road__junction": 150.0, "road__lane_end": 150.0}
    for k, (lane, gap, faster) in enumerate(cars):
        row = {"present": 1.0, f"{lane}_lane": 1.0, "lane_gap": gap, "velocity_ahead": faster, "length": EGO_LENGTH_M}
        shown |= {f"traffic__v{k}_{name}": value for name, value in row.items()}
    return observation(reader, **(shown | values))


def side(reader: Reader, seen: np.ndarray, **more: Any) -> int:
    return int(changes(reader, seen, np.array(14.0), CALM, MOBIL, **more))


def test_neighbours_are_the_nearest_of_their_lane(flat):
    seen = road(flat, ("left", 30.0, -2.0), ("left", 20.0, 1.0), ("left", -15.0, 3.0), ("right", 9.0, 0.0))
    left, right = neighbours(flat, seen, -1), neighbours(flat, seen, 1, along_m=2.0)
    assert [float(x) for x in left] == pytest.approx([15.0, 11.0, 10.0, 13.0], rel=1e-5)
    assert [float(x) for x in right] == pytest.approx([2.0, 10.0, FREE_M, 10.0], rel=1e-5)


def test_a_vehicle_that_enters_a_lane_counts_there_before_it_is_on_it(flat):
    """From 4 m to the left, the middle of a lane of 4 m, 2.1 m/s reach its marking at 2 m within a second."""
    heading = {"ego__heading_cos": 1.0, "traffic__v0_lane_offset": -4.0}
    slow, fast, crossing = (
        road(flat, ("left", 20.0, -5.0), **heading, traffic__v0_velocity_right=across) for across in (1.9, 2.1, 6.0)
    )
    assert nearest_ahead(flat, slow, c=CALM)[0] == FREE_M
    assert nearest_ahead(flat, fast)[0] == FREE_M, "without a time only the middle counts"
    gap, speed = nearest_ahead(flat, fast, c=CALM)
    assert (float(gap), float(speed)) == (pytest.approx(15.0, rel=1e-5), pytest.approx(5.0, rel=1e-5))
    assert nearest_ahead(flat, crossing, c=CALM)[0] == FREE_M, "it crosses at 50 degrees"
    assert neighbours(flat, fast, 0, within_s=1.0).lead_gap_m == pytest.approx(15.0, rel=1e-5)
    askew = road(
        flat, ("left", 20.0, -5.0), traffic__v0_lane_offset=-4.0, traffic__v0_velocity_right=0.0,
        ego__heading_sin=0.6, ego__heading_cos=0.8,
    )  # fmt: skip
    # A car that is turned right by 37 degrees sees 5 m/s ahead as 3 m/s to the right of the lane and 4 m/s along it.
    assert not in_lane(flat, askew, 0, 1.0)[0], "0.75 of its speed along: no merging"
    turned = road(
        flat, ("left", 20.0, -5.0), traffic__v0_lane_offset=-4.0, ego__heading_sin=0.28, ego__heading_cos=0.96,
    )  # fmt: skip
    # Turned by 16 degrees: 1.4 m/s across reach the marking, 2 m away, after 1.43 s.
    assert [bool(in_lane(flat, turned, 0, s)[0]) for s in (1.4, 1.46)] == [False, True]


def test_before_a_follower_a_level_slows_by_one_target_speed_at_a_time():
    with closing(open_env("lanebound/Highway-v0", {"observation": {"form": "flat"}})) as env:
        driver, flat = make_agent("integrity_aware", env), Reader(env.config.observation)
        slower = {label: code for code, label in env.world.action_type.actions.items()}["SLOWER"]

        def act(gap: float, v: float) -> int:
            seen = road(
                flat, ("own", gap, 0.0), ego__speed=v, ego__target_speed=25.0, ego__heading_cos=1.0,
                road__speed_limit=30.0, integrity__alert=1.0, integrity__ratio_ct=2.0,
            )  # fmt: skip
            return int(driver.act(seen))

        assert act(-100.0, 27.0) == slower, "nobody is near behind"
        assert act(-30.0, 27.0) != slower, "the target speed before is not driven yet"
        assert act(-30.0, 25.1) == slower


def test_a_slow_leader_is_passed_on_the_free_side(flat):
    slow = ("own", 20.0, -5.0)
    assert side(flat, road(flat)) == 0
    assert side(flat, road(flat, slow, ("left", 15.0, -6.0))) == 1
    assert side(flat, road(flat, slow, ("right", 15.0, -6.0))) == -1
    assert side(flat, road(flat, slow, ego__left_exists=0.0, ego__right_exists=0.0)) == 0


def test_nobody_is_cut_off(flat):
    """A follower 12 m behind and 8 m/s faster would have to brake hard; both lanes being so, none is taken."""
    behind = (("left", -12.0, 8.0), ("right", -12.0, 8.0))
    assert side(flat, road(flat, ("own", 20.0, -5.0), *behind)) == 0
    far = (("left", -60.0, 1.0), ("right", -12.0, 8.0))
    assert side(flat, road(flat, ("own", 20.0, -5.0), *far)) == -1
    assert side(flat, road(flat, ("own", 20.0, -5.0), *far), along_m=50.0) == 0


@pytest.mark.parametrize(
    "values",
    [
        {"ego__target_left": 1.0},
        {"ego__speed": 1.0},
        {"road__junction": 20.0},
        {"road__preview_20m_curvature": -0.04},
    ],
)
def test_some_places_are_not_for_changing(flat, values):
    assert side(flat, road(flat, ("own", 15.0, -8.0))) != 0
    assert side(flat, road(flat, ("own", 15.0, -8.0), **values)) == 0


def test_a_lane_that_ends_is_left_and_a_bonus_counts(flat):
    assert side(flat, road(flat, road__lane_end=40.0, ego__right_exists=0.0)) == -1
    assert side(flat, road(flat), bonus_mps2=(0.0, 1.0)) == 1


@pytest.mark.parametrize("agent", ["stanley", "lqr", "nominal", "idm"])
@pytest.mark.parametrize("name", ["LaneKeeping", "CarFollowing"])
def test_who_knows_where_it_is_stays_in_its_lane(agent, name):
    env = open_env(name, GIVEN | {"world": {"duration": 20.0}})
    log = EpisodeLog()
    drive(env, make_agent(agent, env), [3], [log])
    rows = log.episode(0)
    summary = outcome_of(rows, 0.0)
    assert (summary.ended, summary.success) == ("time up", True)
    assert summary.costs["cost_lane"] == 0.0
    assert max(abs(row["est_lateral_m"]) for row in rows) < 0.25


def test_nominal_passes_on_the_motorway_without_harm():
    env = open_env("Highway", GIVEN | {"world": {"duration": 12.0, "vehicles_count": 15, "vehicles_density": 2.0}})
    log = EpisodeLog()
    drive(env, make_agent("nominal", env), [1], [log])
    assert {"LANE_LEFT", "LANE_RIGHT"} & {row["action_name"] for row in log.episode(0)}
    assert outcome_of(log.episode(0), 0.0).success
