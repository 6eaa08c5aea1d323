"""A drive by code: simulated where the truth is known, and the recorded one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import real
from typer.testing import CliRunner

from lanebound.integrity.errors import InputError
from lanebound.integrity.frames import ecef_from_enu_matrix, ecef_from_geodetic
from lanebound.integrity.monitoring.alerts import AlertConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.recorded.smartloc import Odometry, Pseudoranges, SmartLoc, Truth
from lanebound.integrity.replay.city import CityConfig, drive_city
from lanebound.integrity.replay.city_report import CityReplay, replay_city, write_city
from lanebound.integrity.replay.overbound import CodeErrors
from lanebound.integrity.replay.sagnac import ranges_and_sights
from lanebound.integrity.replay.training import code_errors

LAT, LON = np.radians(52.5), np.radians(13.4)
SIGMA_M = 3.0
BOUNDS = CodeErrors(np.array([30.0, 50.0]), np.zeros(2), np.full(2, SIGMA_M), 0.0)
QUICK = CityConfig(window_s=10.0)


def simulated(seconds: float = 24.0, late: tuple[int, ...] = (), late_m: float = 0.0, seed: int = 1) -> SmartLoc:
    """A drive at 5 Hz with ten satellites in two systems, a drifting clock and, for some satellites, late signals."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.2)
    origin, axes = ecef_from_geodetic(LAT, LON, 80.0), ecef_from_enu_matrix(LAT, LON)
    heading = 0.6 + 0.05 * t
    path = np.zeros((t.size, 3))
    path[1:, 0] = np.cumsum(8.0 * 0.2 * np.sin(0.5 * (heading[1:] + heading[:-1])))
    path[1:, 1] = np.cumsum(8.0 * 0.2 * np.cos(0.5 * (heading[1:] + heading[:-1])))
    place = origin + path @ axes.T
    azimuth, elevation = np.arange(10) * 2.0 * np.pi / 10.0, np.radians(20.0 + 6.0 * np.arange(10))
    up = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], -1)
    satellite = origin + 2.2e7 * up @ axes.T
    k, s = (v.ravel() for v in np.meshgrid(np.arange(t.size), np.arange(10), indexing="ij"))
    distance, _ = ranges_and_sights(satellite[s], place[k])
    system = np.where(s < 6, "G", "R")
    clock = 1000.0 - 40.0 * t[k] + np.where(s < 6, 0.0, 25.0)
    noise = rng.normal(0.0, SIGMA_M, k.size) + np.where(np.isin(s, late), late_m, 0.0)
    ranges = Pseudoranges(
        t[k], distance + clock + noise, np.full(k.size, SIGMA_M**2), satellite[s], s + 1, system, elevation[s],
        np.full(k.size, 45.0),
    )  # fmt: skip
    odometry = Odometry(t, np.full(t.size, 8.0), np.full(t.size, -0.05), np.full(t.size, 0.01), np.full(t.size, 1e-6))
    return SmartLoc(ranges, odometry, Truth(t, place), None)


def errors_and_levels(drive: SmartLoc, config: CityConfig, **options: object) -> tuple[np.ndarray, np.ndarray]:
    record = drive_city(drive, BOUNDS, config, **options).record(drive, AlertConfig(), after_s=8.0)
    return (
        np.stack([record.error("at"), record.error("ct")], -1),
        np.stack([record.pl("at"), record.pl("ct")], -1),
    )


def test_noise_alone_is_averaged_and_bounded() -> None:
    error, pl = errors_and_levels(simulated(), QUICK, every=10)
    assert error.max() < 3.0
    assert (error < pl).all()
    assert np.median(pl) < 15.0


def test_several_late_satellites_are_excluded_at_once() -> None:
    drive = simulated(late=(2, 7), late_m=120.0)
    found = drive_city(drive, BOUNDS, QUICK, every=10)
    assert (found.excluded[2:] == 2).all()
    error, pl = errors_and_levels(drive, QUICK, every=10)
    assert error.max() < 4.0
    assert (error < pl).all()


def test_reweighting_meets_a_late_satellite_too() -> None:
    drive = simulated(late=(2,), late_m=60.0)
    config = QUICK.replace(danish={"iterations": 12})
    found = drive_city(drive, BOUNDS, config, every=10)
    assert (found.reweighted[2:] > 0.09).all()
    assert (found.excluded == 0).all()
    error, _ = errors_and_levels(drive, config, every=10)
    assert error.max() < 4.0


def test_an_outage_is_bridged_and_the_level_grows_until_it_ends() -> None:
    drive = simulated()
    found = drive_city(drive, BOUNDS, QUICK, outages_s=((12.0, 18.0),), every=5)
    inside = (found.time_s >= 12.0) & (found.time_s < 18.0)
    assert (found.mode[inside] == Mode.IMU_ODOMETER).all()
    assert (np.diff(found.pl_m[inside].sum(-1)) > 0.0).all()
    record = found.record(drive, AlertConfig(), after_s=8.0)
    assert (record.error("at") < record.pl("at")).all()
    assert (record.error("ct") < record.pl("ct")).all()
    after = found.time_s >= 19.0
    assert (found.mode[after] == Mode.CODE).all()


