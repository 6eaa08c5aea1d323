"""The safety layer: what it permits is safe as observed, what it permits passes unchanged, and it needs no truth."""

from __future__ import annotations

import pickle
from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from experiments import experiment
from gymnasium.wrappers import FlattenObservation, FrameStackObservation, RescaleAction, TransformAction
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from lanebound.agents.benchmark import SuiteConfig
from lanebound.agents.cli.static import refuse_early
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.rules import RULES, RuleBook, SafetyRules
from lanebound.agents.drivers.shares import value_of
from lanebound.agents.episodes import open_env
from lanebound.agents.interventions import INTERVENTIONS_KEY
from lanebound.agents.learning.evaluation import learnt_agent
from lanebound.agents.learning.imitation import teacher_of
from lanebound.agents.learning.opening import for_learning
from lanebound.agents.safety_layer import SafetyLayer, VecSafetyLayer
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs import IDS
from lanebound.envs.core import DrivingEnv
from lanebound.envs.wrappers import SafetyGymnasium
from lanebound.integrity.core.errors import ConfigError, InputError

PERFECT: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}
DOUBTFUL: dict[str, Any] = {"sky": "dense", "duration_s": 6.0, "perception": {"source": "sensor"}}
KINDS = [(name, action) for name in IDS for action in ("meta", "continuous") if (name, action) != (
    "lanebound/Racetrack-v0", "meta")]  # fmt: skip
OFF = dict.fromkeys(RULES, False)
SPEEDS = np.linspace(0.0, 60.0, 601)
RHO_S, GAIN, LEAST, MOST = 0.5, 2.0, 4.0, 6.0  # of cost_headway


def rss_m(v: float, lead: float) -> float:
    """Definition 1 of Shalev-Shwartz et al. 2017, written down once more."""
    after = v + GAIN * RHO_S
    return max(v * RHO_S + 0.5 * GAIN * RHO_S**2 + after**2 / (2 * LEAST) - lead**2 / (2 * MOST), 0.0)


class Shown:
    """What one observation says, by name."""

    def __init__(self, env: Any, observation: Any) -> None:
        self.reader, self.observation, self.config = Reader(env.config.observation), observation, env.config
        self.v = max(self.value("ego.speed"), 0.0)

    def value(self, column: str) -> float:
        return float(self.reader.value(self.observation, column))

    @property
    def alert(self) -> bool:
        return self.value("integrity.alert") > 0.5

    def vehicles(self, lane: str) -> list[tuple[float, float, float, float]]:
        """Gap between middles, levels, free gap less levels, and speed of the vehicles that are flagged on a lane."""
        found = []
        for k in range(self.reader.config.vehicles):
            row = {name: self.value(f"traffic.v{k}_{name}") for name in (
                "present", lane, "lane_gap", "length", "pl_at", "pl_exists", "velocity_ahead")}  # fmt: skip
            if row["present"] > 0.5 and row[lane] > 0.5:
                level = row["pl_at"] if row["pl_exists"] > 0.5 else 40.0
                free = abs(row["lane_gap"]) - 0.5 * (row["length"] + 5.0) - level
                found.append((row["lane_gap"], level, free, max(self.value("ego.speed") + row["velocity_ahead"], 0.0)))
        return found

    def may_change(self, lane: str) -> bool:
        """Whether the flagged vehicles of a lane leave the RSS distances, levels subtracted."""
        return all(
            free >= (rss_m(self.v, other) if gap > 0.0 else rss_m(other, self.v)) - 1e-3 and free >= 0.0
            for gap, _, free, other in self.vehicles(lane)
        )

    def level_mps(self) -> float:
        """The highest speed by level."""
        ratio = max(self.value(f"integrity.ratio_{a}") for a in ("at", "ct"))
        calm, limit = self.config.cost.alert_speed_share, self.value("road.speed_limit")
        ratio = max(ratio, 1.0) if self.alert else ratio
        return (limit if limit < 40.0 else 14.0) * max(calm / max(ratio, calm), 0.25)

    def rss_mps(self) -> float:
        """The highest speed by the flagged leaders, in steps of 0.1 m/s."""
        tops = [60.0]
        for gap, level, free, lead in self.vehicles("own_lane"):
            if gap + level > 0.0:
                fits = [rss_m(v, lead) <= max(free, 0.0) for v in SPEEDS]
                tops.append(float(SPEEDS[fits][-1]) if any(fits) else 0.0)
        return min(tops)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


