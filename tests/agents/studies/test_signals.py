"""Code errors of a recorded drive beside simulated ones: clocks, offsets, classes, and the recorded drive itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lanebound.agents.studies.signals import (
    SignalResiduals,
    SignalsConfig,
    _quantiles,
    assess_signals,
    compare_paths,
    labelled,
    path_rows,
    signal_rows,
    without_clock,
)
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.smartloc import read_smartloc, read_smartloc_raw
from lanebound.integrity.sky.systems import System
from tests.helpers.recordings import real

SMALL = SignalsConfig(streets=1, vehicles=2, duration_s=10.0, warm_up_s=5.0, length_m=600.0)


def signals(n: int, **given: object) -> SignalResiduals:
    """Strong GPS signals at 45 degrees without errors, changed by ``given``."""
    zero = np.zeros(n)
    columns = {
        "time_s": zero, "system": np.full(n, int(System.GPS)), "satellite": np.arange(n), "code_m": zero,
        "rate_mps": zero, "elevation_deg": zero + 45.0, "cn0_dbhz": zero + 45.0, "blocked": np.zeros(n, np.int64),
    }  # fmt: skip
    return SignalResiduals(**{**columns, **given})  # type: ignore[arg-type]


def test_clock_and_offset_are_taken_out_and_errors_stay() -> None:
    rng = np.random.default_rng(4)
    epochs, each = 40, 8
    time = np.repeat(np.arange(epochs), 2 * each)
    system = np.tile(np.repeat([System.GPS, System.GALILEO], each), epochs)
    error = np.where(rng.random(time.size) < 0.1, 30.0, 0.0)
    clock = np.repeat(1e3 * rng.standard_normal(epochs), 2 * each)
    residual = error + clock + np.where(system == System.GALILEO, -7.0, 0.0)
    drift = np.repeat(rng.standard_normal(epochs), 2 * each)
    found = without_clock(signals(time.size, time_s=time, system=system, code_m=residual, rate_mps=drift + 0.1 * error))
    np.testing.assert_allclose(found.code_m, error, atol=1e-9)
    np.testing.assert_allclose(found.rate_mps, 0.1 * error, atol=1e-9)


def test_an_epoch_with_few_strong_codes_is_left_out() -> None:
    time = np.repeat([0.0, 1.0], 4)
    cn0 = np.array([41.0, 41.0, 41.0, 20.0, 41.0, 41.0, 20.0, 20.0])
    assert set(without_clock(signals(8, time_s=time, cn0_dbhz=cn0)).time_s) == {0.0}
    with pytest.raises(InputError, match="3 GPS codes of 40 dB-Hz, got none"):
        without_clock(signals(8, time_s=time, cn0_dbhz=np.full(8, 20.0)))


def test_quantiles_are_of_the_absolute_errors_of_a_class() -> None:
    some = signals(
        101, code_m=np.linspace(-50.0, 50.0, 101), elevation_deg=np.full(101, 20.0), cn0_dbhz=np.full(101, 30.0)
    )
    found = _quantiles(some, (25.0, 32.0), (0.0, 30.0))
    assert found is not None
    assert found["share"] == 1.0
    assert found["quantiles_m"][0] == pytest.approx(25.0)
    assert _quantiles(some, (43.0, 60.0), (0.0, 30.0)) is None


def test_errors_are_compared_by_path_with_intervals_by_satellite() -> None:
    """Ten blocked satellites, one of which is far off: its error lies in the interval of the high quantiles only."""
    code = np.where(np.arange(100) % 10 == 0, 80.0, 5.0)
    theirs = signals(
        100, satellite=np.arange(100) % 10, code_m=code, blocked=np.ones(100, np.int64), rate_mps=np.full(100, np.nan)
    )
    rows = compare_paths(theirs, signals(50, code_m=np.full(50, 2.0), blocked=np.arange(50) % 2))
    found = {(row["observable"], row["path"]): row for row in rows}
    blocked = found["code_m", "blocked"]
    assert (blocked["signals"], blocked["satellites"], blocked["simulated_signals"]) == (100, 10, 25)
    assert blocked["recorded"][0] == blocked["low"][0] == blocked["high"][0] == 5.0
    assert (blocked["low"][3], blocked["high"][3]) == (5.0, 80.0)
    assert blocked["simulated"] == [2.0] * 4
    assert found["code_m", "direct"]["recorded"] is None
    assert found["rate_mps", "blocked"]["signals"] == 0  # Doppler was not measured
    assert len(path_rows({"paths": rows})[1]) == 4


def test_a_folder_without_a_drive_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must hold"):
        assess_signals(tmp_path, SMALL, tmp_path / "out")


def test_the_recorded_drive_has_late_codes_where_signals_are_weak(tmp_path: Path) -> None:
    result = assess_signals(real("smartloc_berlin_potsdamer"), SMALL, tmp_path)
    assert result["codes"]["first half"] + result["codes"]["second half"] > 9000
    weak, strong = (
        next(c for c in result["classes"] if c["cn0_dbhz"] == cn0 and c["elevation_deg"][0] == elevation[0])
        for cn0, elevation in (([25.0, 32.0], [0.0, 30.0]), ([43.0, 60.0], [60.0, 90.0]))
    )
    for half in ("first half", "second half"):
        assert weak[half]["quantiles_m"][0] > 30.0
        assert strong[half]["quantiles_m"][0] < 5.0
    assert (tmp_path / "signals.json").exists()
    assert signal_rows(result)[0][2:] == ("first half", "second half", "simulated")


def test_labels_of_the_excerpt_belong_to_the_recorded_drive() -> None:
    """The excerpt is the beginning of the drive: 493 of 545 signals stand in both tables, with the same C/N0.

    The Doppler of strong signals with a direct ray agrees with the true motion; blocked ones are far off.
    """
    folder = real("smartloc_berlin_potsdamer")
    drive = read_smartloc(folder / "Berlin_Potsdamer_Platz_Input.txt.gz", folder / "Berlin_Potsdamer_Platz_GT.txt")
    raw = read_smartloc_raw(real("smartloc_berlin_excerpt") / "tu_chemnitz_berlin_1_raw.csv")
    found = without_clock(labelled(drive, raw))
    assert [(found.blocked == k).sum() for k in (0, 1)] == [270, 223]
    assert np.isfinite(found.rate_mps).all()
    direct = (found.blocked == 0) & (found.cn0_dbhz >= 44.0)
    assert np.median(np.abs(found.rate_mps[direct])) < 0.15
    assert np.median(np.abs(found.rate_mps[found.blocked == 1])) > 0.5
    assert np.median(np.abs(found.code_m[found.blocked == 1])) > 5.0 * np.median(np.abs(found.code_m[direct]))
    with pytest.raises(InputError, match="must be a table of the same drive"):
        labelled(drive, replace(raw, latitude_deg=raw.latitude_deg + 1.0))
