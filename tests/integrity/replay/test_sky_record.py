"""The sky along a drive: walls that a made-up drive has are found where they are, and the recorded drive is written."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from city_drives import ELEVATION_DEG, SPEED_MPS, as_files, heading_at, simulated, walled
from recordings import real
from typer.testing import CliRunner

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.sky_recording import SkyRecording, read_sky_recording
from lanebound.integrity.recorded.smartloc import Pseudoranges, SmartLoc
from lanebound.integrity.replay.city import read_city
from lanebound.integrity.replay.sky_record import SkyRecordConfig, agreement, record_sky, summary
from lanebound.integrity.sky.visibility import SignalPath

FROM_S, UNTIL_S = 8.0, 16.0


def only(drive: SmartLoc, keep: np.ndarray) -> SmartLoc:
    r = drive.ranges
    return replace(drive, ranges=Pseudoranges(*(getattr(r, f.name)[keep] for f in fields(r))))


def beside(sky: SkyRecording) -> np.ndarray:
    """Rows of stretches that lie beside the wall as a whole."""
    return (sky.arc_m > FROM_S * SPEED_MPS + 5.0) & (sky.arc_m < UNTIL_S * SPEED_MPS - 5.0)


def test_walls_are_where_they_are() -> None:
    sky = record_sky(walled(simulated(), FROM_S, UNTIL_S))
    right, elevation = np.sin(sky.azimuth_rad), np.degrees(sky.elevation_rad)
    clear_of_edges = np.abs(right) > 0.1  # a satellite ahead changes sides in a bend
    left_low = beside(sky) & (right < 0.0) & (elevation < 60.0) & clear_of_edges
    right_low = beside(sky) & (right > 0.0) & (elevation < 40.0) & clear_of_edges
    assert left_low.sum() > 20
    assert right_low.sum() > 10
    assert (sky.path[left_low] == SignalPath.BLOCKED).all()
    assert (sky.cn0_dbhz[left_low] == 0.0).all()
    assert (sky.path[right_low] == SignalPath.REFLECTED).all()
    np.testing.assert_allclose(sky.excess_m[right_low], 40.0, atol=6.0)  # 2 sigma of the noise
    away = (sky.arc_m < FROM_S * SPEED_MPS - 5.0) | (sky.arc_m > UNTIL_S * SPEED_MPS + 5.0)
    assert (sky.path[away] == SignalPath.LOS).all()
    assert (sky.excess_m[sky.path != SignalPath.REFLECTED] == 0.0).all()


def test_directions_are_those_from_the_car() -> None:
    """Of lost satellites too, whose positions nobody recorded meanwhile."""
    sky = record_sky(walled(simulated(), FROM_S, UNTIL_S))
    number = np.array([int(name[1:]) for name in sky.satellite])
    world = np.mod(sky.azimuth_rad + heading_at(sky.arc_m / SPEED_MPS), 2.0 * np.pi)
    off = np.remainder(world - 2.0 * np.pi * (number - 1) / 10.0 + np.pi, 2.0 * np.pi) - np.pi
    assert np.abs(off).max() < np.deg2rad(3.0)  # a heading turns by 1.8 degrees in a stretch
    np.testing.assert_allclose(np.degrees(sky.elevation_rad), ELEVATION_DEG[number - 1], atol=0.01)
    assert sky.length_m == pytest.approx(23.8 * SPEED_MPS, rel=1e-3)
    assert set(sky.satellite) == {*(f"G{k}" for k in range(1, 7)), *(f"R{k}" for k in range(7, 11))}


def test_weak_signals_that_are_not_late_came_through_leaves() -> None:
    drive = simulated()
    weak = (drive.ranges.satellite == 1) & (drive.ranges.time_s > 12.0)
    sky = record_sky(replace(drive, ranges=replace(drive.ranges, cn0_dbhz=np.where(weak, 35.0, 45.0))))
    behind = (sky.satellite == "G1") & (sky.arc_m > 12.0 * SPEED_MPS + 5.0)
    assert (sky.path[behind] == SignalPath.FOLIAGE).all()
    assert (sky.path[~behind & (sky.satellite != "G1")] == SignalPath.LOS).all()


def test_nobody_is_expected_long_before_and_after() -> None:
    drive = simulated()
    r = drive.ranges
    late_riser = only(drive, (r.satellite != 3) | ((r.time_s > 10.0) & (r.time_s < 14.0)))
    always, soon = record_sky(late_riser), record_sky(late_riser, SkyRecordConfig(expected_s=0.0))
    assert (always.path[always.satellite == "G3"] == SignalPath.BLOCKED).mean() > 0.7
    assert (soon.path[soon.satellite == "G3"] == SignalPath.LOS).all()
    low = record_sky(drive, SkyRecordConfig(lowest_deg=30.0))
    assert "G1" not in low.satellite


def test_neighbours_foretell_a_wall_better_than_a_guess() -> None:
    right, blind = agreement(record_sky(walled(simulated(60.0), 10.0, 50.0)))
    assert right > blind + 0.05


def test_what_makes_no_recording_is_named() -> None:
    drive = simulated()
    with pytest.raises(InputError, match="must have a ground truth"):
        record_sky(replace(drive, truth=None))
    assert drive.truth is not None
    stands = replace(
        drive.truth, position_ecef_m=np.tile(drive.truth.position_ecef_m[:1], (drive.truth.time_s.size, 1))
    )
    with pytest.raises(InputError, match="must be at least 20 m long, got 0"):
        record_sky(replace(drive, truth=stands))
    with pytest.raises(InputError, match="lower lowest_deg"):
        record_sky(drive, SkyRecordConfig(lowest_deg=80.0))


def test_the_command_writes_a_file(tmp_path: Path) -> None:
    from lanebound.agents.cli import app

    as_files(walled(simulated(), FROM_S, UNTIL_S), tmp_path)
    out = tmp_path / "town.csv"
    done = CliRunner().invoke(app, ["record-sky", str(tmp_path), "--out", str(out), "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    sky = read_sky_recording(out)
    rounded = {key: pytest.approx(found[key], abs=0.01) for key in ("length_m", "late_median_m", "late_95_m")}
    assert found == summary(sky) | rounded
    shown = CliRunner().invoke(app, ["record-sky", str(tmp_path), "--out", str(out), "--set", "late_m=60"])
    assert "reflected, share of rows" in shown.stdout
    assert not (read_sky_recording(out).path == SignalPath.REFLECTED).any()
    refused = CliRunner().invoke(app, ["record-sky", str(tmp_path), "--out", str(tmp_path / "town.txt")])
    assert refused.exit_code == 2
    nothing = CliRunner().invoke(app, ["record-sky", str(tmp_path / "none"), "--out", str(out)])
    assert nothing.exit_code == 2


def test_the_sky_of_the_berlin_drive() -> None:
    sky = record_sky(read_city(real("smartloc_berlin_potsdamer")))
    found = summary(sky)
    assert found["length_m"] == pytest.approx(756.9, rel=0.01)  # by the wheels
    assert found["shares"]["reflected"] > 0.3
    assert found["shares"]["los"] > 0.2
    assert found["foretold"] > found["guessed"] + 0.15
    high = sky.elevation_rad > np.deg2rad(70.0)
    assert (sky.path[high] == SignalPath.BLOCKED).mean() < 0.01