class Spy(gymnasium.Wrapper):
    """Remembers what is carried out."""

    action: Any = None

    def step(self, action: Any) -> Any:
        self.action = action
        return self.env.step(action)


class Falsified(gymnasium.ObservationWrapper):
    """Shows another state in the same space."""

    def observation(self, observation: Any) -> Any:
        return {group: 0.0 * part for group, part in observation.items()}


@pytest.mark.parametrize(("name", "action"), KINDS)
def test_whatever_a_random_policy_does_the_rules_hold_as_observed(name: str, action: str) -> None:
    fewer = {"world": {"vehicles_count": 10}} if "Highway" in name else {}
    spy = Spy(gymnasium.make(name, config={**DOUBTFUL, **fewer, "action": action}))
    env = SafetyLayer(spy)
    env.action_space.seed(3)
    inner, changed, decisions = env.unwrapped, 0, 0
    for seed in (1000, 1001) if action == "meta" else (1000,):
        observation, _ = env.reset(seed=seed)
        over = False
        while not over:
            shown, wanted = Shown(inner, observation), env.action_space.sample()
            masks = env.action_masks() if action == "meta" else None
            again = env.book.project(observation, np.asarray(wanted))
            observation, _, terminated, truncated, info = env.step(wanted)
            over, changed, decisions = terminated or truncated, changed + info["intervened"], decisions + 1
            carried = np.asarray(spy.action)
            assert np.array_equal(carried, again.actions)
            assert np.array_equal(env.book.project(shown.observation, carried).actions, carried)  # it is permitted
            assert info["intervened"] == bool(info["intervened_by"]) == (not np.array_equal(carried, wanted))
            assert set(info["intervened_by"]) <= set(RULES)
            if action == "meta":
                require_meta(env, shown, int(carried), masks, None if over else observation)
            else:
                require_continuous(env, shown, carried)
        assert info[INTERVENTIONS_KEY]["decisions"] >= info[INTERVENTIONS_KEY]["intervened"]
    assert changed <= decisions
    assert changed or "Intersection" in name  # where nothing binds in these seconds


def require_meta(env: SafetyLayer, shown: Shown, carried: int, masks: Any, after: Any) -> None:
    """The rules of meta-actions: lanes, target speeds, and masks."""
    labels = env.unwrapped.world.action_type.actions
    label = labels[carried]
    permitted = env.book.permitted(shown.observation)
    assert masks.any()
    assert not (masks & ~permitted).any()
    assert permitted[carried]
    for code in np.flatnonzero(permitted):
        assert int(env.book.project(shown.observation, np.asarray(code)).actions) == code
    if label.startswith("LANE"):
        lane, back = ("left_lane", "right") if label == "LANE_LEFT" else ("right_lane", "left")
        assert shown.value(f"ego.target_{back}") > 0.5 or (not shown.alert and shown.may_change(lane))
    if after is None:
        return
    target = float(env.book.reader.value(after, "ego.target_speed"))
    lowest = float(env.book._targets(shown.observation).min())
    assert target <= max(min(shown.level_mps(), shown.rss_mps() + 0.1), lowest) + 1e-3


def require_continuous(env: SafetyLayer, shown: Shown, carried: np.ndarray) -> None:
    """The rules of continuous actions: acceleration, and lanes that stay closed."""
    inner = env.unwrapped.world.action_type
    if inner.longitudinal:
        wanted = float(value_of(carried[0].astype(float), inner.acceleration_range))
        v, dt_s = shown.value("ego.speed"), env.unwrapped.dt_s
        assert wanted <= max((shown.level_mps() - v) / dt_s, -2.0) + 1e-4
        assert wanted <= max((shown.rss_mps() + 0.1 - v) / dt_s, -4.0) + 1e-4
    low, high, closed = env.book.steering_bounds(shown.observation)
    steering = float(value_of(carried[-1].astype(float), inner.steering_range))
    assert np.clip(low, *inner.steering_range) - 1e-5 <= steering <= np.clip(high, *inner.steering_range) + 1e-5
    for side, lane in ((-1, "left"), (1, "right")):
        if shown.value(f"ego.{lane}_exists") > 0.5 and (shown.alert or not shown.may_change(f"{lane}_lane")):
            assert any(bool(forbids) for forbids in closed[side].values())


