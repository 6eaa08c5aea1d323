"""From rows to figures: closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from benchmarks import made_up_outcome, made_up_rows, made_up_suite

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.outcome import LEVEL_MAX_M, MANOEUVRE_S
from lanebound.agents.benchmark.scoring import fault_figures, outcome_of, outcome_of_statistics
from lanebound.agents.learning.evaluation import JUDGED
from lanebound.envs import make_config
from lanebound.envs.costs import GROUPS
from lanebound.envs.episode_totals import EpisodeTotals
from lanebound.envs.info import FAULT_INFO
from lanebound.envs.observation.config import ObservationConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.fault_registry import fault_kinds

DT_S = 0.2


def rows(steps: int, **columns: list[float] | list[bool] | list[str] | float | bool) -> list[dict]:
    """Plain rows with some columns given, for all steps or one by one, the start first."""
    base = made_up_rows(made_up_outcome(next(made_up_suite().tasks()), steps=steps))
    plain = {"err_at_m": 0.0, "err_ct_m": 0.0, "alert": False, "available": True, "pl_at_m": 0.3, "pl_ct_m": 0.2,
             "crashed": False, "terminated": False}  # fmt: skip
    made = [row | plain | {"seed": 1, "truncated": k == steps, "is_success": k == steps} for k, row in enumerate(base)]
    for name, values in columns.items():
        for k, row in enumerate(made):
            row[name] = values[k] if isinstance(values, list) else values
    return made


def test_motion_by_closed_forms():
    t = DT_S * np.arange(51)
    accelerating = outcome_of(rows(50, speed_mps=(10.0 + 1.5 * t).tolist()), 10.0)
    assert accelerating.rms_acceleration_mps2 == pytest.approx(1.5)
    assert accelerating.rms_jerk_mps3 == pytest.approx(0.0, abs=1e-9)
    turning = outcome_of(
        rows(50, speed_mps=10.0, true_heading_rad=np.angle(np.exp(1j * (3.0 + 0.1 * t))).tolist()), 10.0
    )
    assert turning.rms_lateral_mps2 == pytest.approx(1.0)  # across the jump from pi to -pi too
    circle = outcome_of(rows(50, true_x_m=(3 * t).tolist(), true_y_m=(4 * t).tolist()), 10.0)
    assert circle.distance_m == pytest.approx(50.0)
    assert circle.throughput_mps == pytest.approx(5.0)


def test_an_episode_cut_short_has_less_throughput():
    fell = rows(50, speed_mps=10.0, true_y_m=0.0, is_success=False)
    assert outcome_of(fell, 40.0).throughput_mps == pytest.approx(100.0 / 40.0)
    arrived = rows(50, speed_mps=10.0, true_y_m=0.0)
    assert outcome_of(arrived, 40.0).throughput_mps == pytest.approx(10.0)


def test_gaps_count_where_somebody_is_ahead():
    assert outcome_of(rows(4, gap_m=[math.inf, 10.0, 12.0, 20.0, math.inf]), 1.0).gap_m == 12.0
    assert outcome_of(rows(4, gap_m=math.inf), 1.0).gap_m is None


def test_a_level_that_is_missing_counts_as_the_largest():
    levels = [0.0, 1.0, math.inf, math.inf, 2.0]
    found = outcome_of(rows(4, pl_at_m=levels, err_at_m=[9.0, -1.0, 2.0, -3.0, 4.0]), 1.0)
    assert found.pl_at_median_m == LEVEL_MAX_M == ObservationConfig().pl_max_m
    assert found.no_level == 0.5
    assert (found.pe_at_median_m, found.pe_at_max_m) == (2.5, 4.0)
    never, wide = outcome_of(rows(4, pl_at_m=math.inf), 1.0), outcome_of(rows(4, pl_at_m=20.0), 1.0)
    assert never.pl_at_median_m == wide.pl_at_median_m == LEVEL_MAX_M
    assert (never.no_level, wide.no_level) == (1.0, 0.0)


def test_alerts_and_continuity():
    on = [False, True, False, True, True]
    found = outcome_of(rows(4, alert=on, available=[not x for x in on]), 1.0)
    assert found.alerts == 2
    assert found.alert_share == 0.75
    assert found.continuity == 0.0  # the one available step is followed by one that is not
    assert outcome_of(rows(4, available=False), 1.0).continuity == 0.0


def test_an_alert_that_never_comes_is_later_than_any_that_comes():
    over = [0, 0, 1, 1, 1, 1, 0]
    late = outcome_of(rows(6, err_ct_m=over, alert=[False] * 5 + [True] * 2), 2.0)
    assert late.time_to_alert_s == pytest.approx(3 * DT_S)
    never = outcome_of(rows(6, err_ct_m=over, alert=False), 2.0)
    assert never.time_to_alert_s == pytest.approx(4 * DT_S)  # as long as it lasted
    assert (late.missed_alerts, never.missed_alerts) == (0, 1)
    lasting = outcome_of(rows(6, err_ct_m=[0, 0, 0, 0, 0, 1, 1], alert=False), 2.0)
    assert (lasting.time_to_alert_s, lasting.missed_alerts) == (pytest.approx(2 * DT_S), 1)
    after = outcome_of(rows(6, err_ct_m=[0, 0, 1, 0, 0, 0, 0], alert=[False] * 4 + [True] * 3), 2.0)
    assert (after.time_to_alert_s, after.missed_alerts) == (pytest.approx(DT_S), 1)
    nothing = outcome_of(rows(6), 2.0)
    assert (nothing.time_to_alert_s, nothing.missed_alerts) == (None, 0)


def test_the_latest_alert_and_failures_longer_than_the_time_to_alert():
    """Two errors above their limits: one is alerted after 0.4 s, one never ends within 1.2 s; a third lasts 1 s."""
    over = [0, 1, 1, 1, 0, 1, 1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1, 0]
    alert = [False, False, False, True, *[False] * 14]
    found = outcome_of(rows(17, err_at_m=[2.0 * x for x in over], alert=alert), 5.0)
    assert found.time_to_alert_s == pytest.approx(np.mean([0.4, 1.2, 1.0]))
    assert found.time_to_alert_max_s == pytest.approx(1.2)
    assert (found.missed_alerts, found.integrity_failures) == (2, 1)
    late = outcome_of(rows(17, err_at_m=[2.0 * x for x in over], alert=[k == 12 for k in range(18)]), 5.0)
    assert (late.missed_alerts, late.integrity_failures) == (2, 1)
    assert outcome_of(rows(17), 5.0).integrity_failures == 0


def test_continuity_is_that_of_manoeuvres_that_begin_without_an_alert():
    """Steps 1 to 60 of 0.2 s; an alert at step 41 is within 5 s of steps 16 to 40, and 35 is the last to begin at."""
    alert = [k == 41 for k in range(61)]
    assert MANOEUVRE_S == 5.0
    found = outcome_of(rows(60, alert=alert, available=True), 12.0)
    assert found.manoeuvre_continuity == pytest.approx(15 / 35)
    at_the_start = [k <= 5 for k in range(61)]  # these steps begin no manoeuvre, and no other meets an alert
    assert outcome_of(rows(60, alert=at_the_start), 12.0).manoeuvre_continuity == 1.0
    assert outcome_of(rows(60, alert=True), 12.0).manoeuvre_continuity is None
    assert outcome_of(rows(24, alert=False), 12.0).manoeuvre_continuity is None, "too short for a manoeuvre"


def test_the_first_fix_is_the_first_position_by_satellites():
    modes = ["imu_odometer", "doppler", "doppler", "sbas_l1", "rtk"]
    assert outcome_of(rows(4, mode=modes), 1.0).first_fix_s == pytest.approx(3 * DT_S)
    assert outcome_of(rows(4, mode=["rtk", *modes[1:]]), 1.0).first_fix_s == 0.0
    assert outcome_of(rows(4, mode="doppler"), 1.0).first_fix_s == pytest.approx(4 * DT_S), "as long at least"


def test_errors_are_given_at_50_75_and_95_percent():
    """Of 101 errors of 0 to 10 m in steps of 0.1 m the quantiles are their shares."""
    errors = np.random.default_rng(2).permutation(np.linspace(0.0, 10.0, 101)) * np.resize([1.0, -1.0], 101)
    found = outcome_of(rows(101, err_ct_m=[99.0, *errors.tolist()]), 30.0)
    assert (found.pe_ct_median_m, found.pe_ct_p75_m, found.pe_ct_p95_m) == pytest.approx((5.0, 7.5, 9.5))
    assert metric_named("pe_ct_p95").take(found) == pytest.approx(9.5)


def test_an_alert_counts_as_one_after_a_fault_if_it_begins_after_the_onset():
    place = [kind.name for kind in fault_kinds()].index("jamming")
    info = dict.fromkeys(FAULT_INFO, 0.25) | {"fault_kind": float(place), "fault_onset_s": 0.5}
    before = [True, True, True, True, False, True, False]
    found = fault_figures(rows(6, alert=before), info)
    assert (found["fault_kind"], found["fault_weight"], found["fault_onset_s"]) == ("jamming", 0.25, 0.5)
    assert found["fault_alert_s"] == pytest.approx(5 * DT_S - 0.5)
    assert fault_figures(rows(6, alert=[False] * 2 + [True] * 5), info)["fault_alert_s"] is None, "it was on before"
    assert fault_figures(rows(6), info)["fault_alert_s"] is None
    assert fault_figures(rows(6), {"alert": False}) == {}, "without faults: one"


def test_departures_are_those_of_the_true_body():
    assert outcome_of(rows(3, cost_lane=[0.0, 0.0, 1e-3, 0.0]), 1.0).lane_departure
    assert not outcome_of(rows(3), 1.0).lane_departure


def test_an_agent_that_fails_at_once_has_no_shares():
    found = outcome_of(rows(4)[:1], 40.0)
    assert (found.steps, found.availability, found.mode_shares) == (0, None, {})


def test_statistics_of_the_engine_give_the_metrics_of_rows():
    """Without the rows the way is the speed times the time."""
    driven = rows(50, speed_mps=10.0, true_y_m=0.0, cost_lane=[0.0] * 40 + [0.1] * 11, cost=0.5, crashed=True)
    changes = {
        "cost": dict.fromkeys(("blocking", "speeding", "overcharge", "undercharge"), 1.0),
        "cost_limits": dict.fromkeys(GROUPS, 1.0),
    }
    config = make_config("lanebound/LaneKeeping-v0", changes)
    wanted = outcome_of(driven, 40.0, config=config)
    totals = EpisodeTotals(1)
    for row in driven[1:]:
        totals.add(row["reward"], row | {"mode": int(next(mode for mode in Mode if mode.key == row["mode"]))})
    statistics = totals.report(0, True)
    more = {"time_s": wanted.time_s, "allotted_s": 40.0}
    found = outcome_of_statistics(driven[-1], statistics, wanted.task, config, **more)
    for key in JUDGED:
        metric = metric_named(key)
        extra = wanted.cost / 51 if key == "cost" else 0.0  # of the start, which statistics leave out
        assert metric.take(found) + extra == pytest.approx(metric.take(wanted)), key


def test_costs_of_groups_are_held_against_their_limits():
    """3 steps of 1 m2 beyond the lane at a weight of 2 are 6; the levels beyond it add 3 x 4 at a weight of 0.5."""
    driven = rows(2, cost_lane=1.0, cost_lane_integrity=4.0, cost_alert=2.0, cost=5.0)
    weights = {"lane": 2.0, "lane_integrity": 0.5, "alert": 0.25}

    def taken(key: str, limit: float = 15.0, **limits: float) -> float | None:
        changes = {"cost": weights, "cost_limit": limit, "cost_limits": limits}
        return metric_named(key).take(outcome_of(driven, 1.0, config=make_config("lanebound/LaneKeeping-v0", changes)))

    outcome = outcome_of(driven, 1.0, config=make_config("lanebound/Highway-v0", {"cost_limits": {"alert": 1.0}}))
    assert (outcome.cost_limits, outcome.group_costs) == ({"alert": 1.0}, {"alert": 0.5 * 6.0})
    assert outcome.flat()["cost_limit_alert"] == 1.0
    assert outcome.flat()["group_cost_alert"] == 3.0
    assert [taken("over_lane_limit", lane=limit) for limit in (11.9, 12.0)] == [1.0, 0.0]
    assert [taken("over_alert_limit", alert=limit) for limit in (1.4, 1.5)] == [1.0, 0.0]
    assert taken("over_hmi_limit", lane=1.0) is taken("over_lane_limit") is taken("within_all_limits") is None
    assert taken("within_all_limits", lane=12.0, alert=1.5) == 1.0
    assert taken("within_all_limits", lane=12.0, alert=1.4) == 0.0
    assert taken("within_all_limits", limit=14.9, lane=12.0) == 0.0


def test_an_agent_that_failed_kept_no_limit():
    config = make_config("lanebound/LaneKeeping-v0", {"cost_limits": {"lane": 1.0}})
    failed = outcome_of([], 1.0, config=config, status="raised")
    assert metric_named("over_lane_limit").take(failed) is metric_named("within_all_limits").take(failed) is None
