"""The context monitor beside a navigator: reports, alerts, snapshots, new vehicles, and its map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lanebound.integrity import Fault, FaultSchedule, Navigator, NavigatorConfig, SkyMask, SkyTrack, truth_between
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.monitoring.context.monitor import ContextReason, Light
from lanebound.integrity.navigators.context_guard import ContextGuard, ContextGuardConfig, Judged, judged_position
from lanebound.integrity.navigators.solution import ContextReport, Solution
from lanebound.integrity.positioning.map_matching.generators import MapBuilder
from lanebound.integrity.positioning.map_matching.road_map import RoadMap

DT, SPEED = 0.5, 10.0
LIMIT_M = 6.95  # amid the levels of codes under an open sky
KNOWN = 22  # epochs until the average of ten seconds is known


def cross() -> RoadMap:
    """A street to the North through the origin, and one to the East."""
    builder = MapBuilder()
    middle = builder.node(0.0, 0.0)
    for east, north in ((0.0, -500.0), (0.0, 500.0), (500.0, 0.0)):
        builder.street(middle, builder.node(east, north), limit_mps=13.9)
    return builder.build()


def navigator_of(seeds: list[int], faults: tuple[Fault, ...] = (), **context: object) -> Navigator:
    context = {"judges": "codes", **context}
    config = NavigatorConfig.load({"kind": "monitored_codes", "dt_s": DT, "context": context})
    track = SkyTrack.from_config(config.sky, 120.0)
    made = Navigator(config, track, SkyMask.open(), seeds, faults=FaultSchedule(faults))
    made.use_map(cross())
    return made


def drive(navigator: Navigator, epochs: int, first: int = 0) -> list[Solution]:
    """Solutions of vehicles that drive to the North."""
    batch = navigator.batch
    velocity, heading = np.tile([0.0, SPEED], (batch, 1)), np.zeros(batch)
    found = []
    for k in range(first, first + epochs):
        before, after = (np.column_stack([np.zeros(batch), np.full(batch, SPEED * DT * i)]) for i in (k, k + 1))
        truth = truth_between((k + 1) * DT, DT, (before, after), (velocity, velocity), (heading, heading))
        found.append(navigator.step(truth))
    return found


def report(solution: Solution) -> ContextReport:
    assert solution.context is not None
    return solution.context


def test_a_verdict_a_second_from_collecting_to_trusted() -> None:
    found = [report(s) for s in drive(navigator_of([1, 2]), KNOWN + 5)]
    reasons = np.array([r.reason for r in found])
    assert (reasons[: KNOWN - 1] == ContextReason.COLLECTING.code).all()
    assert (reasons[KNOWN - 1 :] == ContextReason.TRUSTED.code).all()
    changed = np.flatnonzero((np.diff([r.context_phases for r in found], axis=0) != 0).any(-1)) + 1
    assert set(changed % 2) == {1}  # at whole seconds
    last = found[-1]
    assert not last.context_warning.any()
    assert (last.context_phases == 3).all()
    assert (last.context_score >= 85.0).all()
    assert (last.light == Light.GREEN).all()
    road_map = cross()
    assert (road_map.kind[last.link] >= 0).all()
    assert len(set(last.link.tolist())) == 1  # the link to the North


def test_wheels_that_slip_are_red_and_alert_only_where_asked() -> None:
    """The speed phase sees wheels that turn too fast by Doppler."""
    fault = Fault(kind="wheel_slip", start_s=12.0, duration_s=30.0, magnitude_ratio=0.4)
    quiet, loud = (navigator_of([1], (fault,), alerts=on, warns_at="red") for on in (False, True))
    silent, heard = drive(quiet, 40), drive(loud, 40)
    warned = np.array([report(s).context_warning[0] for s in heard])
    assert warned[-1]
    assert report(heard[-1]).reason[0] == ContextReason.SPEED_FAULT.code
    assert [report(s).context_warning[0] for s in silent] == warned.tolist()
    assert all(s.alert[0] and not s.available[0] for s, w in zip(heard, warned, strict=True) if w)
    for a, b, w in zip(silent, heard, warned, strict=True):
        assert a.pl_at_m[0] == b.pl_at_m[0]  # levels are not touched
        assert b.alert[0] == (a.alert[0] or w)
        if w and not a.alert[0]:
            assert b.reason[0] == AlertReason.CONTEXT_WARNING.code


def test_an_odometer_that_freezes_at_a_stop_is_red_when_the_car_drives_off() -> None:
    """Driven until 34 s, at rest until 42 s, frozen from 40 s on; red needs two verdicts after 2 m/s."""
    fault = Fault(kind="odometer_frozen", start_s=40.0, duration_s=80.0)
    navigator, place, speed, lights = navigator_of([1], (fault,), alerts=True, warns_at="red"), 0.0, SPEED, {}
    for k in range(130):
        time = (k + 1) * DT
        braked = max(0.0, SPEED - 2.5 * max(time - 28.0, 0.0))
        later = braked if time < 42.0 else min(SPEED, 2.0 * (time - 42.0))
        there = place + 0.5 * DT * (speed + later)
        truth = truth_between(
            time, DT, (np.array([[0.0, place]]), np.array([[0.0, there]])),
            (np.array([[0.0, speed]]), np.array([[0.0, later]])), (np.zeros(1), np.zeros(1)),
        )  # fmt: skip
        solution = navigator.step(truth)
        place, speed = there, later
        lights[time] = int(report(solution).light[0]), bool(report(solution).context_warning[0])
    assert {lights[time] for time in np.arange(30.0, 43.5, DT)} == {(int(Light.GREEN), False)}
    assert {lights[time] for time in np.arange(46.0, 65.0, DT)} == {(int(Light.RED), True)}


def test_the_position_that_the_vehicle_uses_is_judged() -> None:
    """Its levels and tests are those of the first phase, and the matched position is its own."""
    risk = {"integrity_risk": 1e-3}
    quiet, limit = {"false_alarm": 1e-3, "satellite_prior": 1e-4}, LIMIT_M
    plain = {"kind": "monitored_codes", "dt_s": DT, "risk": risk, "monitor": {"kind": "separation_fde", **quiet}}
    config = NavigatorConfig.load({**plain, "context": {"position": {"alert_limit_m": limit}}})
    navigator = Navigator(config, SkyTrack.from_config(config.sky, 120.0), SkyMask.open(), [1, 2])
    navigator.use_map(cross())
    found = drive(navigator, KNOWN + 20)
    levels = np.array([s.pl_at_m for s in found])
    reasons = np.array([report(s).reason for s in found])
    due = slice(1, None, 2)  # a verdict a second
    assert ((reasons == ContextReason.UNAVAILABLE.code) == (levels > limit))[due].all()
    assert 0.05 < (levels > limit)[due].mean() < 0.95
    both = judged_position(found[-1], limit)
    np.testing.assert_allclose(both.level_m, np.sqrt(2.0) * levels[-1])


def test_a_failed_test_of_the_navigator_is_a_fault_of_the_position() -> None:
    solution = drive(navigator_of([1, 2]), 4)[-1]
    failed = np.array([AlertReason.INTEGRITY_TEST_FAILED.code, AlertReason.PL_AT.code])
    assert judged_position(replace(solution, reason=failed), 15.0).consistent.tolist() == [False, True]


def test_a_snapshot_goes_on_with_the_same_reports() -> None:
    navigator = navigator_of([4, 5], matching={"kind": "hidden_markov"})
    drive(navigator, 23)
    kept = navigator.snapshot()
    first = [report(s) for s in drive(navigator, 6, 23)]
    navigator.restore(kept)
    again = [report(s) for s in drive(navigator, 6, 23)]
    for a, b in zip(first, again, strict=True):
        for old, new in zip(a, b, strict=True):
            np.testing.assert_array_equal(old, new)


@pytest.mark.parametrize("matcher", ["nearest", "topological", "hidden_markov"])
def test_a_vehicle_that_is_taken_over_goes_on_as_it_was(matcher: str) -> None:
    navigator = navigator_of([7, 8], matching={"kind": matcher})
    other = navigator.another(Streams([9]))
    drive(navigator, 15)
    drive(other, 15)
    kept = other.snapshot()
    navigator.adopt(np.array([1]), other, np.array([0]))
    mine, theirs = navigator.state.guard, kept.guard
    assert mine is not None
    assert theirs is not None
    for part, memory in theirs.monitor.items():
        for name, value in memory.items():
            np.testing.assert_array_equal(mine.monitor[part][name][1], value[0])
    assert mine.epochs[1] == theirs.epochs[0]


def test_a_vehicle_that_is_placed_begins_anew() -> None:
    navigator = navigator_of([1, 2])
    drive(navigator, KNOWN + 3)
    navigator.place(np.zeros((1, 2)), np.zeros(1), sigma_m=0.5, sigma_heading_rad=0.01, rows=np.array([1]))
    guard = navigator.state.guard
    assert guard is not None
    assert guard.last["reason"].tolist() == [ContextReason.TRUSTED.code, ContextReason.COLLECTING.code]
    assert guard.monitor["speed"]["count"].tolist() == [11, 0]


def test_rows_are_independent_and_only_the_chosen_ones_are_monitored() -> None:
    both, alone = drive(navigator_of([7, 8]), 24)[-1], drive(navigator_of([8]), 24)[-1]
    for together, single in zip(report(both), report(alone), strict=True):
        np.testing.assert_allclose(together[1], single[0], rtol=1e-9)
    few = navigator_of([7, 8])
    few.use_map(cross(), one_in=2)
    assert report(drive(few, 24)[-1]).reason.tolist() == [0, ContextReason.COLLECTING.code]


def test_the_map_has_the_configured_errors_in_every_episode() -> None:
    config = ContextGuardConfig.load({"map_errors": {"shift_m": 5.0, "missing": 0.3}, "map_seed": 3})
    one, two = (ContextGuard(config, cross(), DT) for _ in range(2))
    np.testing.assert_array_equal(one.road_map.vertex_en_m, two.road_map.vertex_en_m)
    assert one.road_map.vertex_en_m.shape != cross().vertex_en_m.shape or (
        np.abs(one.road_map.vertex_en_m - cross().vertex_en_m).max() > 0.5
    )
    assert ContextGuard(ContextGuardConfig(), cross(), DT).road_map.links == cross().links


def test_configuration() -> None:
    c = NavigatorConfig.load({"kind": "monitored_codes", "monitor": {"kind": "context", "map": {"threshold": 60.0}}})
    assert c.context is not None
    assert (c.context.alerts, c.context.map.threshold, c.monitor.kind) == (True, 60.0, "weighted")  # type: ignore[attr-defined]
    assert NavigatorConfig.load(c.to_dict()) == c
    plain = NavigatorConfig()
    assert plain.simulated is plain.receiver  # nothing more is simulated
    assert NavigatorConfig.load({"context": {"judges": "codes"}}).simulated.undifferenced
    assert c.context.judges is Judged.CODES
    vehicle = NavigatorConfig.load({"context": {}})
    assert vehicle.simulated is vehicle.receiver
    with pytest.raises(ConfigError, match=r"context\.interval_s must lie in \(0, 60\], got 0"):
        NavigatorConfig.load({"context": {"interval_s": 0}})
    with pytest.raises(ConfigError, match=r"context\.warn_at"):
        NavigatorConfig.load({"context": {"warn_at": "red"}})
    c = NavigatorConfig.load({"kind": "monitored_codes", "dt_s": DT, "context": {}})
    without = Navigator.nominal(c, [1], duration_s=30.0)
    with pytest.raises(InputError, match=r"context .* needs a road map, got none"):
        drive(without, 1)