@pytest.mark.parametrize(("name", "action"), [("Merge", "meta"), ("CarFollowing", "continuous")])
def test_without_rules_an_episode_is_the_same_to_the_bit(name: str, action: str) -> None:
    config = {**PERFECT, "action": action, "duration_s": 5.0}
    bare, layered = open_env(name, config), SafetyLayer(open_env(name, config), OFF)
    bare.action_space.seed(1)
    assert np.array_equal(bare.reset(seed=4)[0]["ego"], layered.reset(seed=4)[0]["ego"])
    over = False
    while not over:
        action = bare.action_space.sample()
        (free, reward, *_), (kept, same, terminated, truncated, info) = bare.step(action), layered.step(action)
        assert all(np.array_equal(free[group], kept[group]) for group in free)
        assert (reward, info["intervened"], info["intervened_by"]) == (same, False, ())
        over = terminated or truncated


def test_a_calm_drive_in_the_middle_of_the_lane_is_not_changed() -> None:
    env = SafetyLayer(open_env("LaneKeeping", {**PERFECT, "duration_s": 20.0}))
    driver = make_agent("cautious", env.unwrapped, {"speed_share": 0.7})
    observation, _ = env.reset(seed=1000)
    over, info = False, {}
    while not over:
        observation, _, terminated, truncated, info = env.step(driver.predict(observation)[0])
        over = terminated or truncated
    assert info[INTERVENTIONS_KEY] == {"decisions": 100, "intervened": 0, **dict.fromkeys(RULES, 0)}


@pytest.mark.parametrize("name", ["Merge", "CarFollowing"])
def test_single_equals_vector_and_several_processes_equal_one(name: str) -> None:
    config = {**DOUBTFUL, "observation": {"form": "flat"}}
    count, one = 2, VecSafetyLayer(EngineVecEnv(f"lanebound/{name}-v0", 2, config))
    two = VecSafetyLayer(EngineVecEnv(f"lanebound/{name}-v0", 2, config, processes=2))
    singles = [SafetyLayer(open_env(name, config)) for _ in range(count)]
    for envs in (one, two):
        envs.seed(1000)
    seen, same = one.reset(), two.reset()
    alone = [env.reset(seed=1000 + e)[0] for e, env in enumerate(singles)]
    one.action_space.seed(2)
    try:
        for _ in range(12):
            assert np.array_equal(seen, same)
            np.testing.assert_allclose(seen, np.stack(alone), atol=1e-5)
            if name == "Merge":
                assert np.array_equal(one.action_masks(), two.action_masks())
                assert np.array_equal(one.action_masks(), np.stack([env.action_masks() for env in singles]))
                assert np.array_equal(get_action_masks(one), one.action_masks())
            actions = np.stack([one.action_space.sample() for _ in range(count)])
            seen, rewards, over, infos = one.step(actions)
            same, others, _, infos_of_two = two.step(actions)
            steps = [env.step(action) for env, action in zip(singles, actions, strict=True)]
            alone = [step[0] for step in steps]
            assert np.array_equal(rewards, others)
            for e in range(count):
                assert infos[e]["intervened_by"] == infos_of_two[e]["intervened_by"] == steps[e][4]["intervened_by"]
            if over.any():
                break
    finally:
        two.close()


def moment(book: RuleBook, **values: float) -> np.ndarray:
    """A flat observation of a calm car at 10 m/s on a lane of 4 m between two others, 20 m/s permitted."""
    shown = {"ego__speed": 10.0, "ego__target_speed": 10.0, "ego__lane_width": 4.0, "ego__heading_cos": 1.0,
             "ego__left_exists": 1.0, "ego__right_exists": 1.0, "road__speed_limit": 20.0,
             "integrity__al_at": 1.5, "integrity__al_ct": 1.0, "traffic__v0_pl_exists": 1.0}  # fmt: skip
    out = np.zeros(len(book.reader.columns), dtype=np.float32)
    for name, value in (shown | values).items():
        column = name.replace("__", ".")
        out[book.reader.columns.index(column)] = value / book.reader.scale(column)
    return out


@pytest.fixture(scope="module")
def meta() -> RuleBook:
    return RuleBook(open_env("Highway", PERFECT | {"observation": {"form": "flat"}}))


@pytest.fixture(scope="module")
def direct() -> RuleBook:
    return RuleBook(open_env("Highway", PERFECT | {"action": "continuous", "observation": {"form": "flat"}}))


LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)


