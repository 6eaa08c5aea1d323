"""Events of hand-written sequences, and the streaming clock against the batch accounting."""

from __future__ import annotations

import json

import numpy as np
import pytest
from failure_clock import FailureClock
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lanebound.integrity.assessment.record import Record, Zone, alert_delays, classify, find_events, running_age_s
from lanebound.integrity.core.errors import InputError


def record(error_ct: list[float], pl_ct: list[float], alert: str = "", interval_s: float = 0.5) -> Record:
    """One vehicle, cross-track errors and levels as given, along-track always good; alert flags as ``.#``."""
    n = len(error_ct)
    flags = np.array([c == "#" for c in (alert or "." * n)])
    return Record(
        time_s=np.arange(n) * interval_s,
        mode=np.ones(n, dtype=np.int64),
        error_at_m=np.full(n, 0.1),
        error_ct_m=np.asarray(error_ct, dtype=np.float64),
        pl_at_m=np.full(n, 0.5),
        pl_ct_m=np.asarray(pl_ct, dtype=np.float64),
        alert=flags,
        available=~flags,
    )


def test_an_error_that_equals_its_level_or_limit_but_for_rounding_is_not_beyond_it() -> None:
    level = 0.1 + 0.2  # 0.30000000000000004
    error = np.array([np.nextafter(level, 1.0), np.nextafter(1.0, 2.0), level + 1e-8, 1.0 + 1e-8])
    zones = [Zone(code).name for code in classify(error, [level, 1.0, level, level], 1.0)]
    assert zones == ["NOMINAL", "NOMINAL", "MISLEADING", "HAZARDOUS"]
    assert not find_events(record(error[:2].tolist(), [level, 1.0]), 1.0, 1.0).ct.failure.any()


def test_zones_by_hand() -> None:
    error = [0.2, 0.5, -0.6, 1.0, 1.1, 1.1, 0.2, 2.5, 2.0]
    pl = [0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 2.0, 2.0, np.inf]
    names = [Zone(code).name for code in classify(error, pl, 1.0)]
    assert names == [
        "NOMINAL", "NOMINAL", "MISLEADING", "MISLEADING", "HAZARDOUS", "HAZARDOUS", "UNAVAILABLE",
        "UNAVAILABLE_MISLEADING", "UNAVAILABLE",
    ]  # fmt: skip


def test_events_by_hand() -> None:
    events = find_events(record([0.2, 0.6, 1.2, 1.2, 0.2, 0.2], [0.5] * 6, "...##."), 1.0, 1.0)
    ct = events.ct
    assert ct.available.tolist() == [True, True, True, False, False, True]
    assert ct.mi.tolist() == [False, True, False, False, False, False]
    assert ct.hmi.tolist() == [False, False, True, False, False, False]
    assert ct.failure.tolist() == [False, False, True, True, False, False]
    assert ct.false_alert.tolist() == [False, False, False, False, True, False]
    assert events.at.false_alert.tolist() == [False, False, False, True, True, False]
    assert events.false_alert.tolist() == [False, False, False, False, True, False]
    assert (int(events.mi.sum()), int(events.hmi.sum()), int(events.available.sum())) == (1, 1, 4)
    counts = ct.counts()
    assert (counts["mi"], counts["hmi"], counts["failure_events"]) == (1, 1, 1)
    assert ct.rates()["hmi"] == pytest.approx(1 / 6)
    json.dumps(events.summary(), allow_nan=False)


@pytest.mark.parametrize(
    ("alert", "expected"),
    [
        ("........", "....##.."),  # never alerted: ages 0, 0.5, 1.0 are within the TTA of 1 s
        ("...#....", "........"),  # one alert within the TTA answers the failure
        ("#.......", "....##.."),  # an alert that ended before the onset does not count
        ("....#...", "........"),  # just late, but no epoch was silent beyond the TTA
        (".....#..", "....#..."),
    ],
)
def test_integrity_failure_needs_silence_beyond_the_tta(alert: str, expected: str) -> None:
    events = find_events(record([0, 2, 2, 2, 2, 2, 0, 2], [0.5] * 8, alert), 1.0, 1.0, time_to_alert_s=1.0)
    shifted = "".join("#" if flag else "." for flag in events.ct.integrity_failure)
    assert shifted == expected


def test_running_age() -> None:
    active = np.array([False, True, True, False, True, True, True])
    assert running_age_s(np.arange(7) * 0.1, active).tolist() == pytest.approx([-1, 0, 0.1, -1, 0, 0.1, 0.2])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_streaming_clock_equals_batch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, B, dt, tta = 40, 5, 0.1, 0.35
    error, alert = rng.choice([0.1, 2.0], (T, B), p=[0.3, 0.7]), rng.random((T, B)) < 0.15
    constant: NDArray[np.float64] = np.full((T, B), 0.5)
    drive = Record(
        np.arange(T) * dt, np.ones((T, B), dtype=int), constant * 0, error, constant, constant, alert, ~alert
    )
    expected = find_events(drive, 1.0, 1.0, tta).ct.integrity_failure
    clock = FailureClock.initial(B)
    found = [clock.advance(error[t] > 1.0, alert[t], dt, tta) for t in range(T)]
    assert np.array_equal(np.array(found), expected)


def test_clock_measures_the_time_to_alert() -> None:
    clock = FailureClock.initial(1)
    before = clock.copy()
    yes, no = np.array([True]), np.array([False])
    for alert in (no, no, yes, no):
        clock.advance(yes, alert, 0.1, 1.0)
    assert clock.tta_s[0] == pytest.approx(0.2)
    clock.advance(no, no, 0.1, 1.0)
    assert (clock.tta_s[0], clock.age_s[0], before.age_s[0]) == (np.inf, -1.0, -1.0)


def test_delay_from_fault_onset() -> None:
    alert = np.array([c == "#" for c in "..#....##."])
    delays = alert_delays(np.arange(10.0), alert, [0.0, 2.0, 3.5, 9.0, 4.0], [9.0, 9.0, 9.0, 9.0, 6.0])
    assert delays.tolist() == [2.0, 0.0, 3.5, np.inf, np.inf]
    with pytest.raises(InputError, match="alert"):
        alert_delays(np.arange(10.0), alert[:5], 0.0)


def test_record_refuses() -> None:
    good = record([0.1, 0.2], [0.5, 0.5])
    fields = vars(good)
    for change, name in [
        ({"time_s": np.array([0.0, 0.0])}, "time_s"),
        ({"error_at_m": np.array([np.nan, 0.0])}, "error_at_m"),
        ({"pl_ct_m": np.array([np.nan, 1.0])}, "pl_ct_m"),
        ({"pl_at_m": np.array([-1.0, 1.0])}, "pl_at_m"),
        ({"mode": np.ones(3)}, "mode"),
    ]:
        with pytest.raises(InputError, match=name):
            Record(**(fields | change))
    with pytest.raises(InputError, match="axis"):
        good.error("up")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="al_m"):
        classify([0.0], [1.0], 0.0)
