"""The metrics by which episodes are compared."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Literal

from lanebound.agents.benchmark.outcome import LEVEL_MAX_M, MANOEUVRE_S, TTA_S, Outcome
from lanebound.envs.costs import CAUSES, GROUPS
from lanebound.integrity.positioning.modes import Mode

__all__ = [
    "ANYTHING", "HARM_OF_AN_END", "MAIN", "METRICS", "SHARE", "Better", "Bounds", "Metric", "harm_of", "metric_named",
    "went_off_road",
]  # fmt: skip

Better = Literal["higher", "lower"] | None
Bounds = tuple[float, float]
ANYTHING: Bounds = (-math.inf, math.inf)
NOT_NEGATIVE: Bounds = (0.0, math.inf)
SHARE: Bounds = (0.0, 1.0)
Take = Callable[[Outcome], float | None]
HARM_OF_AN_END = 50.0
"""Harm of a crash or an end off the road, in square metres beyond the lane; chosen, and no weight of a cost."""


@dataclass(frozen=True)
class Metric:
    """One figure of an episode, whose mean over seeds is reported.

    Attributes
    ----------
    key, title, unit, meaning : the unit of a share is ``""``
    better : good direction; None where it depends
    take : value of an episode; None where it has none: the episode does not count for this metric
    rate : values are 0 or 1
    bounds : of the values
    """

    key: str
    title: str
    unit: str
    better: Better
    meaning: str
    take: Take
    rate: bool = False
    bounds: Bounds = NOT_NEGATIVE


def went_off_road(outcome: Outcome) -> bool:
    """Whether an episode ended off the road or against the traffic."""
    return outcome.costs.get("cost_off_road", 0.0) > 0.0


def harm_of(outcome: Outcome) -> float:
    """Harm of the true car: 50 for a crash or an end off the road, and ``cost_lane`` [m^2].

    It does not depend on protection levels or alerts, nor on the weights of the environments' costs.
    """
    end = outcome.collision or went_off_road(outcome)
    return HARM_OF_AN_END * float(end) + outcome.costs.get("cost_lane", 0.0)


def _plain(key: str, title: str, unit: str, better: Better, meaning: str, name: str = "") -> Metric:
    """An attribute of outcomes; an agent that failed has none."""
    return Metric(key, title, unit, better, meaning, _driven(attrgetter(name or key)))


def _share(key: str, title: str, better: Better, meaning: str, take: Take | None = None) -> Metric:
    """A share of the steps."""
    return Metric(key, title, "", better, meaning, _driven(take or attrgetter(key)), bounds=SHARE)


def _driven(take: Callable[[Outcome], float | None]) -> Take:
    def found(outcome: Outcome) -> float | None:
        value = None if outcome.failed else take(outcome)
        return None if value is None else float(value)

    return found


def _rate(key: str, title: str, better: Better, meaning: str, take: Callable[[Outcome], float | None]) -> Metric:
    return Metric(key, title, "", better, meaning, take, rate=True, bounds=SHARE)


def _cause(cause: str) -> Metric:
    title = cause.replace("_", " ")
    return Metric(cause, title, "", "lower", "unweighted sum of the cost", _driven(lambda o: o.costs.get(cause, 0.0)))


def _over(group: str) -> Metric:
    """Whether the weighted costs of a group exceeded their own limit; None where they have none."""
    return _rate(
        f"over_{group}_limit",
        f"over {group} limit",
        "lower",
        "the weighted costs of this group exceeded its limit in cost_limits",
        _driven(lambda o: float(o.group_costs[group] > o.cost_limits[group]) if group in o.cost_limits else None),
    )


def _within_all_limits(outcome: Outcome) -> float | None:
    """Whether the cost and each group with a limit kept to theirs; None where there is no limit of a group."""
    if outcome.cost_limit is None or not outcome.cost_limits:
        return None
    groups = (outcome.group_costs[group] <= limit for group, limit in outcome.cost_limits.items())
    return float(outcome.cost <= outcome.cost_limit and all(groups))


def _mode(mode: Mode) -> Metric:
    better: Better = "higher" if mode is Mode.RTK else None
    meaning = "share of steps with this mode"
    return _share(
        f"share_{mode.key}", f"{mode.label} share", better, meaning, lambda o: o.mode_shares.get(mode.key, 0.0)
    )


def _share_of_steps(name: str) -> Take:
    return lambda o: getattr(o, name) / o.steps if o.steps else None


def _share_of_decisions(name: str) -> Take:
    """Share of an agent's own count in its decisions, one for each step; None where it counts nothing."""
    return lambda o: None if getattr(o, name) is None or not o.steps else getattr(o, name) / o.steps


