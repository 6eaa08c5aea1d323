"""What an episode needs to be a success: the goal of its world, time, and no bank of progress."""

from __future__ import annotations

from typing import Any

import pytest

from lanebound.agents.drivers import make_agent
from lanebound.envs import IDS, DrivingEnv, make_config

GIVEN: dict[str, Any] = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
FASTER = {"Intersection": 2, "Roundabout": 3, "Merge": 3}


def made(name: str, **config: Any) -> DrivingEnv:
    return DrivingEnv(make_config(f"lanebound/{name}-v0", {**GIVEN, **config}))


def driven(env: DrivingEnv, agent: Any, seed: int, alone: bool = False) -> dict[str, Any]:
    """The info at the end of an episode, and its costs in sum."""
    observation, _ = env.reset(seed=seed)
    if alone:
        env.world.road.vehicles = [env.world.vehicle]
        env.world._spawn_vehicle = lambda *given, **named: None
    over, state, cost = False, None, 0.0
    while not over:
        action, state = agent.predict(observation, state=state)
        observation, _, terminated, truncated, info = env.step(action)
        cost, over = cost + info["cost"], terminated or truncated
    return {**info, "whole_cost": cost, "terminated": terminated}


class Always:
    """One command for ever, or another one after some way."""

    def __init__(
        self, command: int, then: int | None = None, env: DrivingEnv | None = None, way_m: float = 0.0
    ) -> None:
        self.command, self.then, self.env, self.way_m, self.way = command, then, env, way_m, 0.0

    def predict(self, observation: Any, state: Any = None) -> tuple[int, Any]:
        if self.env is not None:
            self.way += self.env.world.vehicle.speed * self.env.dt_s
        return (self.command if self.then is None or self.way < self.way_m else self.then), None


@pytest.mark.parametrize("name", ["Intersection", "Roundabout"])
def test_top_speed_makes_the_turn_with_perfect_navigation(name: str) -> None:
    info = driven(made(name), Always(FASTER[name]), 1, alone=True)
    assert info["is_success"]
    assert info["terminated"], "arrival ends the episode"
    assert info["whole_cost"] < 1.0


@pytest.mark.parametrize(("name", "speeds"), [("Intersection", [0, 4.5, 9]), ("Roundabout", [0, 8, 16])])
def test_speeds_of_highway_env_do_not_make_it(name: str, speeds: list[float]) -> None:
    env = made(name, action_options={"target_speeds": speeds})
    assert driven(env, Always(FASTER[name]), 1, alone=True)["off_road"]


@pytest.mark.parametrize("way_m", [28.0, 45.0, 60.0])
def test_stopping_in_the_approach_or_the_crossing_is_no_success(way_m: float) -> None:
    env = made("Intersection")
    info = driven(env, Always(2, 0, env, way_m), 1, alone=True)
    assert not info["crashed"]
    assert not info["is_success"]


@pytest.mark.parametrize("env_id", list(IDS))
def test_standing_and_crawling_never_succeed(env_id: str) -> None:
    name = env_id.removeprefix("lanebound/").removesuffix("-v0")
    if name == "Racetrack":
        pytest.skip("Racetrack has no command of speed")
    short = {} if name in FASTER else {"duration_s": 60.0 if name == "CarFollowing" else 20.0}
    env = made(name, world={"vehicles_count": 5} if name == "Highway" else {}, **short)
    for share in (0.0, 0.25):
        info = driven(env, make_agent("constant", env, {"share": share}), 2)
        assert not info["is_success"], share


def test_a_lead_of_progress_is_not_banked() -> None:
    env = made("LaneKeeping", duration_s=40.0)
    assert driven(env, make_agent("nominal", env), 2)["is_success"]
    bank = make_agent("bank", env, {"time_share": 0.65})
    info = driven(env, bank, 2)
    score = env.belief_loop.episodes.ego["score"][0]  # type: ignore[union-attr]
    assert score["progress_m"] > env.config.success_share * score["allowed_m"], "its mean speed suffices"
    assert not info["is_success"], "it stands at the end"


def test_the_vehicle_ahead_and_bends_lower_the_speed_that_is_expected() -> None:
    env = made("CarFollowing", duration_s=60.0)
    assert driven(env, make_agent("nominal", env), 4)["is_success"]
    score = env.belief_loop.episodes.ego["score"][0]  # type: ignore[union-attr]
    assert score["allowed_m"] < 0.9 * env.world.vehicle.lane.speed_limit * 60.0


def test_to_wait_behind_a_wreck_is_no_success() -> None:
    """The lane is blocked after a third of the way; the wreck and a car that waits behind it lower nothing."""
    env = made("Highway", world={"vehicles_count": 3, "lanes_count": 1}, duration_s=40.0)
    successes = {}
    for crashed in (False, True):
        observation, _ = env.reset(seed=2)
        ego, *others = env.world.road.vehicles
        for place, other in zip((300.0, 290.0, 280.0), others, strict=False):
            other.position[0], other.speed, other.target_speed = ego.position[0] + place, 0.0, 0.0
            other.crashed = crashed and place == 300.0
        agent, state, over = make_agent("nominal", env), None, False
        while not over:
            action, state = agent.predict(observation, state=state)
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        assert not info["crashed"]
        successes[crashed] = info["is_success"]
    assert successes == {False: True, True: False}
