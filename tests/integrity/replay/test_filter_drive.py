"""Filters on recorded drives: a drive made up, a segment made up, both recordings, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from city_drives import simulated
from recordings import real, rinex_header
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.recorded.comma import Comma, ReceiverFixes, Reference, Series
from lanebound.integrity.replay.datasets import replay_folder
from lanebound.integrity.replay.filter_drive import (
    FilterReplayConfig,
    comma_sensors,
    drive_filter,
    filter_summary,
    smartloc_sensors,
)

ORIGIN = np.array([-2712087.5, -4261670.1, 3881014.5])


def segment(seconds: float = 40.0) -> Comma:
    """A car that drives North at 12 m/s and then turns to the right, with positions 1 m to the East of it."""
    t = np.arange(0.0, seconds, 0.05)
    rate = np.where((t > 15.0) & (t < 25.0), np.deg2rad(6.0), 0.0)
    heading = np.cumsum(rate) * 0.05
    velocity = 12.0 * np.stack([np.sin(heading), np.cos(heading)], -1)
    place = np.cumsum(velocity, axis=0) * 0.05
    latitude, longitude, _ = geodetic_from_ecef(ORIGIN)
    axes = ecef_from_enu_matrix(latitude, longitude)
    flat = np.zeros(t.size)
    ecef = ORIGIN + np.column_stack([place, flat]) @ axes.T
    reference = Reference(t, ecef, np.column_stack([velocity, flat]) @ axes.T, np.tile([1.0, 0, 0, 0], (t.size, 1)))
    seen = geodetic_from_ecef(ecef[::2] + axes[:, 0])
    fixes = ReceiverFixes(
        t[::2], np.rad2deg(seen[0]), np.rad2deg(seen[1]), np.full(t[::2].size, 12.0), np.rad2deg(heading[::2])
    )
    assert np.abs(ecef_from_geodetic(seen[0], seen[1], seen[2]) - ecef[::2] - axes[:, 0]).max() < 1e-3
    gyro = Series(t, np.column_stack([flat, flat, rate]))
    return Comma(
        reference, Series(t, np.full(t.size, 12.0)), Series(t, np.full((t.size, 4), 12.0)),
        Series(t, np.zeros((t.size, 3))), gyro, fixes,
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["imm", "ekf", "ukf"])
def test_a_segment_is_located_with_the_bias_of_its_receiver(kind: str) -> None:
    """Cold start by the Doppler course; then the error is that of the receiver, and below the levels."""
    config = FilterReplayConfig.build(None, {"navigator": {"kind": "filter", "filter": kind}})
    drive = drive_filter(comma_sensors(segment(), config), config)
    levelled = np.isfinite(drive.levels_m[:, 0]).all(-1)
    assert 0.8 < levelled.mean() < 1.0
    error = drive.position_m - drive.sensors.truth_m
    assert np.abs(error[levelled] - [1.0, 0.0]).max() < 0.8
    assert (np.linalg.norm(error[levelled], axis=-1) < drive.levels_m[levelled, 1].min(-1)).all()
    found = filter_summary(drive, config)
    assert found["positions"]["used"] > 25
    assert found["levels"]["0.001"]["at"]["exceeded"] == 0
    json.dumps(found, allow_nan=False)


def test_a_drive_by_codes_is_located() -> None:
    """Codes with the noise of the receiver, heading by the path; the level comes after the path has fitted."""
    config = FilterReplayConfig.build(None, {"navigator": {"kind": "filter"}})
    drive = drive_filter(smartloc_sensors(simulated(60.0), config), config)
    levelled = np.isfinite(drive.levels_m[:, 0]).all(-1) & drive.sensors.known
    assert levelled.mean() > 0.3
    error = np.linalg.norm(drive.position_m - drive.sensors.truth_m, axis=-1)
    assert np.median(error[levelled]) < 3.0
    assert (error[levelled] < np.hypot(*drive.levels_m[levelled, 2].T)).all()
    assert "compass" in drive.sensors.lacking


def test_what_is_no_filter_or_has_no_positions_is_refused(tmp_path: Path) -> None:
    config = FilterReplayConfig(navigator=NavigatorConfig.load({"kind": "rtk_reckoning"}))
    with pytest.raises(ConfigError, match="of kind filter, got rtk_reckoning"):
        config.filter_of(0.1)
    for preset, source in (("imm_sbas", "sbas"), ("imm_differential", "differential")):
        config = FilterReplayConfig.build(None, {"navigator": NavigatorConfig.data_of(preset)})
        message = rf"codes\.source must be undifferenced for a recording.*got {source}: give filter or imm_s4"
        with pytest.raises(ConfigError, match=message):
            comma_sensors(segment(), config)
        with pytest.raises(ConfigError, match=message):
            smartloc_sensors(simulated(5.0), config)
    blind, plain = Comma(**{**vars(segment()), "fixes": None}), FilterReplayConfig.build(None, {})
    with pytest.raises(InputError, match="live_gnss_ublox"):
        comma_sensors(blind, plain)
    (tmp_path / "rover.obs").write_text(rinex_header())
    with pytest.raises(InputError, match="RINEX, which has no wheels"):
        replay_folder(tmp_path, tmp_path / "out", navigator="filter")


@pytest.mark.parametrize("name", ["comma2k19_segment40", "smartloc_berlin_potsdamer"])
def test_the_command_replays_recordings_with_a_filter(name: str, tmp_path: Path) -> None:
    """No level of 1e-3 and 1e-4 is exceeded; the receiver's bias stays (1.5 m), reflections do (10 m)."""
    done = CliRunner().invoke(
        app, ["replay", str(real(name)), "--navigator", "ekf_straight", "--out", str(tmp_path), "--json"]
    )
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "replay.json").read_text())
    assert found["filter"] == "ekf"
    assert "speed of the wheels" in found["sensors"]
    assert "compass" not in found["sensors"]
    assert found["with_level"] > 200
    assert all(found["levels"][risk][axis]["exceeded"] == 0 for risk in ("0.001", "0.0001") for axis in ("at", "ct"))
    assert found["horizontal_m"]["rms"] < (3.0 if name.startswith("comma") else 16.0)
    assert (tmp_path / "series.png").is_file()