def _any(key: str, title: str, meaning: str, name: str) -> Metric:
    """Whether an episode has any of what an attribute counts."""
    return _rate(key, title, "lower", meaning, _driven(lambda o: float(getattr(o, name) > 0) if o.steps else None))


# fmt: off
SAFETY = (
    _rate("success", "success", "higher", "the episode ended well and the agent did not fail",
          lambda o: float(o.success)),
    _rate("collision", "collision", "lower", "the true car crashed", _driven(attrgetter("collision"))),
    _rate("lane_departure", "lane departure", "lower", "the true body left its lane outside commanded lane changes",
          _driven(attrgetter("lane_departure"))),
    _rate("off_road", "off road", "lower", "the episode ended off the road or against the traffic",
          _driven(went_off_road)),
    Metric("harm", "harm", "", "lower",
           f"{HARM_OF_AN_END:g} for a crash or an end off the road, plus the sum of cost_lane (m2 beyond the lane)",
           _driven(harm_of)),
    _rate("over_cost_limit", "over cost limit", "lower",
          "the cost exceeded cost_limit, which was chosen under the sky of the id",
          _driven(lambda o: None if o.cost_limit is None else float(o.cost > o.cost_limit))),
    _rate("success_within_limit", "success within limit", "higher",
          "success at a cost of at most cost_limit; compare it together with the mean speed",
          lambda o: None if o.cost_limit is None else float(o.success and o.cost <= o.cost_limit)),
    *map(_over, GROUPS),
    _rate("within_all_limits", "within all limits", "higher",
          "the cost was at most cost_limit, and each group of causes at most its limit in cost_limits",
          _driven(_within_all_limits)),
    _rate("failed", "failed", "lower", "the agent failed", lambda o: float(o.failed)),
)
REWARD = (
    Metric("return", "return", "", "higher", "sum of rewards", _driven(attrgetter("total_return")), bounds=ANYTHING),
    _plain("cost", "cost", "", "lower", "weighted sum of the costs"),
    *map(_cause, CAUSES),
)
MOTION = (
    Metric("mean_speed", "speed", "m/s", "higher", "mean true speed", _driven(attrgetter("mean_speed_mps")),
           bounds=ANYTHING),
    _plain("throughput", "throughput", "m/s", "higher",
           "distance over the time taken; without success over the longest possible time", "throughput_mps"),
    _plain("gap", "gap", "m", None, "median true gap between bumpers to the vehicle ahead within 100 m", "gap_m"),
    _plain("rms_acceleration", "acceleration", "m/s2", "lower", "root mean square of the acceleration along",
           "rms_acceleration_mps2"),
    _plain("rms_jerk", "jerk", "m/s3", "lower", "root mean square of the jerk along", "rms_jerk_mps3"),
    _plain("rms_lateral", "lateral", "m/s2", "lower", "root mean square of the lateral acceleration",
           "rms_lateral_mps2"),
)
INTEGRITY = (
    *(_plain(f"pl_{axis}_median", f"PL_{axis.upper()}", "m", "lower",
             f"median protection level along (at) and across (ct); at most {LEVEL_MAX_M:g} m, also when missing",
             f"pl_{axis}_median_m")
      for axis in ("at", "ct")),
    _share("no_level", "no level", "lower", "share of steps without a protection level on either axis"),
    _plain("pe_at_median", "error AT", "m", "lower", "median error along (at) and across (ct)", "pe_at_median_m"),
    _plain("pe_ct_median", "error CT", "m", "lower", "median error along (at) and across (ct)", "pe_ct_median_m"),
    *(_plain(f"pe_{axis}_p{share}", f"error {axis.upper()} {share} %", "m", "lower",
             f"{share} % quantile of the error along (at) and across (ct)", f"pe_{axis}_p{share}_m")
      for share in (75, 95) for axis in ("at", "ct")),
    _plain("pe_at_max", "max error AT", "m", "lower", "largest error along (at) and across (ct)", "pe_at_max_m"),
    _plain("pe_ct_max", "max error CT", "m", "lower", "largest error along (at) and across (ct)", "pe_ct_max_m"),
    _share("availability", "availability", "higher", "share of steps with no level above its limit"),
    _share("alert_share", "alert share", "lower", "share of steps with an alert"),
    _plain("alerts", "alerts", "", "lower", "number of alerts"),
    _share("mi", "MI", "lower", "share of steps with misleading but not hazardous information",
           _share_of_steps("mi_steps")),
    _share("hmi", "HMI", "lower", "share of steps with hazardously misleading information",
           _share_of_steps("hmi_steps")),
    _any("any_mi", "any MI", "any step had misleading but not hazardous information", "mi_steps"),
    _any("any_hmi", "any HMI", "any step had hazardously misleading information", "hmi_steps"),
    _plain("time_to_alert", "time to alert", "s", "lower",
           "mean time from an error above its limit to the alert; if no alert comes, to the end of that error",
           "time_to_alert_s"),
    _plain("time_to_alert_max", "latest alert", "s", "lower",
           "the same of the latest alert, which the TTA of S3 II.A limits", "time_to_alert_max_s"),
    _plain("integrity_failures", "integrity failures", "", "lower",
           f"number of errors above their limits for longer than {TTA_S:g} s without an alert (S3 II.C)"),
    _plain("missed_alerts", "missed alerts", "", "lower",
           "number of errors above their limits that ended without an alert"),
    _any("any_missed", "any missed alert", "any missed alert", "missed_alerts"),
    _rate("alert_after_fault", "alert after fault", None,
          "an alert began after the onset of the one fault (faults: one), because of it or not",
          _driven(lambda o: None if o.fault_kind is None else float(o.fault_alert_s is not None))),
    _plain("alert_delay", "alert delay", "s", "lower",
           "time from the onset of the one fault (faults: one) to the first alert that begins after it",
           "fault_alert_s"),
    _share("continuity", "continuity", "higher",
           "share of available steps after which the next one is available; 0 without any"),
    _share("manoeuvre_continuity", "manoeuvre continuity", "higher",
           f"probability that no alert comes within a manoeuvre of {MANOEUVRE_S:g} s that begins without one, over "
           "manoeuvres that begin at any step and end before the episode; of alerts alone (S3 II.A)"),
    _plain("first_fix", "first fix", "s", "lower",
           "time from the start of the episode, after its navigation.warm_up_s, to the first position by satellites "
           "(RTK, code or a service); without one, the time of the episode",
           "first_fix_s"),
    *(_mode(mode) for mode in Mode if not mode.is_service),
    _share("share_service", "service share", None,
           "share of steps with the position of a service other than RTK from one station",
           lambda o: sum(o.mode_shares.get(mode.key, 0.0) for mode in Mode if mode.is_service)),
)
SOLVING = (
    Metric("solve_median", "solve time", "ms", "lower", "median time of a decision",
           _driven(attrgetter("solve_ms_median"))),
    Metric("solve_p99", "solve time 99 %", "ms", "lower", "99 % quantile of the time of a decision",
           _driven(attrgetter("solve_ms_p99"))),
    _share("infeasible", "infeasible", "lower",
           "share of decisions without a command that meets the agent's constraints",
           _share_of_decisions("infeasible")),
    _share("relaxed", "relaxed", "lower",
           "share of decisions for which the agent weakened a constraint",
           _share_of_decisions("relaxed")),
)
# fmt: on
METRICS: tuple[Metric, ...] = (*SAFETY, *REWARD, *MOTION, *INTEGRITY, *SOLVING)
MAIN = (
    "harm", "throughput", "collision", "off_road", "lane_departure", "success", "success_within_limit", "mean_speed",
    "cost", "return", "availability", "any_hmi",
)  # fmt: skip
"""Keys of the metrics of a short table: harm and throughput first, as each alone is easy to improve."""


def metric_named(key: str) -> Metric:
    """The metric of a key."""
    return {metric.key: metric for metric in METRICS}[key]