def test_the_permitted_speed_falls_with_the_level(meta: RuleBook) -> None:
    """By hand: half the limit at the alert limit, a quarter at twice of it, and no less; it needs no clipped level."""

    def speed(**values: float) -> float:
        return float(meta.speeds(moment(meta, **values))["level"])

    for ratio, expected in ((0.0, 20.0), (0.5, 20.0), (0.625, 16.0), (1.0, 10.0), (1.6, 6.25), (3.0, 5.0)):
        assert speed(integrity__ratio_ct=ratio) == pytest.approx(expected, rel=1e-5)
        assert speed(integrity__ratio_at=ratio) == pytest.approx(expected, rel=1e-5)
    assert speed(integrity__pl_ct=20.0, integrity__al_ct=20.0) == pytest.approx(20.0)  # both clipped
    assert speed(integrity__alert=1.0) == pytest.approx(10.0)
    assert speed(road__speed_limit=40.0) == pytest.approx(14.0)  # the map gives none


def test_an_alert_forbids_changes_and_higher_targets(meta: RuleBook) -> None:
    calm, alert = moment(meta), moment(meta, integrity__alert=1.0)
    assert meta.permitted(calm).all()
    assert meta.permitted(alert).tolist() == [False, True, False, False, True]
    found = meta.project(np.stack([calm, alert, alert]), np.array([LEFT, LEFT, FASTER]))
    assert found.actions.tolist() == [LEFT, IDLE, IDLE]
    assert found.by["alert"].tolist() == [False, True, False]
    assert found.by["level"].tolist() == [False, False, True]
    fast = moment(meta, integrity__alert=1.0, ego__speed=20.0, ego__target_speed=20.0)
    assert meta.permitted(fast).tolist() == [False, False, False, False, True]
    assert int(meta.project(fast, np.array(LEFT)).actions) == SLOWER
    for code in (-1, 5, 1.0):
        with pytest.raises(InputError, match="actions must be codes from 0 to 4"):
            meta.project(fast, np.array(code))


def test_a_change_may_be_withdrawn_and_not_doubled(meta: RuleBook) -> None:
    running = moment(meta, ego__target_left=1.0)
    assert meta.permitted(running).tolist() == [False, True, True, True, True]
    assert meta.permitted(moment(meta, ego__target_left=1.0, integrity__alert=1.0))[RIGHT]


@pytest.mark.parametrize("ahead", [True, False])
def test_a_gap_counts_less_the_levels_of_both(meta: RuleBook, ahead: bool) -> None:
    """Both at 10 m/s: the RSS distance is 12.04 m for an ego or a follower at that speed."""
    needed = rss_m(10.0, 10.0)
    for level, extra, free in ((0.0, 0.1, True), (0.0, -0.1, False), (3.0, 0.1, False), (3.0, 3.1, True)):
        gap = (needed + 5.0 + extra) * (1.0 if ahead else -1.0)
        shown = moment(meta, traffic__v0_present=1.0, traffic__v0_left_lane=1.0, traffic__v0_lane_offset=-4.0,
                       traffic__v0_lane_gap=gap, traffic__v0_length=5.0, traffic__v0_pl_at=level)  # fmt: skip
        assert bool(meta.permitted(shown)[LEFT]) is free, (level, extra)
        assert meta.permitted(shown)[RIGHT]
    wide = moment(meta, traffic__v0_present=1.0, traffic__v0_lane_offset=-4.0, traffic__v0_lane_gap=-2.0,
                  traffic__v0_length=5.0, traffic__v0_pl_ct=2.5)  # fmt: skip
    assert not meta.permitted(wide)[LEFT]
    assert meta.permitted(wide)[RIGHT]


@pytest.mark.parametrize("gap", [3.0, 0.0, -3.0])
def test_a_leader_that_may_be_ahead_counts_wherever_it_is_believed(meta: RuleBook, gap: float) -> None:
    """With a level of 4 m it may be ahead of the ego: no gap is left. With 2 m one behind is behind."""
    there = {"traffic__v0_present": 1.0, "traffic__v0_length": 5.0, "traffic__v0_lane_gap": gap}
    own = {**there, "traffic__v0_own_lane": 1.0, "traffic__v0_velocity_ahead": -10.0}
    assert float(meta.speeds(moment(meta, traffic__v0_pl_at=4.0, **own))["rss"]) == pytest.approx(0.0, abs=1e-6)
    assert np.isinf(meta.speeds(moment(meta, traffic__v0_pl_at=2.0, **own))["rss"]) == (gap <= -2.0)
    beside = {**there, "traffic__v0_left_lane": 1.0, "traffic__v0_lane_offset": -4.0, "traffic__v0_pl_at": 4.0}
    assert not meta.permitted(moment(meta, **beside))[LEFT]


