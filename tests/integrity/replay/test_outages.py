"""Artificial outages: closed forms, and the recorded minute."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings import comma_folder, real

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.comma import read_comma
from lanebound.integrity.replay.outages import (
    Motion,
    OutageConfig,
    calibrate,
    motion_of,
    run_outages,
    sawtooth,
    write_outages,
)


def straight(speed: float = 12.0, seconds: float = 45.0) -> Motion:
    """Due North, everything measured without error."""
    t = np.arange(0.0, seconds, 0.1)
    position = np.stack([np.zeros(t.size), speed * t], -1)
    return Motion(t, position, np.zeros(t.size), np.full(t.size, speed), np.full(t.size, speed), np.zeros(t.size))


def test_a_heading_error_costs_its_sine_of_the_way() -> None:
    given = OutageConfig(heading_error_deg=1.0, longest_s=10.0)
    found = run_outages(straight(), given)
    expected = 12.0 * found.age_s * np.sin(np.radians(1.0))
    np.testing.assert_allclose(np.abs(found.error_m[..., 1]), np.tile(expected, (len(found.start_s), 1)), atol=1e-9)
    assert (found.error_m[0, -1, 1] > 0.0) != (found.error_m[1, -1, 1] > 0.0)


def test_a_reference_ahead_of_the_rear_axle_in_a_bend() -> None:
    t = np.arange(0.0, 45.0, 0.1)
    rate, v, ahead = 0.1, 8.0, 2.5
    way = np.stack([np.sin(rate * t), np.cos(rate * t)], -1)
    axle = v / rate * np.stack([1.0 - way[:, 1], way[:, 0]], -1)
    motion = Motion(t, axle + ahead * way, rate * t, *(np.full(t.size, value) for value in (v, v, rate)))
    told, untold = (run_outages(motion, OutageConfig(longest_s=10.0, axle_m=a)) for a in (ahead, 0.0))
    assert np.abs(told.error_m).max() < 0.02  # chords for arcs
    away = np.linalg.norm(untold.error_m[:, -1], axis=-1)
    np.testing.assert_allclose(away, 2.0 * ahead * np.sin(0.5), atol=0.02)  # the lever turns by a radian


def test_levels_grow_with_the_outage_and_with_the_speed() -> None:
    config = OutageConfig(longest_s=10.0)
    slow, fast = run_outages(straight(6.0), config), run_outages(straight(12.0), config)
    assert (np.diff(slow.pl_m, axis=1) > 0.0).all()
    assert (fast.pl_m[:, -1] > slow.pl_m[:, -1]).all()


def test_calibration_finds_scale_and_bias_from_the_first_part_alone() -> None:
    clean = straight()
    tampered = np.where(clean.time_s > 15.0, 99.0, 0.0)
    wrong = Motion(
        clean.time_s, clean.position_m, clean.track_rad, clean.true_speed_mps, clean.speed_mps / 1.02 + tampered,
        np.full(clean.time_s.size, 0.01) + tampered,
    )  # fmt: skip
    _, found = calibrate(wrong, 15.0)
    assert found["speed_scale"] == pytest.approx(1.02)
    assert found["gyro_bias_degps"] == pytest.approx(np.degrees(0.01))


def test_the_sawtooth_falls_back_to_the_fix() -> None:
    found = sawtooth(straight(seconds=60.0), OutageConfig(longest_s=8.0), fixed_s=2.0)
    assert (np.diff(found["time_s"]) > 0.0).all()
    low, high = found["pl_m"][found["fixed"]], found["pl_m"][~found["fixed"]]
    assert low.max() < 0.1 < high.max()


def test_too_short_a_segment_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must last 35 s"):
        motion_of(read_comma(comma_folder(tmp_path)), OutageConfig())
    with pytest.raises(InputError, match="is at rest"):
        calibrate(straight(0.0), 15.0)


def test_the_highway_minute(tmp_path: Path) -> None:
    found, written = write_outages(real("comma2k19_segment40"), tmp_path)
    assert all(path.exists() for path in written)
    assert found["outages"] == 50
    assert [found["all_ages"][axis]["exceeded"] for axis in ("at", "ct")] == [0, 0]
    s1 = found["with_heading_error_of_s1"]
    assert 0.8 < s1["ratio_median"] < 1.2  # S1's 0.53 m after 4 s, scaled by the speed
    assert s1["ct_median_at_the_end_m"] > 2.0  # "more than 2 m in less than 20 s"
    assert [s1["exceeded"][axis]["exceeded"] for axis in ("at", "ct")] == [0, 0]
