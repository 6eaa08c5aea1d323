"""Many trackers at once are as many single ones."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from lanebound.envs.core import DrivingEnv
from lanebound.envs.navigation import NavigationConfig, fix_of
from lanebound.envs.registration import make_config
from lanebound.envs.tracker import Tracker
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.lanes import lanes_of
from lanebound.envs.vector.trackers import Trackers
from lanebound.integrity.navigators.solution import Solution

COUNT, BOUND_M, LIMITS_M = 4, 0.1, (1.5, 0.6)


def _solution(rng: np.random.Generator) -> Solution:
    """Solutions that jump now and then, some of them late, some without a level."""
    flags = {"alert": rng.random(COUNT) < 0.2, "available": rng.random(COUNT) < 0.8}
    values: dict[str, Any] = {f.name: np.zeros(COUNT) for f in fields(Solution)} | flags
    values["position_en_m"] = rng.normal(0.0, 0.4, (COUNT, 2))
    values["heading_rad"] = rng.uniform(-7.0, 7.0, COUNT)
    values["speed_mps"] = np.where(rng.random(COUNT) < 0.2, 0.0, rng.uniform(0.0, 20.0, COUNT))
    values["pl_at_m"], values["pl_ct_m"] = rng.uniform(0.1, 2.5, (2, COUNT))
    values["pl_ct_m"][rng.random(COUNT) < 0.1] = np.inf
    return Solution(**values)


def test_poses_and_levels_are_those_of_single_trackers() -> None:
    rng, config, rows = np.random.default_rng(1), NavigationConfig(), np.arange(COUNT)
    shift, belief = rng.normal(0.0, 0.03, (COUNT, 2)), np.zeros((COUNT, k.BELIEF))
    solution = _solution(rng)
    network = DrivingEnv(make_config("lanebound/Highway-v0", {"world": {"vehicles_count": 1}})).world.road.network
    many = Trackers(config, COUNT, lanes_of(network), BOUND_M, LIMITS_M)
    many.begin(rows, solution, 1, shift, belief)
    single = [Tracker(config, shift[n], fix_of(solution, n)) for n in range(COUNT)]
    reasons = set()
    for _ in range(40):
        many.coast(rows, 0.05, belief)
        solution = _solution(rng)
        many.take(rows, solution, 1, 0.05, 0.1, belief)
        for n, tracker in enumerate(single):
            tracker.coast(0.05)
            tracker.take(fix_of(solution, n), 0.05, 0.1)
            pose = [*tracker.position_m, tracker.heading_rad, tracker.fix.speed_mps]
            np.testing.assert_allclose(belief[n, [k.B_X, k.B_Y, k.B_HEADING, k.B_SPEED]], pose, atol=1e-12)
            rates = [tracker.yaw_rate_radps, tracker.acceleration_mps2]
            np.testing.assert_allclose(belief[n, [k.B_YAW_RATE, k.B_ACCELERATION]], rates, atol=1e-9)
            levels = tracker.levels_m(BOUND_M)
            np.testing.assert_allclose(belief[n, [k.B_PL_AT, k.B_PL_CT]], levels, atol=1e-12)
            over = levels[0] > LIMITS_M[0] or levels[1] > LIMITS_M[1]
            assert bool(belief[n, k.B_ALERT]) == (tracker.fix.alert or over)
            assert bool(belief[n, k.B_AVAILABLE]) == (tracker.fix.available and not over)
        reasons |= set(belief[:, k.B_REASON].tolist())
    assert len(reasons) >= 4, "none, along, across and both must occur"