def test_a_missing_level_of_a_vehicle_forbids_the_change_and_counts_40_m(meta: RuleBook) -> None:
    there = {"traffic__v0_present": 1.0, "traffic__v0_length": 5.0, "traffic__v0_lane_offset": -4.0}
    far = {**there, "traffic__v0_left_lane": 1.0, "traffic__v0_pl_at": 20.0}
    for gap in (-140.0, 140.0):
        assert meta.permitted(moment(meta, traffic__v0_lane_gap=gap, **far))[LEFT]
        missing = moment(meta, traffic__v0_lane_gap=gap, traffic__v0_pl_exists=0.0, **far)
        assert not meta.permitted(missing)[LEFT]
        assert meta.project(missing, np.array(LEFT)).by["gap"]
    own = {"traffic__v0_present": 1.0, "traffic__v0_length": 5.0, "traffic__v0_own_lane": 1.0}
    ahead = {**own, "traffic__v0_lane_gap": 60.0, "traffic__v0_velocity_ahead": -5.0}
    for level, room in ((20.0, 15.0), (40.0, 15.0)):
        safe = float(meta.speeds(moment(meta, traffic__v0_pl_exists=0.0, traffic__v0_pl_at=level, **ahead))["rss"])
        assert rss_m(safe, 5.0) == pytest.approx(room, abs=1e-3)


def test_a_lane_that_closes_is_as_a_standing_vehicle_and_not_entered() -> None:
    with closing(open_env("WorkZone", PERFECT | {"observation": {"form": "flat"}})) as env:
        book = RuleBook(env)
        there = {"ego__speed": 10.0, "road__closure_known": 1.0, "road__closure_end": 150.0, "integrity__pl_at": 2.0}
        own = moment(book, road__closure_own=1.0, road__closure_start=42.5, **there)
        c = env.config.cost
        rho = max(c.response_s, env.dt_s)
        v = float(book.speeds(own)["rss"])
        # Definition 1 of Shalev-Shwartz et al. 2017 for the 38 m from the bumper less PL_AT, behind what stands.
        fast = v + c.accelerate_mps2 * rho
        needed = v * rho + 0.5 * c.accelerate_mps2 * rho**2 + fast**2 / (2.0 * c.brake_min_mps2)
        assert needed == pytest.approx(42.5 - 2.5 - 2.0, rel=1e-3)
        assert not any(forbids.any() for forbids in book.closed(own, 1).values())
        right = moment(book, road__closure_right=1.0, road__closure_start=42.5, **there)
        assert np.isinf(book.speeds(right)["rss"])
        assert book.closed(right, 1)["gap"]
        assert not book.closed(right, -1)["gap"]
        changing = moment(book, road__closure_right=1.0, road__closure_start=42.5, ego__target_right=1.0, **there)
        assert float(book.speeds(changing)["rss"]) == pytest.approx(v, rel=1e-6)
        behind = there | {"road__closure_start": -80.0, "road__closure_end": -10.0}
        passed = moment(book, road__closure_own=1.0, **behind)
        assert np.isinf(book.speeds(passed)["rss"]), "it lies behind"


def test_a_leader_bounds_target_speed_and_acceleration(meta: RuleBook, direct: RuleBook) -> None:
    ahead = {"traffic__v0_present": 1.0, "traffic__v0_own_lane": 1.0, "traffic__v0_length": 5.0}
    near = moment(meta, traffic__v0_lane_gap=14.0, traffic__v0_velocity_ahead=-5.0, **ahead)
    assert meta.permitted(near).tolist() == [False, False, False, False, True]
    safe = float(direct.speeds(near)["rss"])
    assert rss_m(safe, 5.0) == pytest.approx(9.0, abs=1e-3)
    found = direct.project(near, np.float32([1.0, 0.0]))
    assert found.by["rss"]
    assert value_of(found.actions[0].astype(float), (-5.0, 5.0)) == pytest.approx(
        max((safe - 10.0) / 0.5, -4.0), abs=1e-5
    )
    harder = np.float32([-1.0, 0.0])
    assert np.array_equal(direct.project(near, harder).actions, harder)


