"""No deliberately bad policy does well beside integrity_aware; Intersection is named in docs/limits.md."""

from __future__ import annotations

import pytest
from degenerate import SOUND, Score, lines, scores

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.outcome import Outcome

GOOD = Score(success=0.9, kept=0.6, mean_speed=10.0, cost=10.0, total_return=50.0, crashed=0.0, off_road=0.0)


def test_what_does_too_well_is_named() -> None:
    assert GOOD.outdone_by(GOOD._replace(kept=0.29, total_return=50.0)) == []
    assert GOOD.outdone_by(GOOD._replace(kept=0.0, total_return=51.0)) == ["more return at equal or lower cost"]
    assert GOOD.outdone_by(GOOD._replace(kept=0.0, total_return=51.0, cost=10.1)) == []
    assert GOOD.outdone_by(GOOD._replace(kept=0.3)) == ["half of the successes within the limit"]
    assert GOOD._replace(kept=0.0).outdone_by(GOOD._replace(kept=0.0)) == []
    assert lines("X", {SOUND: GOOD, "crawl": GOOD})[1].endswith("| half of the successes within the limit |")


def test_who_is_within_the_limit_half_as_often_is_named() -> None:
    sound = GOOD._replace(within=0.7)
    assert sound.matched_by(GOOD._replace(within=0.35)) == []
    assert sound.matched_by(GOOD._replace(within=0.36)) == ["half as often within the limit"]
    assert lines("XPriced", {SOUND: sound, "stand": sound})[1].endswith("| half as often within the limit |")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LaneKeepingPriced", "CarFollowingPriced", "MergePriced", "WorkZone", "Platoon"])
def test_where_stopping_has_a_price_no_policy_without_sense_keeps_the_limit(name: str) -> None:
    found = scores(name, 12, 10_000)
    assert {label: found[SOUND].matched_by(score) for label, score in found.items() if label != SOUND} == {
        label: [] for label in found if label != SOUND
    }


@pytest.mark.parametrize(("success", "cost", "found"), [(True, 15.0, 1.0), (True, 15.1, 0.0), (False, 0.0, 0.0)])
def test_a_success_within_the_limit_needs_both(success: bool, cost: float, found: float) -> None:
    outcome = Outcome("LaneKeeping-v0", "urban", "none", "nominal", 1, success=success, cost=cost, cost_limit=15.0)
    assert metric_named("success_within_limit").take(outcome) == found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "episodes", "seed"),
    [
        ("LaneKeeping", 24, 10_000),
        ("CarFollowing", 24, 10_000),
        ("UrbanCanyon", 24, 10_000),
        ("Highway", 16, 10_000),
        ("Merge", 16, 10_000),
        ("Roundabout", 24, 14_000),
        ("Racetrack", 4, 10_000),
        pytest.param("Intersection", 32, 24_000, marks=pytest.mark.xfail(strict=True, reason="see docs/limits.md")),
    ],
)
def test_no_policy_without_sense_outdoes_a_sound_driver(name: str, episodes: int, seed: int) -> None:
    found = scores(name, episodes, seed)
    assert {label: found[SOUND].outdone_by(score) for label, score in found.items() if label != SOUND} == {
        label: [] for label in found if label != SOUND
    }


@pytest.mark.slow
def test_looking_is_better_than_luck_in_intersection() -> None:
    """Rates of 0.58 and 0.26 (64 and 80 drives): other draws of 32 drives fail this in 0.6 % of the cases.

    The criterion of half of the rate (0.29) is too near to be tested with so few drives.
    """
    found = scores("Intersection", 32, 24_000, (SOUND, "crawl_50"))
    assert found[SOUND].kept > found["crawl_50"].kept
    assert found[SOUND].crashed < found["crawl_50"].crashed
