"""Integrity given one fault in each episode (``faults: one``), and what it means at nominal rates of faults.

Each kind is drawn equally often, so that rare ones show what they do; the weights of the episodes say how often each
kind occurs (:func:`~lanebound.integrity.sensors.campaign.single_fault`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.outcome import Outcome, Place
from lanebound.agents.benchmark.statistics import Estimate, estimate
from lanebound.integrity.assessment.accuracy import clopper_pearson

__all__ = ["GIVEN_FAULT", "RATES", "FaultCell", "FaultRate", "fault_cells", "fault_rates"]

RATES = ("any_mi", "any_hmi", "any_missed", "alert_after_fault")
GIVEN_FAULT = (*RATES, "hmi", "cost_hmi", "time_to_alert", "alert_delay")
"""Keys of the metrics that are reported by kind of fault."""
ONE, NONE = "one", "none"
LEVEL = 0.05


@dataclass(frozen=True)
class FaultCell:
    """An agent at a place, given one fault of a kind: estimates over its episodes by the keys of the metrics.

    ``share`` is the probability of the kind at nominal rates, given exactly one fault.
    """

    env: str
    sky: str
    agent: str
    kind: str
    episodes: int
    share: float
    metrics: dict[str, Estimate]


@dataclass(frozen=True)
class FaultRate:
    """A share of episodes at nominal rates of faults of the ego and of what it shares, with 95 % intervals.

    Attributes
    ----------
    env, sky, agent, metric : whose share it is
    given_one, low, high : given exactly one fault, ``E[weight X | one]``: the mean of each kind times its probability.
        Ends are those of Clopper and Pearson by kind at ``1 - 0.05 / kinds``, summed alike: no more than 5 % are wrong
    probability : P1, of exactly one fault in an episode
    total, total_low, total_high : ``P0 E[X | none] + P1 E[weight X | one]``; None unless the suite has ``none`` too.
        Ends add those of both, at 97.5 % each
    unseen : ``1 - P0 - P1``, by which episodes with two faults or more may raise the total
    """

    env: str
    sky: str
    agent: str
    metric: str
    given_one: float
    low: float
    high: float
    probability: float
    total: float | None
    total_low: float | None
    total_high: float | None
    unseen: float


Groups = Mapping[tuple[Place, str], Sequence[Outcome]]


def fault_cells(groups: Groups) -> list[FaultCell]:
    """A cell for each agent, place and kind of fault, in the order of the groups; kinds likely at nominal rates first.

    groups : outcomes by place and agent; places without ``faults: one`` are left out.
    """
    found = []
    for (place, agent), outcomes in groups.items():
        kinds = _by_kind(outcomes) if place.faults == ONE else {}
        shares = _shares(kinds)
        for kind in sorted(kinds, key=lambda name: -shares[name]):
            metrics = {key: _estimate(key, kinds[kind]) for key in GIVEN_FAULT}
            cell = FaultCell(place.env, place.sky, agent, kind, len(kinds[kind]), shares[kind], metrics)
            found.append(cell)
    return found


def fault_rates(groups: Groups) -> list[FaultRate]:
    """Rates at nominal rates of faults, of each agent and place with ``faults: one``.

    groups : outcomes by place and agent; those with ``faults: none`` at the same place are episodes without a fault.
    """
    found = []
    for (place, agent), outcomes in groups.items():
        kinds = _by_kind(outcomes) if place.faults == ONE else {}
        if kinds:
            without = groups.get((place._replace(faults=NONE), agent), ())
            found += [_rate(place, agent, key, kinds, without) for key in RATES]
    return found


def _by_kind(outcomes: Iterable[Outcome]) -> dict[str, list[Outcome]]:
    """The episodes of each kind; a failed agent shows nothing about integrity."""
    kinds: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        if outcome.fault_kind is not None and not outcome.failed:
            kinds[outcome.fault_kind].append(outcome)
    return kinds


def _shares(kinds: Mapping[str, Sequence[Outcome]]) -> dict[str, float]:
    """Probability of each kind given one fault: its mean weight over the sum of all; kinds not met are left out."""
    weights = {kind: fmean(o.fault_weight or 0.0 for o in outcomes) for kind, outcomes in kinds.items()}
    total = sum(weights.values())
    return {kind: weight / total for kind, weight in weights.items()}


def _values(key: str, outcomes: Iterable[Outcome]) -> np.ndarray:
    take = metric_named(key).take
    return np.array([value for o in outcomes if (value := take(o)) is not None], dtype=np.float64)


def _estimate(key: str, outcomes: Iterable[Outcome]) -> Estimate:
    metric = metric_named(key)
    return estimate(_values(key, outcomes), metric.rate, metric.bounds)


def _rate(
    place: Place, agent: str, key: str, kinds: Mapping[str, Sequence[Outcome]], without: Sequence[Outcome]
) -> FaultRate:
    shares, values = _shares(kinds), {kind: _values(key, outcomes) for kind, outcomes in kinds.items()}
    given = sum(shares[kind] * float(values[kind].mean()) for kind in kinds)
    p1, p0 = (
        fmean(getattr(o, name) for those in kinds.values() for o in those)
        for name in ("fault_probability", "no_fault_probability")
    )
    ends, fault_free = _ends(shares, values, LEVEL), _values(key, without)
    total, total_low, total_high = None, None, None
    if fault_free.size:
        count, half = int(fault_free.sum()), 0.5 * LEVEL
        none = clopper_pearson(count, fault_free.size, 1.0 - half)
        one = _ends(shares, values, half)
        total = p0 * count / fault_free.size + p1 * given
        total_low, total_high = p0 * none[0] + p1 * one[0], p0 * none[1] + p1 * one[1]
    who = place.env, place.sky, agent, key
    return FaultRate(*who, given, *ends, p1, total, total_low, total_high, 1.0 - p0 - p1)


def _ends(shares: Mapping[str, float], values: Mapping[str, np.ndarray], level: float) -> tuple[float, float]:
    """Ends of a sum over kinds; the level is split among them, so that all hold together."""
    by_kind = {
        kind: clopper_pearson(int(those.sum()), those.size, 1.0 - level / len(values)) for kind, those in values.items()
    }
    low, high = (sum(shares[kind] * ends[side] for kind, ends in by_kind.items()) for side in (0, 1))
    return low, high