def test_lanes_that_are_closed_bound_the_steering(direct: RuleBook) -> None:
    hard = np.float32([0.0, 0.3])
    assert np.array_equal(
        direct.project(moment(direct, ego__speed=5.0), np.float32([0.0, 0.02])).actions, [0.0, np.float32(0.02)]
    )
    _, open_high, _ = direct.steering_bounds(moment(direct))
    _, shut_high, closed = direct.steering_bounds(moment(direct, integrity__alert=1.0))
    assert shut_high < open_high
    assert closed[1]["alert"]
    found = direct.project(moment(direct, integrity__alert=1.0), hard)
    assert found.by["alert"]
    assert not found.by["lane"]
    assert value_of(found.actions[1].astype(float), direct._inner.steering_range) == pytest.approx(
        float(shut_high), abs=1e-6
    )
    end = direct.project(moment(direct, ego__right_exists=0.0), hard)
    assert end.by["lane"]
    assert not end.by["alert"]
    alone = RuleBook(direct_env(), SafetyRules.load({**OFF, "alert": True}))
    assert not alone.project(moment(alone), hard).changed
    assert alone.project(moment(alone, integrity__alert=1.0), hard).by["alert"]


def direct_env() -> Any:
    return open_env("Highway", PERFECT | {"action": "continuous", "observation": {"form": "flat"}})


def test_wrong_environments_and_rules_are_refused() -> None:
    env = open_env("LaneKeeping", PERFECT)
    cases = [
        (lambda: SafetyLayer(open_env("LaneKeeping", {"observation": {"integrity": "blind"}})), "integrity.alert"),
        (lambda: SafetyLayer(open_env("LaneKeeping", {"observation": {"integrity": "clock"}})), "integrity.alert"),
        (lambda: SafetyLayer(open_env("Highway", {"observation": {"vehicles": 0}})), "vehicles must be > 0"),
        (lambda: SafetyLayer(open_env("LaneKeeping", {"observation": {"preview_m": []}})), "preview_m"),
        (lambda: SafetyLayer(FlattenObservation(env)), "FlattenObservation must be around SafetyLayer"),
        (lambda: SafetyLayer(Spy(Falsified(env))), r"Falsified\(SafetyLayer\(env\)\)"),
        (lambda: SafetyLayer(TransformAction(env, lambda a: -a, None)), "TransformAction must be around SafetyLayer"),
        (lambda: SafetyLayer(FrameStackObservation(env, 2)), "observation_space must be that of the environment"),
        (lambda: SafetyLayer(RescaleAction(env, np.float32(-0.5), np.float32(0.5))), "RescaleAction must be around"),
        (lambda: SafetyLayer(SafetyGymnasium(env)), "SafetyGymnasium must be around"),
        (lambda: SafetyLayer(Spy(SafetyGymnasium(env))), "SafetyGymnasium must be around"),
        (lambda: SafetyLayer(gymnasium.make("CartPole-v1")), "env must be a single environment of lanebound"),
        (lambda: SafetyLayer(env, {"alrt": False}), "rules.alrt"),
        (lambda: SafetyLayer(env, {"least_share": 2.0}), "rules.least_share must lie in"),
        (lambda: SafetyLayer(env).step(env.action_space.sample()), "reset must come before step"),
        (lambda: VecSafetyLayer(DummyVecEnv([lambda: gymnasium.make("CartPole-v1")])), "venv must hold"),
        (lambda: make_agent("layer", env, {"over": "layer"}), "over must be another agent"),
        (lambda: make_agent("layer+layer", env), "over must be another agent than layer, got layer"),
        (lambda: make_agent("nominal+layer+layer", env), r"over must be another agent than layer, got nominal\+layer"),
        (lambda: make_agent("cbf+layer", env), "over must have no memory of its commands, got cbf"),
        (lambda: make_agent("layer", env, {"over": "mpc"}), "over must have no memory of its commands, got mpc"),
        (lambda: refuse_early(agent="mpc+layer"), "over must have no memory of its commands, got mpc"),
        (lambda: SuiteConfig.load({"envs": ["Merge"], "agents": ["cbf+layer"]}), "no memory of its commands, got cbf"),
    ]  # fmt: skip
    for make, message in cases:
        with pytest.raises((InputError, ConfigError), match=message):
            make()
    layered = SafetyLayer(env)
    layered.reset(seed=1)
    with pytest.raises(InputError, match="action must be finite"):
        layered.step(np.float32([np.nan, 0.0]))
    with pytest.raises(InputError, match="there is nothing to mask"):
        layered.action_masks()
    assert layered.book.project(layered._seen, np.array([1, 1])).actions.dtype == np.float32
    SafetyLayer(open_env("Highway", {"observation": {"vehicles": 0}}), {"gap": False, "rss": False})
    SafetyLayer(open_env("LaneKeeping", {"observation": {"integrity": "blind"}}), OFF)


