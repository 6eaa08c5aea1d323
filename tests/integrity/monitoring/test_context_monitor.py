"""The whole monitor: order of the phases, lights, rest, batch."""

from dataclasses import replace

import numpy as np
import pytest
from code_rows import fix_at

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring.context.code_fix import CodeFix
from lanebound.integrity.monitoring.context.monitor import (
    ContextConfig,
    ContextMonitor,
    ContextReason,
    Light,
    light_of,
)
from lanebound.integrity.positioning.least_squares import Solvability
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

NODES = np.array([(0.0, 0.0), (0.0, 500.0), (0.0, 1000.0)])
SPEED_MPS = 10.0


def road() -> RoadMap:
    """A straight road to the North of two links, both ways; identities 10 to 13."""
    ends = [(0, 1), (1, 2), (1, 0), (2, 1)]
    return RoadMap.of_lines(NODES, ends, [NODES[[a, b]] for a, b in ends], identity=[10, 11, 12, 13])


def follow(monitor: ContextMonitor, epochs: int, batch: int = 1, speed: float = SPEED_MPS, **how):
    """Verdicts of a drive to the North along the road from its start."""
    rng, out = np.random.default_rng(how.pop("seed", 1)), []
    aside = how.pop("aside_m", 0.0)
    wheel = how.pop("wheel_mps", speed)
    for k in range(epochs):
        place = np.tile([aside, 20.0 + speed * k], (batch, 1))
        fix = fix_at(place, np.tile([0.0, speed], (batch, 1)), rng, **how)
        out.append(monitor.step(fix, np.full(batch, wheel)))
    return out


def reasons(verdicts) -> list[str]:
    return [ContextReason.from_code(int(v.reason[0])).name for v in verdicts]


def test_a_good_drive_is_trusted_after_the_first_average() -> None:
    found = follow(ContextMonitor(ContextConfig(), road(), 1, 1.0), 30)
    assert reasons(found) == ["COLLECTING"] * 10 + ["TRUSTED"] * 20
    assert [int(v.phases[0]) for v in found] == [1] * 10 + [3] * 20
    assert {int(v.link[0]) for v in found} == {10}
    assert all(v.score[0] > 71.0 for v in found)
    assert all(v.light[0] == Light.GREEN for v in found[10:])
    assert follow(ContextMonitor(ContextConfig(), road(), 1, 1.0), 70)[-1].link[0] == 11


def test_each_phase_warns_in_the_order_of_the_flow_chart() -> None:
    noisy = follow(ContextMonitor(ContextConfig(), road(), 1, 1.0), 12, code_m=8.0)
    assert reasons(noisy) == ["UNAVAILABLE"] * 12
    config = ContextConfig(speed={"form": "wheel"})
    slipping = follow(ContextMonitor(config, road(), 1, 1.0), 14, wheel_mps=14.0)
    assert reasons(slipping)[-1] == "SPEED_FAULT"
    lost = follow(ContextMonitor(ContextConfig(), road(), 1, 1.0), 14, aside_m=200.0)
    assert reasons(lost)[-1] == "NO_ROAD"
    assert lost[-1].link[0] == NO_LINK
    assert lost[-1].score[0] == 0.0


def test_a_faulty_satellite_and_a_missing_position_are_named() -> None:
    monitor, rng = ContextMonitor(ContextConfig(), road(), 1, 1.0), np.random.default_rng(3)
    fix = fix_at([[0.0, 50.0]], [[0.0, 10.0]], rng)
    wrong = replace(fix.codes, wsse=fix.codes.wsse + 900.0 / 0.7**2)
    assert reasons([monitor.step(CodeFix(wrong, fix.rates), np.array([10.0]))]) == ["POSITION_FAULT"]
    none = replace(fix.codes, status=np.array([Solvability.TOO_FEW.code]))
    verdict = monitor.step(CodeFix(none, fix.rates), np.array([10.0]))
    assert reasons([verdict]) == ["NO_POSITION"]
    assert verdict.light[0] == Light.RED
    assert verdict.phases[0] == 0


