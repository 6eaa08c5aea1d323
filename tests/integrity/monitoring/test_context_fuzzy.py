"""The 18 rules of S5 Table 1, one by one, and what the system does between them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.monitoring.context.fuzzy import RuleBase, s5_rules
from lanebound.integrity.monitoring.context.map_phase import MapPhaseConfig

# S5 Table 1: DA, DD, DS, integrity scale
TABLE_1 = [
    ("good", "low", "low", "very_high"), ("good", "low", "average", "very_high"),
    ("good", "average", "low", "very_high"), ("good", "low", "high", "high"), ("good", "average", "average", "high"),
    ("good", "high", "low", "high"), ("good", "average", "high", "average"), ("good", "high", "average", "average"),
    ("good", "high", "high", "low"), ("bad", "low", "low", "low"), ("bad", "low", "average", "low"),
    ("bad", "average", "low", "low"), ("bad", "low", "high", "low"), ("bad", "average", "average", "low"),
    ("bad", "high", "low", "low"), ("bad", "average", "high", "low"), ("bad", "high", "average", "low"),
    ("bad", "high", "high", "low"),
]  # fmt: skip
HEADING_DEG = {"good": 20.0, "bad": 160.0}
DISTANCE_M = {"low": 1.0, "average": 6.0, "high": 15.0}
SPEED_MPS = {"low": 1.0, "average": 7.5, "high": 20.0}
WARNED = 71.0


@pytest.mark.parametrize("number", range(1, 19))
def test_each_rule_fires_alone_and_gives_its_level(number) -> None:
    heading, distance, speed, level = TABLE_1[number - 1]
    rules = s5_rules()
    at = HEADING_DEG[heading], DISTANCE_M[distance], SPEED_MPS[speed]
    strength = rules.strengths(*at)
    assert strength[number - 1] == 1.0
    assert strength.sum() == 1.0
    assert rules.rules[number - 1].rule == number
    assert rules.rules[number - 1].level == level
    score = float(rules.score(*at))
    low, high = {"very_high": (85, 100), "high": (70, 70), "average": (55, 55), "low": (0, 40)}[level]
    assert low <= score <= high
    assert (score >= WARNED) == (level == "very_high")


def test_weights_and_grades_give_the_printed_order_of_levels() -> None:
    """The weighted sum 0.4 / 0.3 / 0.3 alone separates the levels of rules 1 to 9 (the bounds change none of them)."""
    outputs = s5_rules().outputs
    np.testing.assert_allclose(outputs[:9], [100, 85, 85, 70, 70, 70, 55, 55, 40])
    assert outputs[9:].max() == 40.0
    assert [factor.weight for factor in s5_rules().factors] == [0.4, 0.3, 0.3]


@pytest.mark.parametrize(
    ("factor", "bound", "below", "above"),
    [(0, 90.0, 0, 1), (1, 4.0, 0, 1), (1, 8.0, 1, 2), (2, 5.0, 0, 1), (2, 10.0, 1, 2)],
)
def test_terms_cross_at_the_printed_bounds(factor, bound, below, above) -> None:
    of = s5_rules().factors[factor]
    membership = of.memberships(np.array([bound - 0.01, bound, bound + 0.01]))
    assert membership[0, below] > membership[0, above]
    assert membership[1, below] == pytest.approx(membership[1, above])
    assert membership[2, below] < membership[2, above]


@given(st.floats(0, 180), st.floats(0, 1e4), st.floats(0, 1e4))
def test_scores_are_bounded_and_memberships_sum_to_one(heading, distance, speed) -> None:
    rules = s5_rules()
    assert rules.strengths(heading, distance, speed).sum() == pytest.approx(1.0)
    assert 0.0 <= rules.score(heading, distance, speed) <= 100.0


@given(st.floats(0, 180), st.floats(0, 20), st.floats(0, 20), st.integers(0, 2), st.floats(0, 20))
def test_a_larger_difference_never_scores_higher(heading, distance, speed, axis, more) -> None:
    at = [heading, distance, speed]
    worse = [value + more * (k == axis) * (4.0 if k == 0 else 1.0) for k, value in enumerate(at)]
    worse[0] = min(worse[0], 180.0)
    assert s5_rules().score(*worse) <= s5_rules().score(*at) + 1e-9


def test_incomplete_rules_are_refused() -> None:
    data = s5_rules().to_dict()
    with pytest.raises(ConfigError, match=r"rules must hold each of the 18 combinations of terms once, got 17"):
        RuleBase.load({**data, "rules": data["rules"][:-1]})
    odd = [{**data["rules"][0], "level": "splendid"}, *data["rules"][1:]]
    with pytest.raises(ConfigError, match=r"level of rule 1 must be one of .*, got 'splendid'"):
        RuleBase.load({**data, "rules": odd})
    with pytest.raises(ConfigError, match=r"the weights must sum to 1, got 0\.9"):
        RuleBase.load({**data, "heading": {**data["heading"], "weight": 0.3}})


FUZZY, CRISP = "monitors/context_rules", "monitors/context_rules_crisp"


@pytest.mark.parametrize(
    ("rules", "axis", "bound"),
    [(FUZZY, 0, 88.50), (FUZZY, 1, 9.733), (FUZZY, 2, 12.167), (CRISP, 0, 90.0), (CRISP, 1, 8.0), (CRISP, 2, 10.0)],
)
def test_warnings_of_one_difference_begin_at_the_stated_bound(rules, axis, bound) -> None:
    """Overlapping terms warn later than S5 says; crisp ones at S5's bounds."""
    of = MapPhaseConfig(rules=rules).rules
    for value, warned in ((bound - 0.01, False), (bound + 0.01, True)):
        at = [value if k == axis else 0.0 for k in range(3)]
        assert (of.score(*at) < WARNED) == warned


def test_a_preset_of_rules_is_chosen_by_its_name_and_survives_the_file() -> None:
    config = MapPhaseConfig.load({"rules": CRISP})
    assert config == MapPhaseConfig().replace(rules=CRISP) == MapPhaseConfig.load(config.to_dict())
    assert config.rules.score(0.0, 6.0, 7.0) == pytest.approx(70.0)  # both average
    with pytest.raises(ConfigError, match="context_rules_none"):
        MapPhaseConfig(rules="monitors/context_rules_none")