def test_wrappers_of_observations_are_around_the_layer() -> None:
    flat = {**PERFECT, "duration_s": 2.0, "observation": {"form": "flat"}}
    venv = EngineVecEnv("lanebound/LaneKeeping-v0", 2, flat)
    for inside, message in (
        (VecNormalize(venv), "VecNormalize must be around"),
        (VecFrameStack(venv, 2), "observation_space"),
    ):
        with pytest.raises(InputError, match=message):
            VecSafetyLayer(inside)
    early = VecSafetyLayer(venv)
    with pytest.raises(InputError, match="reset must come before step"):
        early.step(np.zeros((2, 2), dtype=np.float32))
    venv.close()
    meta = VecSafetyLayer(EngineVecEnv("lanebound/Merge-v0", 2, flat))
    with pytest.raises(InputError, match="reset must come before action_masks"):
        meta.action_masks()
    meta.close()


def test_the_environment_that_is_asked_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    venv, closed = EngineVecEnv("lanebound/LaneKeeping-v0", 2, {**PERFECT, "observation": {"form": "flat"}}), []
    monkeypatch.setattr(DrivingEnv, "close", lambda env: closed.append(env))
    VecSafetyLayer(venv)
    with pytest.raises(ConfigError):
        VecSafetyLayer(venv, {"alrt": False})
    assert len(closed) == 2
    venv.close()


@pytest.mark.parametrize("history", [1, 3])
@pytest.mark.parametrize("name", ["Merge", "CarFollowing"])
def test_single_equals_vector_over_ends_of_episodes(name: str, history: int) -> None:
    config = {**PERFECT, "duration_s": 1.0, "observation": {"form": "flat", "history": history}}
    vector = VecSafetyLayer(EngineVecEnv(f"lanebound/{name}-v0", 2, config))
    one = VecSafetyLayer(DummyVecEnv([lambda: open_env(name, config)] * 2))
    for envs in (vector, one):
        envs.seed(1000)
    many, alone = vector.reset(), one.reset()
    vector.action_space.seed(2)
    ends = changed = 0
    for _ in range(30):
        np.testing.assert_allclose(many, alone, atol=1e-5)
        if name == "Merge":
            assert np.array_equal(vector.action_masks(), one.action_masks())
        actions = np.stack([vector.action_space.sample() for _ in range(2)])
        many, _, over, infos = vector.step(actions)
        alone, _, ended, others = one.step(actions)
        assert np.array_equal(over, ended)
        for info, other in zip(infos, others, strict=True):
            assert info["intervened_by"] == other["intervened_by"]
            assert info.get(INTERVENTIONS_KEY) == other.get(INTERVENTIONS_KEY)
            changed += info["intervened"]
        ends += int(over.sum())
    assert ends >= 4
    assert changed
    vector.close()


def test_it_is_copied_and_made_anew_with_its_rules() -> None:
    env = SafetyLayer(open_env("LaneKeeping", PERFECT), {"bend": False})
    again = pickle.loads(pickle.dumps(env))
    assert again.book.rules == env.book.rules == SafetyRules(bend=False)


