"""Presets that pair the errors of an IMU with what the navigator declares of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.envs.config import EnvConfig
from lanebound.integrity.core.config import load_preset
from lanebound.integrity.core.presets import parse_assignments
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.imu import ImuConfig
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import Path, SkyMask

Array = NDArray[np.float64]
DT_S, MPS, GRADES = 0.1, 12.0, ("consumer", "automotive", "tactical")
OPEN_S, TUNNEL_S, VEHICLES = 60.0, 60.0, 300


def _drive(config: NavigatorConfig) -> tuple[Array, Array]:
    """Across-track error and level of vehicles in a straight tunnel, (T, B) of each epoch."""
    cell_m, length_m = 10.0, MPS * (OPEN_S + TUNNEL_S) + 100.0
    path = np.zeros((int(length_m / cell_m) + 1, 1, 1), dtype=np.uint8)
    path[int(MPS * OPEN_S / cell_m) :] = Path.BLOCKED
    mask = SkyMask(path, np.zeros(path.shape, dtype=np.float32), 1, 1, cell_m, length_m, False)
    track = SkyTrack.from_config(config.sky, OPEN_S + TUNNEL_S + 1.0)
    navigator = Navigator(config, track, mask, list(range(VEHICLES)))
    velocity, heading = np.tile([0.0, MPS], (VEHICLES, 1)), np.zeros(VEHICLES)
    error, level = [], []
    for epoch in range(round((OPEN_S + TUNNEL_S) / DT_S)):
        before, after = (np.tile([0.0, MPS * DT_S * n], (VEHICLES, 1)) for n in (epoch, epoch + 1))
        time_s, arc = (epoch + 1) * DT_S, after[:, 1].copy()
        solution = navigator.step(
            truth_between(time_s, DT_S, (before, after), (velocity, velocity), (heading, heading), arc_m=arc)
        )
        if time_s > OPEN_S:
            east, north = (solution.position_en_m - after).T
            sine, cosine = np.sin(solution.heading_rad), np.cos(solution.heading_rad)
            error.append(np.abs(east * cosine - north * sine))
            level.append(solution.pl_ct_m)
    assert (solution.mode == Mode.IMU_ODOMETER).all()
    return np.array(error), np.array(level)


def test_consumer_is_the_default() -> None:
    assert NavigatorConfig.preset("navigators/consumer") == NavigatorConfig()


@pytest.mark.parametrize("grade", GRADES)
def test_a_preset_pairs_the_sensor_with_what_is_declared_of_it(grade: str) -> None:
    config = NavigatorConfig.preset(f"navigators/{grade}")
    gyro, accel, heading = config.imu.gyro, config.imu.accel, config.positioning.heading
    reckoning = config.positioning.dead_reckoning
    assert config.imu == ImuConfig.preset(f"sensors/imu_{grade}")
    assert gyro.density <= heading.angle_random_walk_rad <= 1.1 * gyro.density
    assert heading.bias_initial_radps >= 1.2 * gyro.turn_on
    assert np.deg2rad(reckoning.heading_drift_degps) >= 2.3 * gyro.instability
    assert reckoning.watch.accelerometer_bias_mps2 >= 5.0 * accel.turn_on


def test_a_better_imu_lowers_the_levels_in_a_tunnel_and_they_hold() -> None:
    end_m = {}
    for grade in GRADES:
        error, level = _drive(NavigatorConfig.preset(f"navigators/{grade}"))
        assert (error > level).mean() <= NavigatorConfig().risk.integrity_risk, grade
        end_m[grade] = float(np.median(level[-1]))
    assert end_m["automotive"] < 0.85 * end_m["consumer"]
    assert end_m["tactical"] < 0.6 * end_m["consumer"]


def test_environments_take_a_preset_by_its_name() -> None:
    config = EnvConfig.build({"base": "LaneKeeping"}, {"navigator": "navigators/tactical"})
    assert config.navigator["imu"]["grade"] == "tactical"
    assert (
        config.to_dict()
        == EnvConfig.build({"base": "LaneKeeping"}, parse_assignments(["navigator=navigators/tactical"])).to_dict()
    )
    assert NavigatorConfig().replace(**config.navigator) == NavigatorConfig.preset("navigators/tactical")


def test_a_part_of_a_preset_extends_another_one() -> None:
    data = load_preset("navigators/tactical")
    assert data["kind"] == "navigator"
    assert data["imu"] == {key: value for key, value in load_preset("sensors/imu_tactical").items() if key != "kind"}
