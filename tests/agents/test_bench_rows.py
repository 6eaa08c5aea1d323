import dataclasses
import itertools
import json
import math
import re

import pytest

from lanebound.agents.bench import runner
from lanebound.agents.bench.runner import Row, alternate, median_ratio, select
from lanebound.agents.cli.bench import bench
from lanebound.integrity.core.errors import InputError


@pytest.mark.parametrize(
    ("value", "gate", "higher", "met"),
    [
        (2.0, 2.0, True, True),
        (1.999, 2.0, True, False),
        (2.0, 2.0, False, True),
        (2.001, 2.0, False, False),
        (5.0, None, True, None),
        (math.nan, 2.0, True, False),
        (math.nan, 2.0, False, False),
    ],
)
def test_a_gate_is_met_on_its_good_side_and_at_the_limit(value, gate, higher, met):
    assert Row("steps", value, "1/s", gate=gate, higher_is_better=higher).met is met


def test_a_row_is_plain_data_in_json():
    row = Row("ratio", 3.0, "-", gate=2.0, stretch=4.0)
    found = json.loads(json.dumps(row.to_json()))
    assert found == {
        "name": "ratio",
        "value": 3.0,
        "unit": "-",
        "gate": 2.0,
        "stretch": 4.0,
        "higher_is_better": True,
        "met": True,
    }
    with pytest.raises(dataclasses.FrozenInstanceError):
        row.value = 1.0


def test_sides_take_turns_and_rates_are_items_over_elapsed_time(monkeypatch):
    clock, calls = {"t": 0.0}, []

    def side(name, cost_s, items):
        def work():
            calls.append(name)
            clock["t"] += cost_s
            return items

        return work

    monkeypatch.setattr(runner.time, "perf_counter", lambda: clock["t"])
    rates = alternate({"a": side("a", 0.1, 4), "b": side("b", 0.25, 5)}, rounds=2, seconds=0.45)
    assert calls == ["a", "b", *"aaaaabb" * 2]  # warm-up, then each round in turn until 0.45 s have passed
    assert rates == {"a": pytest.approx([40.0, 40.0]), "b": pytest.approx([20.0, 20.0])}


def test_every_side_works_at_least_once_in_each_round(monkeypatch):
    ticks = itertools.count()
    monkeypatch.setattr(runner.time, "perf_counter", lambda: float(next(ticks)))
    rates = alternate({"only": lambda: 3}, rounds=3, seconds=0.0)
    assert len(rates["only"]) == 3
    assert all(rate > 0.0 for rate in rates["only"])


def test_a_figure_that_is_not_finite_is_null_in_json_and_still_judged():
    row = Row("ratio", math.inf, "-", gate=2.0).to_json()
    assert (row["value"], row["gate"], row["met"]) == (None, 2.0, True)
    assert Row("ratio", math.nan, "-", gate=2.0).to_json()["met"] is False
    assert "Infinity" not in json.dumps(row)


def test_a_side_that_does_nothing_is_refused_rather_than_awaited():
    with pytest.raises(InputError, match=r"side 'idle' must do at least one item in a turn, got 0: return the number"):
        alternate({"busy": lambda: 1, "idle": lambda: 0}, rounds=1, seconds=0.01)


def test_a_clock_that_stands_still_gives_a_finite_rate(monkeypatch):
    monkeypatch.setattr(runner.time, "perf_counter", lambda: 7.0)
    rates = alternate({"only": lambda: 2}, rounds=1, seconds=0.0)
    assert math.isfinite(rates["only"][0])


def test_the_ratio_is_the_median_of_the_rounds_not_the_ratio_of_medians():
    rates = {"fast": [10.0, 40.0, 90.0], "slow": [10.0, 10.0, 10.0], "short": [1.0]}
    assert median_ratio(rates, "fast", "slow") == 4.0
    assert median_ratio({"fast": [1.0, 2.0, 9.0], "slow": [1.0, 4.0, 3.0]}, "fast", "slow") == 1.0
    with pytest.raises(ValueError, match="zip"):
        median_ratio(rates, "fast", "short")


def test_the_example_of_the_help_names_a_benchmark() -> None:
    (example,) = re.findall(r"Example: lanebound bench --only (\w+)", bench.__doc__ or "")
    assert select([example]) == [example]
