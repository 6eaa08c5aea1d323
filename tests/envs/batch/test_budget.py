"""Alert limits from a budget: a car that is off by no more than its limits stays in its lane and off its leader."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import RoadNetwork

import lanebound.envs  # noqa: F401
from lanebound.agents.drivers import make_agent
from lanebound.envs.alert_limits import BudgetConfig
from lanebound.envs.batch.budget_kernel import budget_limits, permitted_mps
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.lanes_kernel import centre, local, width_at
from lanebound.envs.batch.records_kernel import BELIEF, BUDGET, CAR, PERCEIVED, RULES, SCORE
from lanebound.envs.batch.route_map import Reach, routes_of
from lanebound.envs.batch.rules import cost_figures
from lanebound.envs.costs import CostConfig
from lanebound.envs.ids.streets import LaneKeeping
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.monitoring.alerts import AlertReason

FIGURES = BudgetConfig()
WIDTH_M, RADIUS_M, POLICY_S = 4.0, 40.0, 0.5
LENGTH_M, HALF_BODY_M = 5.0, 1.0
BUDGET_ON: dict[str, Any] = {"alert_limit": "budget", "sky": "open", "faults": "none"}


def bend() -> RoadNetwork:
    """100 m along x, a quarter of a circle to the right, and straight on."""
    network, kind = RoadNetwork(), {"width": WIDTH_M, "speed_limit": 10.0}
    network.add_lane("a", "b", StraightLane([0.0, 0.0], [100.0, 0.0], **kind))
    network.add_lane("b", "c", CircularLane([100.0, RADIUS_M], RADIUS_M, -0.5 * math.pi, 0.0, True, **kind))
    network.add_lane("c", "d", StraightLane([100.0 + RADIUS_M, RADIUS_M], [100.0 + RADIUS_M, 400.0], **kind))
    return network


class Scene:
    """A belief on a network, and its limits."""

    def __init__(self, network: RoadNetwork, **changes: Any) -> None:
        self.lanes, self.routes = lane_table(network).lanes, routes_of(network, Reach(50.0, 300.0, 0.0))
        figures: dict[str, Any] = dict.fromkeys(RULES.names or (), 0)
        figures |= {name: np.zeros(1, RULES[name]) for name in ("rewards",)}
        given = BudgetConfig(**changes)
        figures |= {
            "policy_s": POLICY_S, "keep_lane": 1, "costs": cost_figures(CostConfig()), "budgets": 1,
            "budget": one_record(BUDGET, **{name: getattr(given, name) for name in BUDGET.names or ()}),
        }  # fmt: skip
        self.rules = one_record(RULES, **figures)[0]
        self.car = np.zeros(1, CAR)[0]
        self.car["length"], self.car["width"] = LENGTH_M, 2.0 * HALF_BODY_M
        self.score = np.zeros(1, SCORE)[0]
        self.score["leaving_side"] = -1
        self.seen = np.zeros(1, PERCEIVED)

    def belief(self, lane: int, station: float, aside: float = 0.0, angle: float = 0.0, speed: float = 10.0) -> Records:
        """A believed pose on a lane."""
        x, y, heading, _ = centre(self.lanes, lane, station)
        b = np.zeros(1, BELIEF)[0]
        b["x_m"], b["y_m"] = x - aside * math.sin(heading), y + aside * math.cos(heading)
        b["heading_rad"], b["speed_mps"], b["lane"], b["path"] = heading + angle, speed, lane, lane
        b["longitudinal_m"], b["lateral_m"], b["angle_rad"] = station, aside, angle
        b["lane_width_m"] = width_at(self.lanes, lane, station)
        return b

    def limits(self, b: Records, count: int = 0) -> tuple[float, float]:
        """Along and across [m]."""
        along, across = budget_limits(
            b, b["speed_mps"], self.score, self.car, self.seen, count, self.lanes, self.routes.map, self.rules
        )
        return float(along), float(across)

    def follow(self, b: Records, gap_m: float, speed_mps: float, level_m: float, relative: int = 0) -> None:
        """Perceive a leader so far ahead, bumper to bumper."""
        x, y, heading, _ = centre(self.lanes, int(b["lane"]), float(b["longitudinal_m"]) + gap_m + LENGTH_M)
        self.seen[0] = np.zeros((), PERCEIVED)
        self.seen["x_m"], self.seen["y_m"], self.seen["heading_rad"] = x, y, heading
        self.seen["speed_mps"], self.seen["pl_at_m"], self.seen["relative"] = speed_mps, level_m, relative
        self.seen["length_m"], self.seen["width_m"] = LENGTH_M, 2.0 * HALF_BODY_M


def test_on_a_straight_lane_the_room_is_what_body_and_offset_leave() -> None:
    scene = Scene(bend())
    along, across = scene.limits(scene.belief(0, 20.0))
    assert along == FIGURES.most_m
    assert across == pytest.approx(0.5 * WIDTH_M - HALF_BODY_M - FIGURES.tracking_m)
    assert scene.limits(scene.belief(0, 20.0, aside=-0.3))[1] == pytest.approx(0.7)
    turned = HALF_BODY_M * math.cos(0.1) + 0.5 * LENGTH_M * math.sin(0.1)
    assert scene.limits(scene.belief(0, 20.0, angle=-0.1))[1] == pytest.approx(1.9 - turned)
    away = 10.0 * POLICY_S * math.sin(0.01) + HALF_BODY_M * math.cos(0.01) + 0.5 * LENGTH_M * math.sin(0.01)
    assert scene.limits(scene.belief(0, 20.0, aside=0.3, angle=0.01))[1] == pytest.approx(1.7 - away)
    assert scene.limits(scene.belief(0, 20.0, aside=1.5)) == (FIGURES.most_m, FIGURES.least_m)


def test_a_car_that_is_off_by_its_limits_stays_in_its_lane() -> None:
    """Positions that are wrong by the limits along and across their heading, on straights, bends and between."""
    rng, scene, tried, tightest = np.random.default_rng(3), Scene(bend(), least_m=0.01), 0, math.inf
    for _ in range(2000):
        lane = int(rng.integers(3))
        station = float(rng.uniform(20.0 if lane == 0 else 0.0, (100.0, 0.5 * math.pi * RADIUS_M, 40.0)[lane]))
        b = scene.belief(lane, station, aside=float(rng.uniform(-1.0, 1.0) * FIGURES.tracking_m), speed=2.0)
        along, across = scene.limits(b)
        at, ct = rng.choice([-1.0, 0.0, 1.0]) * along, rng.choice([-1.0, 0.0, 1.0]) * across
        c, s = math.cos(b["heading_rad"]), math.sin(b["heading_rad"])
        x, y = b["x_m"] - at * c + ct * s, b["y_m"] - at * s - ct * c
        for u in (-0.5, 0.0, 0.5):
            for v in (-1.0, 1.0):
                corner = x + u * LENGTH_M * c - v * HALF_BODY_M * s, y + u * LENGTH_M * s + v * HALF_BODY_M * c
                away = min(_beyond(scene, n, *corner) for n in range(3))
                assert away < 0.03, (lane, station, at, ct)
                tightest = min(tightest, -away) if u else tightest
                tried += 1
    assert tried == 12000
    assert tightest < 0.05, "the limits use what there is"


def _beyond(scene: Scene, lane: int, x: float, y: float) -> float:
    """How far a point is outside of a lane, infinite beyond its ends."""
    s, r, _ = local(scene.lanes, lane, x, y)
    inside = -LENGTH_M <= s <= scene.lanes.table[lane]["length_m"] + LENGTH_M
    return abs(r) - 0.5 * WIDTH_M if inside else math.inf


def test_behind_a_leader_reaction_and_braking_are_taken_off_the_gap() -> None:
    scene = Scene(bend())
    b = scene.belief(0, 20.0)
    costs = CostConfig()
    scene.follow(b, gap_m=30.0, speed_mps=6.0, level_m=2.0)
    needed = 10.0 * (costs.response_s + POLICY_S) + (100.0 - 36.0) / (2.0 * costs.brake_min_mps2)
    assert scene.limits(b, 1)[0] == pytest.approx(30.0 - 2.0 - needed)
    scene.follow(b, gap_m=30.0, speed_mps=6.0, level_m=2.0, relative=1)
    assert scene.limits(b, 1)[0] == FIGURES.most_m, "a sensor measures the gap itself"
    scene.follow(b, gap_m=-6.0, speed_mps=0.0, level_m=2.0)
    assert scene.limits(b, 1)[0] == FIGURES.least_m, "it may be ahead"
    scene.follow(b, gap_m=-9.0, speed_mps=0.0, level_m=2.0)
    assert scene.limits(b, 1)[0] == FIGURES.most_m, "it is behind"
    scene.follow(b, gap_m=5.0, speed_mps=6.0, level_m=math.inf)
    assert scene.limits(b, 1)[0] == FIGURES.least_m


def test_a_level_permits_the_speed_at_which_it_sweeps_what_the_limits_may() -> None:
    """On a straight lane of 10 m/s: half of it where a level equals its limit, less in proportion to the level."""
    scene, share = Scene(bend()), CostConfig().alert_speed_share
    b, room = scene.belief(0, 20.0), 0.5 * WIDTH_M - HALF_BODY_M - FIGURES.tracking_m

    def permitted(count: int = 0, **levels: float) -> float:
        for name, value in levels.items():
            b[name] = value
        found = permitted_mps(b, scene.score, scene.car, scene.seen, count, scene.lanes, scene.routes.map, scene.rules)
        return float(found)

    assert permitted(pl_ct_m=5.0 * room, alert=0) == 10.0
    assert permitted(pl_ct_m=room, alert=1) == pytest.approx(10.0 * share, abs=0.02)
    assert permitted(pl_ct_m=2.0 * room) == pytest.approx(5.0 * share, abs=0.02)
    assert permitted(pl_ct_m=0.4 * room) == 10.0 * share  # an alert all the same
    assert permitted(pl_ct_m=math.inf) == pytest.approx(2.5)
    scene.rules["costs"]["alert_speed_least"] = 0.0
    assert permitted(pl_ct_m=math.inf) == 0.0
    scene.follow(b, gap_m=10.0, speed_mps=0.0, level_m=2.0)
    v = permitted(1, pl_ct_m=0.0, pl_at_m=6.0)
    left = 8.0 - v * (CostConfig().response_s + POLICY_S) - v * v / (2.0 * CostConfig().brake_min_mps2)
    assert v * 6.0 == pytest.approx(10.0 * share * left, abs=0.3)  # the limit along at that speed
    assert permitted(1, pl_at_m=12.0) < v < 10.0 * share
    scene.rules["budgets"], b["al_at_m"], b["al_ct_m"] = 0, 1.5, 1.0
    assert permitted(0, pl_at_m=3.0) == pytest.approx(5.0 * share, abs=0.02)


def test_before_the_end_of_a_lane_and_where_courses_cross_half_a_lane_is_left() -> None:
    scene = Scene(bend())
    end = float(scene.lanes.table[2]["length_m"])
    assert scene.limits(scene.belief(2, end - 100.0))[0] == FIGURES.most_m
    assert scene.limits(scene.belief(2, end - 10.0))[0] == FIGURES.crossing_m
    env = gymnasium.make("lanebound/Intersection-v0", config=BUDGET_ON).unwrapped
    _, info = env.reset(seed=1)
    assert info["al_at_m"] <= FIGURES.crossing_m


def test_limits_follow_the_moment_and_their_alert_is_held() -> None:
    """With a position that is given and off by 0.5 m, alerted wherever the room is less."""
    config = {**BUDGET_ON, "navigation": {"source": "offset", "offset_ct_m": 0.45}, "perception": {"source": "none"}}
    env = LaneKeeping(config)
    seen, info = env.reset(seed=4)
    driver = make_agent("nominal", env)
    hold_s, since, reasons, limits = env.config.budget.hold_s, math.inf, set(), set()
    for n in range(200):
        seen, _, terminated, truncated, info = env.step(driver.predict(seen, deterministic=True)[0])
        over = info["pl_at_m"] > info["al_at_m"] or info["pl_ct_m"] > info["al_ct_m"]
        since = 0.0 if over else since + env.dt_s
        assert info["available"] == (not over)
        if not hold_s - 1e-9 < since < hold_s + env.dt_s + 1e-9:  # old limits hold up to a decision
            assert info["alert"] == (since < hold_s), n
        reasons.add(info["reason"])
        limits.add(round(info["al_ct_m"], 3))
        if terminated or truncated:
            seen, info = env.reset(seed=4 + n)
            since = 0.0 if info["alert"] else math.inf
    assert {AlertReason.PL_CT.code, AlertReason.HOLDING.code} <= reasons
    assert len(limits) > 5


def test_figures_that_make_no_sense_are_refused() -> None:
    for changes, message in (
        ({"alert_limit": "budgets"}, "alert_limit must be one of 'fixed' or 'budget'"),
        ({"alert_limit": "budget", "al_ct_m": 0.5}, "al_ct_m must be left out with alert_limit 'budget'"),
        ({"alert_limit": "budget", "al_at_m": 2.0}, "al_at_m must be left out with alert_limit 'budget'"),
        ({"budget": {"tracking_m": 0.3}}, "budget must be left out with alert_limit 'fixed'"),
        ({"alert_limit": "budget", "budget": {"least_m": 3.0, "most_m": 2.0}}, "budget.least_m must be <= most_m"),
        ({"alert_limit": "budget", "budget": {"least_m": 2.0}}, "budget.least_m must be <= crossing_m"),
        ({"alert_limit": "budget", "budget": {"most_m": 15.0}}, "budget.most_m must be <= observation.pl_max_m"),
        ({"alert_limit": "budget", "budget": {"bend_share": 1.0}}, r"budget.bend_share must lie in \[0, 1\)"),
    ):
        with pytest.raises(ConfigError, match=message):
            gymnasium.make("lanebound/LaneKeeping-v0", config=changes)
