"""The belief between and at epochs, against the formulas written plainly for one car."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork

from lanebound.envs.batch.belief_kernel import ACCELERATION_S, FIX, STANDSTILL_MPS, begin, coast, settle, take
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.records_kernel import BELIEF, RULES, TRACK
from lanebound.envs.navigation import NavigationConfig
from lanebound.envs.records import xy_of
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.monitoring.alerts import AlertReason

COUNT, BOUND_M, LIMITS_M, STEP_S, EPOCH_S = 4, 0.1, (1.5, 0.6), 0.05, 0.1
FREE = NavigationConfig()


def _fixes(rng: np.random.Generator) -> Records:
    """Solutions that jump now and then, some without a level."""
    values = np.zeros(COUNT, FIX)
    values["alert"], values["available"] = rng.random(COUNT) < 0.2, rng.random(COUNT) < 0.8
    values["position_en_m"] = rng.normal(0.0, 0.4, (COUNT, 2))
    values["heading_rad"] = rng.uniform(-7.0, 7.0, COUNT)
    values["speed_mps"] = np.where(rng.random(COUNT) < 0.2, 0.0, rng.uniform(0.0, 20.0, COUNT))
    values["pl_at_m"], values["pl_ct_m"] = rng.uniform(0.1, 2.5, (2, COUNT))
    values["pl_ct_m"][rng.random(COUNT) < 0.1] = np.inf
    return values


@dataclass
class Plain:
    """The pose of one car: the solution, carried on; jumps fade."""

    shift: Any
    position: Any
    heading: float
    fix: dict[str, Any]
    residual: Any = field(default_factory=lambda: np.zeros(2))
    rate: float = 0.0
    acceleration: float = 0.0

    def coast(self, dt: float) -> None:
        middle = self.heading + 0.5 * dt * self.rate
        self.position = self.position + dt * self.fix["speed"] * np.array([math.cos(middle), math.sin(middle)])
        self.heading += dt * self.rate

    def take(self, fix: dict[str, Any]) -> None:
        turned = math.remainder(fix["heading"] - self.fix["heading"], 2.0 * math.pi)
        start, speed = self.heading, self.fix["speed"]
        self.coast(STEP_S)
        jump = fix["position"] - self.position
        if math.hypot(*jump) > FREE.jump_m:
            self.residual = self.residual - jump
        self.residual = self.residual * math.exp(-EPOCH_S / FREE.smoothing_s)
        self.rate = turned / EPOCH_S if abs(fix["speed"]) > STANDSTILL_MPS else 0.0
        share = 1.0 - math.exp(-EPOCH_S / ACCELERATION_S)
        self.acceleration += share * ((fix["speed"] - speed) / EPOCH_S - self.acceleration)
        self.position, self.fix = fix["position"], fix
        self.heading = start + math.remainder(fix["heading"] - start, 2.0 * math.pi)

    @property
    def levels(self) -> tuple[float, float]:
        s, c = math.sin(self.heading), math.cos(self.heading)
        x, y = self.residual
        return self.fix["pl"][0] + abs(c * x + s * y) + BOUND_M, self.fix["pl"][1] + abs(c * y - s * x) + BOUND_M


def _fix(fix: Any) -> dict[str, Any]:
    return {
        "position": xy_of(fix["position_en_m"]),
        "heading": math.remainder(float(fix["heading_rad"]) - 0.5 * math.pi, 2.0 * math.pi),
        "speed": float(fix["speed_mps"]),
        "pl": (float(fix["pl_at_m"]), float(fix["pl_ct_m"])),
        "alert": bool(fix["alert"]),
        "available": bool(fix["available"]),
    }


def test_poses_levels_and_alerts_follow_the_solutions() -> None:
    rng, lanes = np.random.default_rng(1), lane_table(RoadNetwork.straight_road_network(2)).lanes
    figures: dict[str, Any] = dict.fromkeys(RULES.names or (), 0)
    figures |= {name: np.zeros(1, RULES[name]) for name in ("rewards", "costs")}
    figures |= {"step_s": STEP_S, "epoch_s": EPOCH_S, "jump_m": FREE.jump_m, "smoothing_s": FREE.smoothing_s}
    figures |= {"map_bound_m": BOUND_M, "al_at_m": LIMITS_M[0], "al_ct_m": LIMITS_M[1]}
    codes = {"reason_at": AlertReason.PL_AT, "reason_ct": AlertReason.PL_CT, "reason_both": AlertReason.BOTH}
    rules = one_record(RULES, **(figures | {name: reason.code for name, reason in codes.items()}))[0]
    shift, tracks, belief = rng.normal(0.0, 0.03, (COUNT, 2)), np.zeros(COUNT, TRACK), np.zeros(COUNT, BELIEF)
    fixes, plain = _fixes(rng), list[Plain]()
    for n in range(COUNT):
        begin(tracks[n], belief[n], fixes[n], *shift[n])
        fix = _fix(fixes[n])
        plain.append(Plain(shift[n], fix["position"], fix["heading"], fix))
    reasons = set()
    for _ in range(40):
        for n in range(COUNT):
            coast(tracks[n], STEP_S)
            settle(tracks[n], belief[n], lanes, STEP_S, rules)
        fixes = _fixes(rng)
        for n, car in enumerate(plain):
            take(tracks[n], belief[n], fixes[n], rules)
            settle(tracks[n], belief[n], lanes, STEP_S, rules)
            car.coast(STEP_S)
            car.take(_fix(fixes[n]))
            b, place = belief[n], car.position + car.residual + car.shift
            np.testing.assert_allclose([b["x_m"], b["y_m"], b["speed_mps"]], [*place, car.fix["speed"]], atol=1e-12)
            np.testing.assert_allclose(b["heading_rad"], car.heading, atol=1e-9)
            found = b["yaw_rate_radps"], b["acceleration_mps2"]
            np.testing.assert_allclose(found, [car.rate, car.acceleration], atol=1e-9)
            np.testing.assert_allclose([b["pl_at_m"], b["pl_ct_m"]], car.levels, atol=1e-12)
            over = car.levels[0] > LIMITS_M[0] or car.levels[1] > LIMITS_M[1]
            assert bool(b["alert"]) == (car.fix["alert"] or over)
            assert bool(b["available"]) == (car.fix["available"] and not over)
        reasons |= set(belief["reason"].tolist())
    assert len(reasons) >= 4, "none, along, across and both must occur"