@pytest.mark.parametrize("warn_at_rest", [False, True])
def test_at_rest_the_last_verdict_holds_unless_the_flow_chart_is_followed(warn_at_rest) -> None:
    monitor = ContextMonitor(ContextConfig(warn_at_rest=warn_at_rest), road(), 1, 1.0)
    moving = follow(monitor, 20)[-1]
    rng = np.random.default_rng(4)
    place = [[0.0, 20.0 + 19 * SPEED_MPS]]
    standing = [monitor.step(fix_at(place, [[0.0, 0.0]], rng), np.array([0.0])) for _ in range(5)]
    assert reasons(standing) == ["SLOW"] * 5
    assert {bool(v.warn[0]) for v in standing} == {warn_at_rest}
    assert {int(v.link[0]) for v in standing} == {int(moving.link[0])}
    assert {int(v.light[0]) for v in standing} == {int(Light.AMBER if warn_at_rest else Light.GREEN)}
    assert standing[-1].score[0] == moving.score[0]


def test_phases_switched_off_do_not_warn() -> None:
    off = ContextConfig(position_phase=False, speed_phase=False, map_phase=False)
    assert not any(v.warn[0] for v in follow(ContextMonitor(off, road(), 1, 1.0), 12, code_m=8.0, wheel_mps=14.0))


def test_rows_do_not_depend_on_each_other() -> None:
    rng, batch = np.random.default_rng(7), 5
    together = ContextMonitor(ContextConfig(), road(), batch, 1.0)
    alone = [ContextMonitor(ContextConfig(), road(), 1, 1.0) for _ in range(batch)]
    speed = np.array([0.0, 1.0, 8.0, 12.0, 20.0])
    for k in range(15):
        place = np.column_stack([np.linspace(-40.0, 60.0, batch), 20.0 + speed * k])
        fix = fix_at(place, np.column_stack([0.0 * speed, speed]), rng, code_m=2.0)
        found = together.step(fix, speed)
        for v, monitor in enumerate(alone):
            own = monitor.step(CodeFix(fix.codes.take([v]), fix.rates.take([v])), speed[v : v + 1])
            for name in ("warn", "reason", "phases", "link"):
                assert getattr(own, name)[0] == getattr(found, name)[v]
            assert own.score[0] == pytest.approx(found.score[v], abs=1e-9)


def test_vehicles_that_begin_anew_have_no_history() -> None:
    monitor = ContextMonitor(ContextConfig(), road(), 2, 1.0)
    follow(monitor, 15, batch=2)
    monitor.forget(np.array([1]))
    found = follow(monitor, 1, batch=2)[0]
    assert found.reason[1] == ContextReason.COLLECTING.code
    assert found.reason[0] != ContextReason.COLLECTING.code


def test_every_reason_has_a_light() -> None:
    codes = np.array([member.code for member in ContextReason])
    lights = light_of(codes, codes != 0)
    assert lights[0] == Light.GREEN
    assert set(lights[1:]) == {Light.AMBER, Light.RED}
    with pytest.raises(InputError, match=r"dt_s must be > 0 and batch >= 1"):
        ContextMonitor(ContextConfig(), road(), 1, 0.0)


def rest(monitor: ContextMonitor, epochs: int, place, *, speed=0.0, wheel=0.0, seed=5, **how):
    """Verdicts of a car whose wheels say ``wheel``, and which drives to the North at ``speed``."""
    rng, out = np.random.default_rng(seed), []
    for k in range(epochs):
        fix = fix_at([[0.0, place + speed * k]], [[0.0, speed]], rng, **how)
        out.append(monitor.step(fix, np.array([wheel])))
    return out


def test_wheels_that_freeze_at_rest_are_red_once_the_car_moves() -> None:
    """A Doppler speed of 10 m/s beside wheels at rest: an epoch may be noise, two in succession are a fault."""
    monitor = ContextMonitor(ContextConfig(), road(), 1, 1.0)
    follow(monitor, 20)
    standing = rest(monitor, 10, 210.0)
    assert reasons(standing) == ["SLOW"] * 10
    frozen = rest(monitor, 40, 220.0, speed=10.0)
    assert reasons(frozen) == ["SLOW"] + ["SPEED_FAULT"] * 39
    assert all(v.light[0] == Light.RED and v.warn[0] for v in frozen[1:])
    assert frozen[-1].link[0] == 11  # the matcher goes on with Doppler
    again = rest(monitor, 5, 610.0)
    assert [int(v.light[0]) for v in again] == [Light.RED] * 5  # the wheels are as wrong as before
    late = follow(monitor, 30)  # wheels that turn again: the fault leaves the window of the averages
    assert reasons(late)[-1] == "TRUSTED"


