"""Presets that pair the errors of an IMU with what the navigator declares of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.envs.config import EnvConfig
from lanebound.integrity.core.config import load_preset
from lanebound.integrity.core.presets import parse_assignments
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.correlation import overbounding_walk
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.imu import ImuConfig
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

Array = NDArray[np.float64]
DT_S, MPS, GRADES = 0.1, 12.0, ("consumer", "automotive", "tactical")
OPEN_S, TUNNEL_S, VEHICLES = 60.0, 60.0, 300
SHOWN_M = {"consumer": [7.9, 20.5], "automotive": [7.3, 18.3], "tactical": [4.1, 9.0]}
"""Median levels after 30 and 60 s in the tunnel, as docs/navigation.md shows them."""


def _drive(config: NavigatorConfig, turn_radps: float = 0.0, turned_rad: float = np.pi) -> tuple[Array, Array]:
    """Across-track error and level of vehicles in a tunnel, (T, B) of each epoch; 5 s inside the road may turn."""
    cell_m, length_m = 10.0, MPS * (OPEN_S + TUNNEL_S) + 100.0
    path = np.zeros((int(length_m / cell_m) + 1, 1, 1), dtype=np.uint8)
    path[int(MPS * OPEN_S / cell_m) :] = SignalPath.BLOCKED
    mask = SkyMask(path, np.zeros(path.shape, dtype=np.float32), 1, 1, cell_m, length_m, False)
    track = SkyTrack.from_config(config.sky, OPEN_S + TUNNEL_S + 1.0)
    navigator = Navigator(config, track, mask, list(range(VEHICLES)))
    ends = _poses(turn_radps, turned_rad)
    error, level = [], []
    for epoch, (before, after) in enumerate(pairwise(ends)):
        time_s, arc = (epoch + 1) * DT_S, np.full(VEHICLES, (epoch + 1) * MPS * DT_S)
        poses, velocities, headings = zip(before, after, strict=True)
        solution = navigator.step(truth_between(time_s, DT_S, poses, velocities, headings, arc_m=arc))
        if time_s > OPEN_S:
            east, north = (solution.position_en_m - after[0]).T
            sine, cosine = np.sin(solution.heading_rad), np.cos(solution.heading_rad)
            error.append(np.abs(east * cosine - north * sine))
            level.append(solution.pl_ct_m)
    assert (solution.mode == Mode.IMU_ODOMETER).all()
    return np.array(error), np.array(level)


def _poses(turn_radps: float, turned_rad: float) -> list[tuple[Array, Array, Array]]:
    """Position, velocity (B, 2) and heading (B,) at the ends of all epochs, by exact arcs."""
    position, heading, ends = np.zeros(2), 0.0, []
    for n in range(round((OPEN_S + TUNNEL_S) / DT_S) + 1):
        velocity = MPS * np.array([np.sin(heading), np.cos(heading)])
        ends.append((np.tile(position, (VEHICLES, 1)), np.tile(velocity, (VEHICLES, 1)), np.full(VEHICLES, heading)))
        turns = n * DT_S >= OPEN_S + 5.0 and abs(heading) < turned_rad
        turn = turn_radps * DT_S if turns else 0.0
        chord = MPS * DT_S * np.sinc(turn / (2.0 * np.pi))
        position = position + chord * np.array([np.sin(heading + 0.5 * turn), np.cos(heading + 0.5 * turn)])
        heading += turn
    return ends


def test_consumer_is_the_default() -> None:
    assert NavigatorConfig.preset("navigators/consumer") == NavigatorConfig()


@pytest.mark.parametrize("grade", GRADES)
def test_a_preset_pairs_the_sensor_with_what_is_declared_of_it(grade: str) -> None:
    config = NavigatorConfig.preset(f"navigators/{grade}")
    gyro, accel, heading = config.imu.gyro, config.imu.accel, config.positioning.heading
    reckoning = config.positioning.dead_reckoning
    assert config.imu == ImuConfig.preset(f"sensors/imu_{grade}")
    assert gyro.density <= heading.angle_random_walk_rad <= 1.1 * gyro.density
    assert heading.bias_initial_radps >= 1.2 * np.hypot(gyro.turn_on, np.sqrt(2.0) * gyro.instability)
    assert heading.bias_walk_radps >= overbounding_walk(gyro.instability, gyro.instability_s, gyro.random_walk)
    assert heading.gyro_scale >= 1.2 * gyro.scale
    assert np.deg2rad(reckoning.heading_drift_degps) >= 2.3 * gyro.instability
    assert reckoning.odometer_scale >= 4.4 * config.odometer.scale_sigma
    assert reckoning.watch.accelerometer_bias_mps2 >= 5.0 * accel.turn_on


def test_a_better_imu_lowers_the_levels_in_a_tunnel_and_they_hold() -> None:
    for grade, shown_m in SHOWN_M.items():
        error, level = _drive(NavigatorConfig.preset(f"navigators/{grade}"))
        assert (error > level).mean() <= NavigatorConfig().risk.integrity_risk, grade
        half = len(level) // 2 - 1
        assert [float(np.median(level[n])) for n in (half, -1)] == pytest.approx(shown_m, abs=0.051), grade


@pytest.mark.parametrize("grade", ["consumer", "automotive"])
@pytest.mark.parametrize(
    "turned_rad",
    [pytest.param(np.pi, id="u_turn", marks=pytest.mark.slow), pytest.param(4.0 * np.pi, id="two_circles")],
)
def test_levels_hold_after_turns_in_a_tunnel(grade: str, turned_rad: float) -> None:
    error, level = _drive(NavigatorConfig.preset(f"navigators/{grade}"), turn_radps=0.5, turned_rad=turned_rad)
    assert (error > level).mean() <= NavigatorConfig().risk.integrity_risk


def test_environments_take_a_preset_by_its_name() -> None:
    config = EnvConfig.build({"base": "LaneKeeping"}, {"navigator": "navigators/tactical"})
    assert config.navigator["imu"]["grade"] == "tactical"
    assert (
        config.to_dict()
        == EnvConfig.build({"base": "LaneKeeping"}, parse_assignments(["navigator=navigators/tactical"])).to_dict()
    )
    assert NavigatorConfig().replace(**config.navigator) == NavigatorConfig.preset("navigators/tactical")


def test_keys_apply_over_a_preset_that_is_named_in_other_data() -> None:
    given = {"base": "LaneKeeping", "navigator": "navigators/tactical"}
    made = EnvConfig.build(given, {"navigator": {"imu": {"gyro": {"scale": 0.004}}}})
    tactical = NavigatorConfig.preset("navigators/tactical")
    assert NavigatorConfig.load(made.navigator) == tactical.replace(imu={"gyro": {"scale": 0.004}}) != tactical


def test_a_part_of_a_preset_extends_another_one() -> None:
    data = load_preset("navigators/tactical")
    assert data["kind"] == "navigator"
    assert data["imu"] == {key: value for key, value in load_preset("sensors/imu_tactical").items() if key != "kind"}


def test_the_preset_of_reflections_adds_hypotheses_and_nothing_else() -> None:
    doubtful = NavigatorConfig().replace(positioning={"rtk": {"reflections": {"sets": 60}}})
    assert NavigatorConfig.preset("navigators/reflections") == doubtful != NavigatorConfig()


def test_the_preset_of_carriers_changes_the_velocity_and_watches_drifts() -> None:
    by_carriers = NavigatorConfig().replace(
        positioning={"doppler": {"carriers": True}, "rtk": {"drift": {"window_s": 16.0}}}
    )
    assert NavigatorConfig.preset("navigators/carriers") == by_carriers != NavigatorConfig()