@pytest.mark.parametrize("learner", [PPO, MaskablePPO])
def test_ppo_and_maskable_ppo_learn_two_updates(learner: Any) -> None:
    config = {**PERFECT, "duration_s": 3.0, "observation": {"form": "flat"}}
    env = VecSafetyLayer(EngineVecEnv("lanebound/Merge-v0", 2, config))
    model = learner("MlpPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=1, device="cpu")
    assert model.learn(64).num_timesteps == 64
    env.close()


@pytest.mark.parametrize(("name", "engine"), [("LaneKeeping", True), ("Merge", True), ("CarFollowing", False)])
def test_an_experiment_trains_under_the_layer(name: str, engine: bool) -> None:
    def taken(penalty: float, **more: Any) -> tuple[np.ndarray, list[Any]]:
        changes = {"env": name, "shield": "layer", "shield_penalty": penalty, "engine": engine, "overrides": PERFECT}
        env = for_learning(experiment(**changes, **more), 1)
        env.reset()
        bold = 3 if name == "Merge" else np.float32([1.0, 1.0])
        _, rewards, _, infos = env.step(np.stack([bold] * env.num_envs))
        env.close()
        return rewards, infos

    (free, infos), (dear, _) = taken(0.0), taken(1.0)
    assert all(info["shielded"] and info["intervened_by"] for info in infos)
    assert (free > dear).all()
    assert not any(info["shielded"] for info in taken(0.0, rules=OFF)[1])


def test_a_learnt_policy_is_judged_under_its_rules(tmp_path: Any) -> None:
    chosen = learnt_agent(experiment(shield="layer", rules={"bend": False}), tmp_path / "best.zip")
    assert chosen["agent"] == "layer"
    assert (chosen["figures"]["over"], chosen["figures"]["bend"]) == (str(tmp_path / "best.zip"), False)


def test_a_checkpoint_drives_under_the_layer(tmp_path: Any) -> None:
    config = {**PERFECT, "duration_s": 3.0, "observation": {"form": "flat"}}
    learning = EngineVecEnv("lanebound/LaneKeeping-v0", 2, config)
    model = PPO("MlpPolicy", learning, n_steps=16, batch_size=16, n_epochs=1, seed=1, device="cpu").learn(32)
    learning.close()
    with torch.no_grad():
        model.policy.action_net.weight[:] = 0.0
        model.policy.action_net.bias[:] = torch.tensor([0.0, 1.0])
    model.save(tmp_path / "tiny.zip")
    env = open_env("LaneKeeping", config)
    free, bound = (make_agent(name, env) for name in (str(tmp_path / "tiny.zip"), f"{tmp_path / 'tiny.zip'}+layer"))
    observation, _ = env.reset(seed=1)
    apart = 0
    for _ in range(10):
        wanted, action = free.predict(observation)[0], bound.predict(observation)[0]
        apart += int(not np.array_equal(wanted, action))
        observation, *_ = env.step(action)
    assert bound.counts["decisions"] == 10
    assert 0 < apart == bound.counts["intervened"], wanted


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rules": {"gap": False}}, "rules must be left out for shield none"),
        ({"rules": {"gap": False}, "shield": "cbf"}, "rules must be left out for shield cbf"),
        *(
            (
                {"shield": "layer", "overrides": {"observation": {"integrity": shown}}},
                "overrides.observation.integrity must be",
            )
            for shown in ("blind", "clock", "oracle")
        ),
    ],
)
def test_experiments_that_the_layer_cannot_bind_are_refused_when_loaded(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        experiment(**changes)
    experiment(rules={})
    experiment(shield="layer", rules={"gap": False}, overrides={"observation": {"integrity": "full"}})


def test_a_driver_that_is_imitated_under_the_layer_teaches_what_is_carried_out() -> None:
    changes: dict[str, Any] = {"env": "Merge", "overrides": {"sky": "dense"}, "shield": "layer", "sky": "dense"}
    config = experiment(**changes, imitation={"driver": "nominal", "rounds": 1, "decisions": 8, "epochs": 1})
    teacher = teacher_of(config)
    assert teacher is not None
    with closing(for_learning(teacher.experiment, 1)) as env:
        observations, changed = env.reset(), 0
        for _ in range(20):
            wanted, _ = teacher.driver.predict(observations)
            observations, _, _, infos = env.step(wanted)
            changed += sum(info["shielded"] for info in infos)
    assert changed == 0
    assert teacher.driver.counts["intervened"] > 0


def test_a_driver_with_the_layer_has_a_name_of_its_own() -> None:
    suite = SuiteConfig.load({"envs": ["Merge"], "agents": ["nominal", "nominal+layer"]})
    assert suite.agents["nominal+layer"].agent == "layer"
    assert suite.agents["nominal+layer"].figures == {"over": "nominal"}
    env = open_env("Merge", PERFECT | {"duration_s": 3.0})
    named, made = make_agent("random+layer", env), make_agent("layer", env, {"over": "random", "level": False})
    observation, _ = env.reset(seed=1)
    named.reseed(2)
    for driver in (named, made):
        assert env.action_space.contains(driver.predict(observation)[0])
        assert driver.counts["decisions"] == 1
    assert not made.config.level
