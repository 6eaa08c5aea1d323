"""Tolls and speed charges: hand-worked drives."""

import numpy as np
import pytest

from lanebound.integrity.assessment.warning_rates import ChargingConfig, charging_counts, passages, toll_counts
from lanebound.integrity.positioning.map_matching.road_map import RoadMap

EACH = ChargingConfig(every=1, least_points=2)
ALL = np.ones(8, bool)


def test_passages_are_runs_of_a_link_that_are_long_enough() -> None:
    link = np.array([3, 3, 3, 5, -1, 4, 4, 3])
    assert passages(link, ALL, 2) == [(3, 0, 2), (4, 5, 6)]
    assert passages(link, ALL, 1) == [(3, 0, 2), (5, 3, 3), (4, 5, 6), (3, 7, 7)]
    assert passages(link, ~ALL, 1) == []


@pytest.mark.parametrize(
    ("matched", "guard", "expected"),
    [
        pytest.param([1, 1, 1, 1, 2, 2, 2, 2], ALL, (2, 2, 0, 0), id="right"),
        pytest.param([1, 1, 9, 9, 2, 2, 2, 2], ALL, (2, 3, 1, 0), id="a wrong link between"),
        pytest.param([1, 1, 1, 1, 9, 9, 9, 9], ALL, (2, 2, 1, 1), id="the second wrong"),
        pytest.param([1, 1, 1, 1, 9, 9, 9, 9], np.arange(8) < 4, (2, 1, 0, 1), id="the second warned of"),
        pytest.param([1, 9, 1, 1, 2, 2, 2, 2], ALL, (2, 2, 0, 0), id="one point astray is no passage"),
        pytest.param([1, 1, 9, 1, 1, 2, 2, 2], ALL, (2, 2, 0, 0), id="a passage cut in two is charged once"),
    ],
)
def test_tolls_due_charged_wrong_and_missed(matched, guard, expected) -> None:
    true = np.array([1, 1, 1, 1, 2, 2, 2, 2])
    found = toll_counts(EACH, np.array(matched), guard, true, ALL)
    assert tuple(found.values()) == expected


def test_only_every_nth_link_is_tolled() -> None:
    true = np.array([1, 1, 1, 1, 4, 4, 4, 4])
    assert toll_counts(EACH.replace(every=4), true, ALL, true, ALL)["due"] == 1


def test_speed_is_charged_above_the_limit_of_the_matched_link() -> None:
    nodes = np.array([(0.0, 0.0), (0.0, 100.0), (0.0, 200.0)])
    ends = [(0, 1), (1, 2)]
    road_map = RoadMap.of_lines(nodes, ends, [nodes[[a, b]] for a, b in ends], identity=[4, 8], limit_mps=[10.0, 20.0])
    speed = np.full(4, 15.0)
    found = charging_counts(
        EACH, road_map, link=np.array([4, 4, 8, -1]), warn=np.array([False, True, False, False]), speed_mps=speed,
        true_link=np.array([4, 8, 4, 4]), true_speed_mps=speed, driving=np.ones(4, bool),
    )  # fmt: skip
    assert found["plain"]["speed"] == {"due": 3, "charged": 2, "wrong": 1, "missed": 2}
    assert found["guarded"]["speed"] == {"due": 3, "charged": 1, "wrong": 0, "missed": 2}
