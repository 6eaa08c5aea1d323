"""Code errors of a recorded drive beside simulated ones: clocks, offsets, classes, and the recorded drive itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lanebound.agents.assess.signals import SignalsConfig, _quantiles, _without_clock, assess_signals, signal_rows
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.systems import System
from tests.helpers.recordings import real

SMALL = SignalsConfig(streets=1, vehicles=2, duration_s=10.0, warm_up_s=5.0, length_m=600.0)


def test_clock_and_offset_are_taken_out_and_errors_stay() -> None:
    rng = np.random.default_rng(4)
    epochs, each = 40, 8
    time = np.repeat(np.arange(epochs), 2 * each)
    system = np.tile(np.repeat([System.GPS, System.GALILEO], each), epochs)
    error = np.where(rng.random(time.size) < 0.1, 30.0, 0.0)
    clock = np.repeat(1e3 * rng.standard_normal(epochs), 2 * each)
    residual = error + clock + np.where(system == System.GALILEO, -7.0, 0.0)
    rows = np.column_stack([time, system, residual, np.full(time.size, 45.0), np.full(time.size, 45.0)])
    np.testing.assert_allclose(_without_clock(rows)[:, 2], error, atol=1e-9)


def test_an_epoch_with_few_strong_codes_is_left_out() -> None:
    rows = np.array([[t, 0.0, 5.0 + t, 45.0, 41.0 if n < 3 - t else 20.0] for t in (0.0, 1.0) for n in range(4)])
    assert set(_without_clock(rows)[:, 0]) == {0.0}
    rows[:, 4] = 20.0
    with pytest.raises(InputError, match="3 GPS codes of 40 dB-Hz, got none"):
        _without_clock(rows)


def test_quantiles_are_of_the_absolute_errors_of_a_class() -> None:
    rows = np.column_stack(
        [np.zeros(101), np.zeros(101), np.linspace(-50.0, 50.0, 101), np.full(101, 20.0), np.full(101, 30.0)]
    )
    found = _quantiles(rows, (25.0, 32.0), (0.0, 30.0))
    assert found is not None
    assert found["share"] == 1.0
    assert found["quantiles_m"][0] == pytest.approx(25.0)
    assert _quantiles(rows, (43.0, 60.0), (0.0, 30.0)) is None


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