def test_the_clock_is_told_from_late_signals() -> None:
    drive = simulated(late=(0,), late_m=50.0)
    keep, error = code_errors(drive, 20.0)
    own = drive.ranges.satellite[keep] == 1
    assert np.median(error[own]) == pytest.approx(50.0, abs=2.0)
    assert np.median(error[~own]) == pytest.approx(0.0, abs=1.0)


def test_training_never_sees_what_comes_after() -> None:
    drive = simulated()
    later = drive.ranges.time_s >= 12.0
    spoilt = replace(drive, ranges=replace(drive.ranges, range_m=drive.ranges.range_m + 1e4 * later))
    for a, b in zip(code_errors(drive, 12.0), code_errors(spoilt, 12.0), strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_cannot_be_driven_is_named() -> None:
    drive = simulated(2.0)
    few = drive.ranges.satellite <= 3
    thin = replace(
        drive, ranges=Pseudoranges(*(getattr(drive.ranges, f)[few] for f in drive.ranges.__dataclass_fields__))
    )
    with pytest.raises(InputError, match="must have an epoch of 5 satellites, the best has 3"):
        drive_city(thin, BOUNDS, QUICK)
    with pytest.raises(InputError, match="must have a ground truth"):
        replay_city(replace(drive, truth=None))
    none = Odometry(*[np.zeros(0)] * 5)
    with pytest.raises(InputError, match="must have odometry"):
        drive_city(replace(drive, odometry=none), BOUNDS, QUICK)


def as_files(drive: SmartLoc, folder: Path) -> None:
    """The drive in the form of the data set."""
    r, o, truth = drive.ranges, drive.odometry, drive.truth
    assert truth is not None
    lines = [
        f"pseudorange3 {t} {p:.4f} {v} {x:.4f} {y:.4f} {z:.4f} {s} {1 if letter == 'G' else 4} {np.degrees(e)} {c}"
        for t, p, v, (x, y, z), s, letter, e, c in zip(
            r.time_s,
            r.range_m,
            r.variance_m2,
            r.satellite_ecef_m,
            r.satellite,
            r.system,
            r.elevation_rad,
            r.cn0_dbhz,
            strict=True,
        )
    ]
    lines += [
        f"odom3 {t} {v} 0 0 0 0 {w} 0.0025 0.0009 0.0009 4e-06 4e-06 4e-06"
        for t, v, w in zip(o.time_s, o.speed_mps, o.yaw_rate_left_radps, strict=True)
    ]
    (folder / "Town_Input.txt").write_text("\n".join(lines) + "\n")
    points = [
        f"point3 {t} {x:.4f} {y:.4f} {z:.4f}" for t, (x, y, z) in zip(truth.time_s, truth.position_ecef_m, strict=True)
    ]
    (folder / "Town_GT.txt").write_text("\n".join(points) + "\n")


def test_the_command_replays_a_folder(tmp_path: Path) -> None:
    from lanebound.agents.cli import app

    as_files(simulated(), tmp_path)
    arguments = ["replay", str(tmp_path), "--out", str(tmp_path / "out"), "--set", "every=20", "--json"]
    done = CliRunner().invoke(app, [*arguments, "--set", "solution.window_s=6.0"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert set(found["solutions"]) == {"overbound", "danish", "gaussian", "gaussian_epoch"}
    counted = found["solutions"]["overbound"]["after_training"]["all_modes"]["at"]
    assert counted["epochs"] >= 3
    assert counted["exceeded"] == 0
    assert (tmp_path / "out" / "stanford_overbound.png").stat().st_size > 10_000
    refused = CliRunner().invoke(app, [*arguments, "--set", "every=0"])
    assert refused.exit_code == 2


def test_a_folder_without_a_drive_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must hold"):
        write_city(tmp_path, tmp_path / "out")


@pytest.mark.slow
def test_the_berlin_drive_is_bounded_where_the_plain_model_fails(tmp_path: Path) -> None:
    folder = real("smartloc_berlin_potsdamer")
    found, written = write_city(folder, tmp_path, CityReplay(every=5))
    trained, plain = found["solutions"]["overbound"], found["solutions"]["gaussian_epoch"]
    assert all(path.exists() for path in written)
    for axis in ("at", "ct"):
        ours, theirs = (s["after_training"]["all_modes"][axis] for s in (trained, plain))
        assert ours["rate"] < 0.5 * theirs["rate"]
        assert theirs["rate_low"] > 1e-2  # ten times the risk, beyond doubt
        assert trained["training"]["all_modes"][axis]["exceeded"] == 0