def test_one_doppler_error_and_a_crawl_do_not_contradict_rest() -> None:
    monitor = ContextMonitor(ContextConfig(), road(), 1, 1.0)
    follow(monitor, 20)
    for speed in (0.0, 9.0, 0.0, 9.0, 0.0):
        assert reasons(rest(monitor, 1, 210.0, speed=speed)) == ["SLOW"]
    assert reasons(rest(monitor, 20, 210.0, speed=1.9, wheel=1.9)) == ["SLOW"] * 20


def test_without_doppler_rest_is_not_known() -> None:
    monitor = ContextMonitor(ContextConfig(), road(), 1, 1.0)
    follow(monitor, 20)
    fix = fix_at([[0.0, 210.0]], [[0.0, 0.0]], np.random.default_rng(1))
    none = replace(fix.rates, status=np.array([Solvability.TOO_FEW.code]))
    found = monitor.step(CodeFix(fix.codes, none), np.zeros(1))
    assert reasons([found]) == ["COLLECTING"]
    assert found.light[0] == Light.AMBER
    assert reasons([monitor.step(fix, np.zeros(1))]) == ["SLOW"]


def test_a_position_that_fails_at_rest_warns_for_that_epoch_alone() -> None:
    monitor, rng = ContextMonitor(ContextConfig(), road(), 1, 1.0), np.random.default_rng(2)
    follow(monitor, 20)
    found = [
        monitor.step(fix_at([[0.0, 210.0]], [[0.0, 0.0]], rng, code_m=8.0 if k == 2 else 0.7), np.zeros(1))
        for k in range(6)
    ]
    assert reasons(found) == ["SLOW", "SLOW", "UNAVAILABLE", "SLOW", "SLOW", "SLOW"]
    assert [bool(v.warn[0]) for v in found] == [False, False, True, False, False, False]


@pytest.mark.parametrize("warn_at_rest", [False, True])
def test_a_red_verdict_stays_red_and_keeps_its_reason_at_the_stop(warn_at_rest) -> None:
    monitor = ContextMonitor(ContextConfig(warn_at_rest=warn_at_rest), road(), 1, 1.0)
    assert reasons(follow(monitor, 20, wheel_mps=14.0))[-1] == "SPEED_FAULT"
    found = rest(monitor, 4, 210.0)
    assert reasons(found) == ["SPEED_FAULT"] * 4
    assert [int(v.light[0]) for v in found] == [Light.RED] * 4


def test_without_doppler_and_speed_phase_distance_and_wheels_decide() -> None:
    """No heading is no heading to the North, and no Doppler speed is not a speed of 0."""
    monitor = ContextMonitor(ContextConfig(speed_phase=False), to_the_east(), 1, 1.0)
    rng, found = np.random.default_rng(3), []
    for k in range(20):
        fix = fix_at([[20.0 + 10.0 * k, 0.0]], [[10.0, 0.0]], rng)
        none = np.array([Solvability.TOO_FEW.code])
        rates = replace(fix.rates, x_m=0.0 * fix.rates.x_m, status=none)
        found.append(monitor.step(CodeFix(fix.codes, rates), np.array([10.0])))
    assert set(reasons(found)) == {"TRUSTED"}


def to_the_east() -> RoadMap:
    """A straight road of one link."""
    ends = np.array([(0.0, 0.0), (1000.0, 0.0)])
    return RoadMap.of_lines(ends, [(0, 1)], [ends])


def test_the_printed_slope_needs_codes_of_errors_of_their_own() -> None:
    with pytest.raises(ConfigError, match=r"codes\.covariance must be diagonal with position\.printed_slope, got full"):
        ContextConfig(position={"printed_slope": True})
    ContextConfig.load({"position": {"printed_slope": True}, "codes": {"covariance": "diagonal"}})
