"""Integrity given one fault: by kind, and at nominal rates, held against closed forms and against direct estimates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import made_up_outcome, made_up_suite

from lanebound.agents.benchmark.fault_rates import RATES, FaultCell, fault_cells, fault_rates
from lanebound.agents.benchmark.outcome import Outcome, Place, Task
from lanebound.agents.benchmark.results import Results
from lanebound.agents.cli.benchmark_tables import print_given_fault
from lanebound.integrity.assessment.accuracy import clopper_pearson
from lanebound.integrity.core.streams import named_generator

EXPECTED = {"cycle_slip": 0.03, "corrections_loss": 0.02, "spoofing": 1e-5}
TOTAL = sum(EXPECTED.values())
P0, P1 = np.exp(-TOTAL), TOTAL * np.exp(-TOTAL)
ONE, NONE = Place("LaneKeeping-v0", "urban", "one"), Place("LaneKeeping-v0", "urban", "none")
Chance = Callable[[str, int], bool]


def _struck(count: int, misled: Chance, agent: str = "nominal") -> list[Outcome]:
    """Episodes with each kind in turn, misled where told; a misled one has an alert 2 s after the onset."""
    made, kinds = [], list(EXPECTED)
    for n in range(count):
        kind = kinds[n % len(kinds)]
        wrong = misled(kind, n)
        made.append(
            made_up_outcome(
                Task(ONE, agent, n), fault_kind=kind, fault_weight=len(kinds) * EXPECTED[kind] / TOTAL,
                fault_probability=P1, no_fault_probability=P0, fault_onset_s=3.0, mi_steps=0, hmi_steps=int(wrong),
                fault_alert_s=2.0 if wrong else None, time_to_alert_s=0.5 if wrong else None,
            )
        )  # fmt: skip
    return made


def _clear(count: int, misled: int) -> list[Outcome]:
    return [made_up_outcome(Task(NONE, "nominal", n), mi_steps=0, hmi_steps=int(n < misled)) for n in range(count)]


def test_a_cell_for_each_kind_the_likeliest_first() -> None:
    cells = fault_cells({(ONE, "nominal"): _struck(90, lambda kind, n: kind == "spoofing" and n % 2 == 0)})
    assert [cell.kind for cell in cells] == ["cycle_slip", "corrections_loss", "spoofing"]
    assert [cell.share for cell in cells] == pytest.approx([rate / TOTAL for rate in EXPECTED.values()])
    assert sum(cell.share for cell in cells) == pytest.approx(1.0)
    slip, _, spoofing = cells
    assert spoofing.episodes == slip.episodes == 30
    assert spoofing.metrics["any_hmi"].mean == spoofing.metrics["alert_after_fault"].mean == 0.5
    assert (spoofing.metrics["any_hmi"].low, spoofing.metrics["any_hmi"].high) == clopper_pearson(15, 30)
    assert (spoofing.metrics["alert_delay"].mean, spoofing.metrics["time_to_alert"].n) == (2.0, 15)
    assert slip.metrics["any_hmi"].mean == 0.0
    assert slip.metrics["alert_delay"].mean is None


def test_rates_are_weighted_and_add_the_episodes_without_a_fault() -> None:
    """Kinds met equally often: the mean by kind is that of the weighted episodes."""
    struck = _struck(90, lambda kind, n: kind == "corrections_loss" and n % 2 == 0)
    by_key = {rate.metric: rate for rate in fault_rates({(ONE, "nominal"): struck, (NONE, "nominal"): _clear(50, 2)})}
    assert tuple(by_key) == RATES
    hmi, alert = by_key["any_hmi"], by_key["alert_after_fault"]
    assert hmi.given_one == pytest.approx(np.mean([o.fault_weight * (o.hmi_steps > 0) for o in struck]))
    assert hmi.given_one == pytest.approx(0.5 * EXPECTED["corrections_loss"] / TOTAL)
    assert hmi.probability == pytest.approx(P1)
    assert hmi.total == pytest.approx(P0 * 2 / 50 + P1 * hmi.given_one)
    assert hmi.unseen == pytest.approx(1 - P0 - P1)
    assert hmi.total_low < hmi.total < hmi.total_high
    nothing, some = clopper_pearson(0, 30, 1 - 0.05 / 3)[1], clopper_pearson(15, 30, 1 - 0.05 / 3)
    share = EXPECTED["corrections_loss"] / TOTAL
    assert hmi.low == pytest.approx(share * some[0])
    assert hmi.high == pytest.approx(share * some[1] + (1.0 - share) * nothing)
    assert alert.total is None, "episodes without a fault have no onset"


def test_a_weighted_rate_is_that_of_nominal_episodes() -> None:
    """Each kind misleads with a probability of its own; 95 % intervals hold the true rate."""
    chance = {"cycle_slip": 0.02, "corrections_loss": 0.3, "spoofing": 0.9}
    truth = sum(EXPECTED[kind] / TOTAL * p for kind, p in chance.items())
    rng, held, found = named_generator(4, "faults"), 0, []
    drawn = _struck(300, lambda kind, n: False)
    for _ in range(60):
        struck = [replace(o, hmi_steps=int(rng.random() < chance[o.fault_kind or ""])) for o in drawn]
        rate = next(r for r in fault_rates({(ONE, "nominal"): struck}) if r.metric == "any_hmi")
        held += rate.low <= truth <= rate.high
        found.append(rate.given_one)
    assert abs(np.mean(found) - truth) < 3.3 * np.std(found) / np.sqrt(60)
    assert held >= 57, "the level is split among kinds, so that more than 95 % hold"


def test_other_levels_of_faults_and_failed_agents_do_not_count() -> None:
    struck = _struck(30, lambda kind, n: True)
    failed = [made_up_outcome(o.task, fault_kind=o.fault_kind, fault_weight=1.0, status="raised") for o in struck[:3]]
    assert fault_cells({(NONE, "nominal"): _clear(5, 0), (ONE, "nominal"): failed}) == []
    assert fault_rates({(NONE, "nominal"): _clear(5, 0)}) == []
    cells = fault_cells({(ONE, "nominal"): failed + struck[3:]})
    assert [cell.episodes for cell in cells] == [9, 9, 9]


def test_results_have_them_and_the_terminal_shows_them(capsys: pytest.CaptureFixture[str]) -> None:
    suite = made_up_suite(
        envs=["LaneKeeping"], skies=["urban"], faults=["none", "one"], agents=["nominal"], seeds={"count": 9}
    )
    first = suite.seeds.seeds[0]
    kinds = {task.seed: _struck(9, lambda kind, n: n == 8)[task.seed - first] for task in suite.tasks()}
    drawn = ("fault_kind", "fault_weight", "fault_probability", "no_fault_probability", "fault_alert_s", "hmi_steps")

    def made(task: Task) -> Outcome:
        faulty = task.place.faults == "one"
        own = {name: getattr(kinds[task.seed], name) for name in drawn} if faulty else {}
        return made_up_outcome(task, **own)

    results = Results.of(suite, map(made, suite.tasks()))
    assert {type(cell) for cell in results.fault_cells} == {FaultCell}
    data = results.to_dict()
    assert [cell["kind"] for cell in data["fault_cells"]] == list(EXPECTED)
    assert [rate["metric"] for rate in data["fault_rates"]] == list(RATES)
    print_given_fault(results)
    told = capsys.readouterr().out
    for words in (
        "Given one fault in each episode",
        "corrections_loss",
        "33.3",
        "At nominal rates of faults",
        "unseen",
    ):
        assert words in told
    print_given_fault(Results.of(made_up_suite(), []))
    assert capsys.readouterr().out == ""
