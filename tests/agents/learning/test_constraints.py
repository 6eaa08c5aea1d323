"""Limits of an episode's costs: what they are sums of, and a multiplier of each."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.agents.learning.constraints import Constraints, costs_in, group_limits
from lanebound.agents.learning.multiplier import Multiplier, MultiplierConfig
from lanebound.envs import make_config
from lanebound.envs.costs import CAUSES
from lanebound.integrity.core.errors import InputError

LIMITED = {"cost_limits": {"hmi": 0.5, "lane": 2.0}, "cost": {"lane": 3.0, "lane_integrity": 0.25, "hmi": 7.0}}


def test_costs_of_a_step_are_the_whole_and_the_weighted_groups_in_their_order() -> None:
    groups = group_limits(make_config("lanebound/LaneKeeping-v0", LIMITED))
    assert [(one.group, one.limit) for one in groups] == [("lane", 2.0), ("hmi", 0.5)]
    costs = dict.fromkeys(CAUSES, 1.0) | {"cost_lane": 2.0, "cost_lane_integrity": 4.0, "cost_hmi": 0.5}
    infos = [{"cost": 9.0, "costs": np.array(list(costs.values()))}, {"cost": 0.0, "costs": np.zeros(len(CAUSES))}]
    assert costs_in(infos, groups).tolist() == [[9.0, 3.0 * 2.0 + 0.25 * 4.0, 7.0 * 0.5], [0.0, 0.0, 0.0]]
    assert costs_in(infos).tolist() == [[9.0], [0.0]]
    assert costs_in(infos).dtype == np.float32


def test_each_limit_has_a_multiplier_of_its_own() -> None:
    config = MultiplierConfig(start=0.0)
    found = Constraints(10.0, group_limits(make_config("lanebound/LaneKeeping-v0", LIMITED)), config)
    assert found.limits == [10.0, 2.0, 0.5]
    means = [5.0, 4.0, 0.0]
    found.update(means)
    alone = [Multiplier(limit, config).update(mean) for limit, mean in zip(found.limits, means, strict=True)]
    assert found.values == alone
    assert found.values[0] == found.values[2] == 0.0 < found.values[1]
    named = found.named("multiplier", found.values)
    assert named == {"cost/multiplier": 0.0, "cost/multiplier_lane": found.values[1], "cost/multiplier_hmi": 0.0}


def test_what_cannot_be_limited_is_refused() -> None:
    with pytest.raises(InputError, match="info must hold 'cost' at"):
        costs_in([{"cost": 1.0}, {}])
    groups = group_limits(make_config("lanebound/LaneKeeping-v0", LIMITED))
    with pytest.raises(InputError, match="info must hold 'costs' at"):
        costs_in([{"cost": 1.0}], groups)
    zero = group_limits(make_config("lanebound/LaneKeeping-v0", {"cost_limits": {"alert": 0.0}}))
    with pytest.raises(InputError, match=r"cost_limits\.alert must be > 0 and finite, got 0"):
        Constraints(10.0, zero, MultiplierConfig())
    with pytest.raises(InputError, match="cost_limit must be > 0 and finite, got 0"):
        Constraints(0.0, groups, MultiplierConfig())
