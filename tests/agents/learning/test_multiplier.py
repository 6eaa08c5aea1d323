"""The multiplier grows while costs exceed the limit, falls to nothing below it, and keeps a toy plant at its limit."""

from __future__ import annotations

import pytest

from lanebound.agents.learning.multiplier import Multiplier, MultiplierConfig
from lanebound.integrity.core.errors import InputError

CONFIG = MultiplierConfig()


def test_it_starts_where_it_is_told_to() -> None:
    assert Multiplier(10.0, MultiplierConfig(start=0.3)).value == 0.3
    assert Multiplier(10.0, MultiplierConfig(integral=0.0)).value == CONFIG.start


def test_it_grows_above_the_limit_and_vanishes_below_it() -> None:
    multiplier = Multiplier(10.0, CONFIG)
    grown = [multiplier.update(30.0) for _ in range(10)]
    assert grown == sorted(grown)
    assert grown[-1] > grown[0] > 0.1
    for _ in range(60):
        multiplier.update(0.0)
    assert (multiplier.value, multiplier.integral) == (0.0, 0.0)


def test_only_the_share_of_the_limit_counts() -> None:
    one, other = Multiplier(1.0, CONFIG), Multiplier(100.0, CONFIG)
    for cost in (3.0, 2.0, 0.5):
        assert one.update(cost) == pytest.approx(other.update(100.0 * cost))


def test_it_is_bounded_and_comes_down_at_once_when_the_cost_does() -> None:
    config = CONFIG.replace(largest=2.0)
    multiplier = Multiplier(1.0, config)
    for _ in range(500):
        multiplier.update(50.0)
    assert multiplier.value == 2.0
    falling = [multiplier.update(0.0) for _ in range(100)]
    assert falling[-1] == 0.0


def test_what_a_beginners_crashes_leave_is_given_back_as_fast() -> None:
    multiplier = Multiplier(15.0, CONFIG)
    before = multiplier.integral
    for cost in [217.0] * 20 + [0.0] * 20:
        multiplier.update(cost)
    assert multiplier.integral == pytest.approx(before)
    assert multiplier.value < 0.2


def test_the_limit_counts_after_as_many_decisions_as_it_is_told_to_wait() -> None:
    config = CONFIG.replace(after_steps=1000, start=0.3)
    multiplier = Multiplier(15.0, config)
    assert multiplier.value == 0.0
    assert [multiplier.update(200.0, steps) for steps in (0, 500, 999)] == [0.0, 0.0, 0.0]
    assert multiplier.update(20.0, 1000) == Multiplier(15.0, config.replace(after_steps=0)).update(20.0)


def test_growing_costs_are_answered_before_they_exceed_and_falling_ones_are_not_rewarded() -> None:
    def last(costs: list[float], derivative: float) -> float:
        multiplier = Multiplier(1.0, CONFIG.replace(derivative=derivative, integral=0.0, proportional=0.5))
        return [multiplier.update(cost) for cost in costs][-1]

    rising, falling = [1.5, 2.0, 3.0], [3.0, 2.0, 1.5]
    assert last(rising, 1.0) > last(rising, 0.0)
    assert last(falling, 1.0) == last(falling, 0.0)


def test_a_plant_that_yields_to_it_comes_to_its_limit() -> None:
    multiplier = Multiplier(15.0, CONFIG)
    cost = 0.0
    for _ in range(1000):
        cost = 50.0 / (1.0 + multiplier.value)  # a policy that heeds the multiplier at once
        multiplier.update(cost)
    assert cost == pytest.approx(15.0, rel=1e-2)
    assert multiplier.value == pytest.approx(50.0 / 15.0 - 1.0, rel=1e-2)


@pytest.mark.parametrize("limit", [0.0, -1.0, float("inf"), float("nan")])
def test_a_limit_of_nothing_is_refused(limit: float) -> None:
    with pytest.raises(InputError, match="cost_limit must be > 0 and finite"):
        Multiplier(limit, CONFIG)
