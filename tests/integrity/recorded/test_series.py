"""Times of recorded series: what is kept, counted and refused; leap seconds; weeks that end."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import Stop, in_order, leap_seconds, notes, require_degrees, unrolled

TIME = 0.01 * np.arange(1000)


def test_ascending_times_are_kept_and_say_nothing() -> None:
    keep, timing = in_order("log", TIME)
    assert keep.all()
    assert (timing.rows, timing.left_out, timing.note) == (1000, 0, "")
    assert not timing.bridged(TIME).any()
    assert in_order("log", np.zeros(0))[1].note == ""


def test_rows_that_go_back_or_repeat_are_left_out_and_counted() -> None:
    stray = TIME.copy()
    stray[[300, 600]] = stray[[298, 590]]  # a time twice, and one that goes back
    stray[800] = 0.001  # one time that is far behind is no clock that was set back
    keep, timing = in_order("log", stray)
    assert np.flatnonzero(~keep).tolist() == [300, 600, 800]
    assert timing.note == "3 of 1000 rows left out that are not later than one before"
    joined = np.concatenate([TIME, TIME[-50:], TIME[-1] + 0.01 + TIME])  # 50 rows twice
    keep, timing = in_order("log", joined)
    assert timing.left_out == 50
    assert (np.diff(joined[keep]) > 0.0).all()


def test_rows_that_are_there_twice_are_left_out_however_many_and_others_of_their_time_are_not() -> None:
    rows = np.stack([TIME, np.sin(TIME), np.full(1000, np.nan)], -1)
    for twice in (np.repeat(rows, 2, axis=0), np.concatenate([rows, rows])):
        keep, timing = in_order("log", twice[:, 0], rows=twice)
        np.testing.assert_array_equal(twice[keep], rows)
        assert timing.note == "1000 of 2000 rows left out that repeat another"
    coarse = np.floor(TIME)
    with pytest.raises(
        InputError, match=r"990 of 1000 rows repeat a time with other values, row 2 first: .* more digits"
    ):
        in_order("log", coarse, rows=np.stack([coarse, TIME], -1))
    with pytest.raises(InputError, match="999 of 1000 rows go back"):
        in_order("log", TIME[::-1], rows=rows[::-1])


def test_rows_of_one_epoch_are_kept() -> None:
    times = np.repeat([0.0, 0.2, 0.4, 0.2, 0.6, 0.8], [5, 5, 5, 1, 5, 5])
    keep, timing = in_order("codes", times, repeated=True)
    assert np.flatnonzero(~keep).tolist() == [15]
    assert (timing.left_out, len(timing.gaps_s)) == (1, 0)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (TIME[::-1], "999 of 1000 rows go back, row 2 by 0.010 s: sort the rows"),
        (np.where(np.arange(1000) == 100, 1e5, TIME), "899 of 1000 rows go back, row 102"),
        (np.where(np.arange(1000) >= 960, TIME - 3.003, TIME), "40 of 1000 rows go back, row 961 by 2.993 s"),
    ],
)
def test_disorder_and_a_clock_that_is_set_back_are_refused(times: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        in_order("log", times)


@pytest.mark.parametrize(("rate_hz", "step_s", "gaps"), [
    (100.0, 0.5, 1), (100.0, 0.15, 0), (5.0, 0.3, 0), (5.0, 0.7, 1), (4.0, 0.75, 1), (1.0, 1.4, 0), (1.0, 2.0, 1),
    (0.1, 10.9, 0), (0.1, 20.0, 1),
])  # fmt: skip
def test_gaps_are_counted_by_the_rate_of_the_series(rate_hz: float, step_s: float, gaps: int) -> None:
    time = np.arange(100) / rate_hz
    time[50:] += step_s - 1.0 / rate_hz
    _, timing = in_order("log", time)
    assert len(timing.gaps_s) == gaps
    assert timing.bridged(np.array([0.5 * (time[49] + time[50])]))[0] == bool(gaps)
    assert timing.bridged(time).sum() == 0  # the rows beside a gap are recorded
    assert timing.bridged(time, 0.01 + 1.0 / rate_hz, 0.01 + 1.0 / rate_hz).sum() == 4 * gaps
    assert ("1 gap, the longest of" in timing.note) == bool(gaps)


def test_rows_that_are_missing_in_short_holes_are_told_with_their_share() -> None:
    assert in_order("log", TIME[np.arange(1000) % 20 > 8])[1].note == "45 % of its rows are missing in short holes"
    assert in_order("log", TIME[np.arange(1000) % 20 > 0])[1].note == ""


def test_notes_are_of_what_has_any() -> None:
    _, back = in_order("a", np.array([*TIME, 0.0]))
    _, good = in_order("b", TIME)
    found = notes(("a", Stop(3, "cut"), back), ("b", None, good))
    assert found == {"a": "stopped at line 3: cut; 1 of 1001 rows left out that are not later than one before"}


def test_leap_seconds_at_known_days() -> None:
    day = np.array(["1980-01-06", "2006-01-01", "2016-12-31", "2017-01-01", "2026-11-26"], "datetime64[s]")
    seconds = (day - np.datetime64("1980-01-06")).astype(np.float64)
    assert leap_seconds(seconds).tolist() == [0.0, 14.0, 17.0, 18.0, 18.0]


def test_times_of_week_go_on_beyond_its_end() -> None:
    assert unrolled(np.array([604_799.0, 604_799.5, 0.0, 0.5])).tolist() == [604_799.0, 604_799.5, 604_800.0, 604_800.5]


def test_elevations_in_radians_are_named() -> None:
    degrees = np.linspace(5.0, 85.0, 40)
    require_degrees("elevations", degrees)
    require_degrees("elevations", np.radians(degrees[:5]))  # too few to know
    with pytest.raises(InputError, match=r"must be in degrees, the largest of 40 is 1\.48: are they in radians"):
        require_degrees("elevations", np.radians(degrees))
