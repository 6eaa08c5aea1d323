"""With perfect navigation every world is highway-env's own, bit for bit, whatever was made before it in the process."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from lanebound.envs.catalogue import world_of
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.world import IDM_PATH, guard

PERFECT = {
    "sky": "open",
    "navigation": {"source": "perfect"},
    "actuators": None,
    "perception": {"source": "none"},
    "wander": {"offset_sigma_m": 0.0, "wander_sigma_m": 0.0},
}
FEW = {"vehicles_count": 6}
CASES: list[tuple[str, str, dict[str, Any]]] = [
    ("highway-v0", "meta", FEW),
    ("highway-v0", "continuous", FEW),
    ("highway-fast-v0", "meta", FEW),
    ("merge-v1", "meta", {}),
    ("merge-v1", "continuous", {}),
    ("merge-generic-v1", "meta", {}),
    ("roundabout-v1", "meta", {}),
    ("roundabout-v1", "continuous", {}),
    ("intersection-v2", "meta", {}),
    ("intersection-v2", "continuous", {}),
    ("racetrack-v1", "continuous", {}),
    ("racetrack-oval-v1", "continuous", {}),
    ("two-way-v0", "meta", {}),
    ("exit-v1", "meta", {"vehicles_count": 6}),
    ("u-turn-v1", "meta", {}),
    ("LaneKeepingWorld", "meta", {}),
    ("LaneKeepingWorld", "continuous", {}),
    ("CarFollowingWorld", "meta", {}),
    ("CarFollowingWorld", "continuous", {}),
    ("UrbanCanyonWorld", "meta", {"vehicles_count": 4}),
    ("UrbanCanyonWorld", "continuous", {"vehicles_count": 4}),
]


def _plain(config: EnvConfig) -> AbstractEnv:
    """highway-env's own environment with the same configuration; only array actions are guarded as ours are."""
    model = world_of(config)
    settings = {**model.config}
    if "IntersectionDriver" not in settings.get("other_vehicles_type", ""):  # who stops where highway-env's reverses
        settings["other_vehicles_type"] = IDM_PATH
    return guard(type(model), settings)


def _poses(world: AbstractEnv) -> NDArray[np.float64]:
    return np.array([(*v.position, v.heading, v.speed) for v in world.road.vehicles], dtype=np.float64)


def _command(space: Any, rng: np.random.Generator) -> Any:
    """A random command, gentle enough to stay on the road for a while."""
    if hasattr(space, "n"):
        return int(rng.integers(space.n))
    steering = 0.02 * rng.standard_normal(space.shape)
    return np.clip(steering + [0.2, 0.0][-space.shape[0] :], -1.0, 1.0).astype(np.float32)


@pytest.mark.parametrize(("base", "action", "world"), CASES, ids=lambda v: v if isinstance(v, str) else "")
def test_perfect_navigation_changes_nothing(base: str, action: str, world: dict[str, Any]) -> None:
    own = base.endswith("World")
    rates = {"simulation_hz": 20, "policy_hz": 5} if own else {"simulation_hz": 15, "policy_hz": 1}
    env = DrivingEnv(EnvConfig.load({"base": base, "action": action, "world": world, **rates, **PERFECT}))
    constants = {name: vars(IDMVehicle)[name] for name in ("DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN")}
    steps = 0
    for seed in range(1 if base.startswith("intersection") else 2):
        env.reset(seed=seed)
        assert {name: vars(IDMVehicle)[name] for name in constants} == constants
        plain = _plain(env.config)
        try:
            plain.reset(seed=seed)
            rng = np.random.default_rng(seed)
            np.testing.assert_array_equal(_poses(env.world), _poses(plain))
            for _ in range(30 if own else 8):
                command = _command(plain.action_space, rng)
                _, _, terminated, truncated, info = env.step(command)
                _, _, ended, over, _ = plain.step(command)
                np.testing.assert_array_equal(_poses(env.world), _poses(plain))
                assert terminated >= ended
                assert truncated == over
                assert info["err_at_m"] == info["err_ct_m"] == 0.0
                steps += 1
                if terminated or truncated:
                    break
        finally:  # a plain intersection rewrites the class for everybody
            for name, value in constants.items():
                setattr(IDMVehicle, name, value)
    assert steps >= 3
