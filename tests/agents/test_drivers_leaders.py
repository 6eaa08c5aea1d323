"""Who counts as ahead: who is believed so, and a leader that levels may hide, but no follower."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.leaders import counted, expected_m, in_way, leader_of
from lanebound.envs.observation import ObservationConfig

READER = Reader(ObservationConfig(form="flat", vehicles=3))


def seen(*cars: dict[str, float], **values: float) -> np.ndarray:
    """A moment at 10 m/s with cars in the ego's lane, each of its gap between middles; dots are written as ``__``."""
    shown = {"ego__speed": 10.0, "ego__lane_width": 3.25} | values
    for k, car in enumerate(cars):
        row = {"present": 1.0, "own_lane": 1.0, "length": 5.0} | car
        shown |= {f"traffic__v{k}_{name}": value for name, value in row.items()}
    out = np.zeros(len(READER.columns), dtype=np.float32)
    for name, value in shown.items():
        column = name.replace("__", ".")
        out[READER.columns.index(column)] = value / READER.scale(column)
    return out


def ahead(observation: np.ndarray, expected: float) -> list[bool]:
    found: list[bool] = counted(READER, observation, in_way(READER, observation, 20.0), expected).tolist()
    return found


def test_a_leader_that_is_believed_level_still_counts_and_a_stranger_does_not():
    hidden = seen({"lane_gap": -0.5, "pl_at": 15.0})
    assert ahead(hidden, 1.0) == [True, False, False]
    assert ahead(hidden, np.nan) == [False, False, False]  # nobody was ahead
    assert ahead(seen({"lane_gap": -0.5, "pl_at": 0.4}), -0.5) == [False, False, False]  # its level does not reach
    assert ahead(seen({"lane_gap": -0.5, "pl_at": 15.0}), 18.0) == [False, False, False]  # another one


def test_a_follower_does_not_count_while_the_leader_is_seen():
    leader, follower = {"lane_gap": 9.0, "pl_at": 15.0}, {"lane_gap": -8.0, "pl_at": 15.0}
    assert ahead(seen(follower, leader), 9.5) == [False, True, False]
    assert ahead(seen(follower, leader | {"lane_gap": -1.0}), 1.0) == [False, True, False]  # the nearer to it


def test_what_is_expected_is_where_the_nearest_one_goes():
    observation = seen({"lane_gap": 30.0, "velocity_ahead": 2.0}, {"lane_gap": 12.0, "velocity_ahead": -5.0})
    here = in_way(READER, observation, 20.0)
    assert float(expected_m(READER, observation, here, 0.2)) == pytest.approx(11.0, abs=1e-3)
    assert np.isnan(expected_m(READER, seen(), np.zeros(3, dtype=bool), 0.2))


def test_a_leaders_own_level_is_what_it_adds_to_the_egos():
    cars: tuple[dict[str, Any], ...] = (
        {"lane_gap": 40.0, "pl_at": 2.0, "velocity_ahead": -1.0, "age": 0.3},
        {"lane_gap": 60.0, "pl_at": 1.5},
    )
    observation = seen(*cars, integrity__pl_at=0.5)
    found = leader_of(READER, observation, in_way(READER, observation, 20.0))
    assert found is not None
    assert found == pytest.approx((35.0, 9.0, 0.3, 2.0, 1.5), abs=1e-3)
    by_sensor = seen(cars[0] | {"sensor": 1.0}, integrity__pl_at=0.5)
    assert leader_of(READER, by_sensor, in_way(READER, by_sensor, 20.0)).broadcast_m == pytest.approx(2.0, abs=1e-3)
    assert leader_of(READER, observation, np.zeros(3, dtype=bool)) is None
