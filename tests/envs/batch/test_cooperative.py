"""Cooperative perception: levels hold, liars are found and honest senders kept, and messages are sent as CAM."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from lanebound.envs.batch import cooperative_kernel as ck
from lanebound.envs.batch.belief_kernel import FIX
from lanebound.envs.batch.perception import PerceptionBatch
from lanebound.envs.batch.records_kernel import CAR, EGO
from lanebound.envs.perception import PerceptionConfig
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import deep_merge
from lanebound.integrity.monitoring.risk import upper_quantile

DT, TAIL = 0.1, 1e-6
CLEAR = {"latency_s": 0.0, "jitter_s": 0.0, "loss": 0.0}
SIGMAS = float(upper_quantile(np.array(1e-5 / 4.0)))


class Fleets:
    """N fleets of an ego at the origin and others at places (N, C, 2), which drive along x at their speeds.

    Levels of all are ``level_m``; their errors stay for an episode and have a sigma of that over ``SIGMAS``.
    """

    def __init__(
        self, places: Any, speeds: Any = 20.0, level_m: float = 0.5, tall: Any = (), seed: int = 0, **config: Any
    ):
        places = np.asarray(places, dtype=np.float64)
        n, c = places.shape[:2]
        loaded = PerceptionConfig.load(deep_merge({"source": "cooperative"}, config))
        self.batch, self.rows, self.time_s = PerceptionBatch(loaded, n, c, c + 1, DT), np.arange(n), 0.0
        self.cars, self.egos, self.fixes = np.zeros((n, c + 1), CAR), np.zeros(n, EGO), np.zeros(n * (c + 1), FIX)
        self.cars["x"][:, 1:], self.cars["y"][:, 1:] = places[..., 0], places[..., 1]
        self.cars["speed"], self.cars["length"], self.cars["width"] = speeds, 5.0, 2.0
        self.cars["slot"] = np.arange(-1, c)
        self.egos["vehicles"] = c + 1
        self.level_m = level_m
        self.error = np.random.default_rng(seed + 77).normal(0.0, level_m / SIGMAS, (n, c + 1, 2))
        self.batch.begin(self.rows, range(seed, seed + n), np.ones((n, c), dtype=np.bool_), self.cars)
        self.batch.pictures.ranging.modules["height_m"] = 1.5
        for slot in tall:
            self.batch.pictures.ranging.modules["height_m"][:, slot] = 2.6

    def step(self, lies: Any = None) -> None:
        """One epoch; lies (N, C, 2): displacements of what is broadcast."""
        cars, n, v = self.cars, *self.cars.shape
        self.time_s += DT
        cars["x"] += cars["speed"] * DT
        x, y = cars["x"] + self.error[..., 0], cars["y"] + self.error[..., 1]
        belief, fixes = self.egos["belief"], self.fixes.reshape(n, v)
        belief["x_m"], belief["y_m"], belief["speed_mps"] = x[:, 0], y[:, 0], cars["speed"][:, 0]
        belief["fix_x_m"], belief["fix_y_m"] = x[:, 0], y[:, 0]
        belief["pl_at_m"] = belief["pl_ct_m"] = self.level_m
        fixes["position_en_m"] = np.stack([x, -y], axis=-1)
        fixes["velocity_en_mps"][..., 0], fixes["speed_mps"], fixes["mode"] = cars["speed"], cars["speed"], 1
        fixes["heading_rad"] = 0.5 * math.pi
        fixes["pl_at_m"] = fixes["pl_ct_m"] = self.level_m
        told = None
        if lies is not None:
            told = np.zeros((n, v - 1, 4))
            told[..., 0], told[..., 1], told[..., 3] = lies[..., 0], -lies[..., 1], 1.0
        self.batch.perceive(
            self.rows, self.rows * v, np.full(n, self.time_s), self.fixes, cars, self.egos, told
        )  # fmt: skip

    @property
    def relations(self) -> Any:
        """(N, C) RELATION."""
        return self.batch.pictures.ranging.relations

    def over(self) -> tuple[np.ndarray, np.ndarray]:
        """Errors relative to the ego over their levels, along and across (N, C); NaN where none is perceived."""
        tracks, cars, belief = self.batch.pictures.tracks[:, :-1], self.cars, self.egos["belief"]
        here = tracks["time_s"] == 0.0
        found = []
        for held, true, own, level in (("x_m", "x", "x_m", "pl_at_m"), ("y_m", "y", "y_m", "pl_ct_m")):
            error = tracks[held] - belief[own][:, None] - (cars[true][:, 1:] - cars[true][:, :1])
            found.append(np.where(here, np.abs(error) / tracks[level], np.nan))
        return found[0], found[1]


def leaders(n: int, seed: int = 1) -> np.ndarray:
    """Places of one other car each, ahead or behind, in lanes around (N, 1, 2)."""
    rng = np.random.default_rng(seed)
    ahead = rng.uniform(7.0, 45.0, n) * rng.choice([-1.0, 1.0], n)
    return np.stack([ahead, rng.uniform(-4.0, 4.0, n)], axis=-1)[:, None]


def speeds(n: int) -> np.ndarray:
    """Speeds of an ego at 20 m/s and of the other, up to 3 m/s off, none of which reach each other (N, 2)."""
    relative, x = np.random.default_rng(5).uniform(-3.0, 3.0, n), leaders(n)[:, 0, 0]
    closing = np.abs(relative) > (np.abs(x) - 6.0) / 6.0
    return np.stack([np.full(n, 20.0), 20.0 + np.where(closing, np.abs(relative) * np.sign(x), relative)], axis=-1)


@pytest.mark.parametrize("level_m", [0.5, 6.0])
@pytest.mark.parametrize(
    "ranging",
    [{}, {"lever_arms_m": [[0.0, 0.0]]}, {"kind": "toa"}, {"kind": "rssi"}],
    ids=["two", "one", "toa", "rssi"],
)
def test_levels_hold_and_honest_senders_are_kept(ranging: dict[str, Any], level_m: float) -> None:
    n, risk = 1500, 1e-3
    config = {"cooperation": {"ranging": ranging, "integrity_risk": risk}}
    fleets = Fleets(leaders(n), speeds(n), level_m, **config)
    for _ in range(30):
        fleets.step()
    along, across = fleets.over()
    assert np.isfinite(along).mean() > 0.95
    for over in (along, across):  # each at half of the risk
        assert (over > 1.0).sum() <= binom.isf(TAIL, n, 0.5 * risk)
    # Three windows at 1e-6 for each: one alarm in 4500 windows has the probability of 5e-3, three 2e-8.
    assert (fleets.relations["reason"] != 0).sum() <= 2


def test_ranges_make_levels_smaller_than_broadcasts_do() -> None:
    fleets = Fleets(leaders(200), speeds(200), level_m=6.0)
    for _ in range(20):
        fleets.step()
    tracks = fleets.batch.pictures.tracks[:, 0]
    assert np.median(tracks["pl_at_m"]) < 1.0  # 8.5 m by broadcasts
    assert np.median(tracks["pl_ct_m"]) < 5.0


@pytest.mark.parametrize("size_m", [2.0, 10.0])
def test_liars_along_the_line_of_sight_are_found_and_their_places_known(size_m: float) -> None:
    n = 400
    fleets = Fleets(leaders(n), speeds(n))
    angle = np.where(np.arange(n) % 2, 0.0, math.pi)
    lies = size_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None]
    for epoch in range(60):
        fleets.step(lies)
        along, across = fleets.over()
        if epoch > 2:  # at all times, before they are found as after
            assert np.nanmax(along) <= 1.0
            assert np.nanmax(across) <= 1.0
    reason = fleets.relations["reason"][:, 0]
    assert (reason != 0).mean() > 0.95
    farther = lies[:, 0, 0] * fleets.cars["x"][:, 1] - lies[:, 0, 0] * fleets.cars["x"][:, 0] > 0.0
    plain = (reason == ck.SHORT) | (reason == ck.LONG)
    np.testing.assert_array_equal(reason[plain & (np.abs(leaders(n)[:, 0, 1]) < 1.0)] == ck.SHORT,
                                  farther[plain & (np.abs(leaders(n)[:, 0, 1]) < 1.0)])  # fmt: skip
    assert np.isinf(fleets.batch.pictures.radio.held["pl_at_m"][reason != 0]).all()  # their messages are no longer used


def test_an_excluded_sender_stays_so_until_its_slot_is_anothers() -> None:
    fleets = Fleets([[[20.0, 0.0]]])
    lies = np.array([[[5.0, 0.0]]])
    for _ in range(20):
        fleets.step(lies)
    assert fleets.relations["reason"][0, 0] == ck.SHORT
    assert fleets.batch.pictures.picture["excluded"][0] == 1
    for _ in range(20):
        fleets.step()
    assert fleets.relations["reason"][0, 0] == ck.SHORT
    fleets.batch.enter(0, 0, 7, 5.0, 2.0)
    fleets.step()
    assert fleets.relations["reason"][0, 0] == 0
    assert fleets.batch.pictures.picture["excluded"][0] == 0


def test_a_van_between_delays_ranges_and_nobody_is_excluded_for_it() -> None:
    """At close range the link budget lets diffracted signals through: the levels cover what they are late by."""
    n = 300
    places = np.tile([[14.0, 0.0], [7.0, 0.0]], (n, 1, 1))
    ranging = {"range_m": 250.0, "lever_arms_m": [[0.0, -0.2], [0.0, 0.2]]}
    fleets = Fleets(places, 20.0, tall=(1,), cooperation={"ranging": ranging})
    late = []
    for epoch in range(30):
        fleets.step()
        ranges = fleets.batch.pictures.ranging.ranges[:, 0, 0]
        late.append(np.median(ranges[ranges >= 0.0]) - 14.0)
        along, across = fleets.over()
        if epoch > 2:
            assert np.nanmax(along[:, 0]) <= 1.0
            assert np.nanmax(across[:, 0]) <= 1.0
    assert np.median(late) == pytest.approx(2.0 * (math.hypot(4.5, 0.8) - 4.5), abs=0.02)
    assert not fleets.relations["reason"].any()


def test_where_most_disagree_the_egos_own_position_is_wrong() -> None:
    fleets = Fleets(np.tile([[20.0, 0.0], [-20.0, 0.0], [30.0, 4.0], [-30.0, 4.0]], (20, 1, 1)))
    fleets.error[:, 0, 0] += 5.0
    for _ in range(60):
        fleets.step()
    assert not fleets.relations["reason"].any()


def test_positions_do_not_jump_with_the_egos_solution() -> None:
    fleets = Fleets(leaders(50))
    for _ in range(20):
        fleets.step()
    before = fleets.relations["x_m"].copy()
    fleets.error[:, 0] += 0.3
    fleets.step()
    assert np.nanmax(np.abs(fleets.relations["x_m"] - before)) < 0.5


def sent_in(speed: Any, seconds: float = 10.0, **turn: Any) -> np.ndarray:
    """Times at which a car has sent CAM."""
    v2v = {**CLEAR, "messages": "cam"}
    fleets = Fleets([[[30.0, 0.0]]], speed, level_m=1.0, v2v=v2v, drop_after_s=1.5)
    times, last = [], -1
    for k in range(round(seconds / DT)):
        if turn and k == turn["at"]:
            fleets.cars["speed"] += turn["by"]
        fleets.step()
        origin = int(fleets.batch.pictures.radio.origin[0, 0])
        if origin != last:
            times.append(fleets.time_s)
            last = origin
    return np.array(times)


def test_cam_are_sent_after_4_m_and_after_1_s_at_the_latest() -> None:
    np.testing.assert_allclose(np.diff(sent_in(0.0)), 1.0)
    np.testing.assert_allclose(np.diff(sent_in(9.0)), 0.5)  # 4.5 m
    np.testing.assert_allclose(np.diff(sent_in(45.0)), 0.1)


def test_a_cam_follows_a_change_of_speed_and_three_more_at_its_pace() -> None:
    """ETSI EN 302 637-2, 6.1.3: a message by a change sets the time to the next ones, N_GenCam of them."""
    times = sent_in(0.0, at=23, by=0.6)
    gaps = np.round(np.diff(times), 6)
    at = int(np.flatnonzero(gaps < 0.99)[0])
    np.testing.assert_allclose(gaps[:at], 1.0)
    np.testing.assert_allclose(gaps[at : at + 4], [0.3, 0.3, 0.3, 0.3])
    np.testing.assert_allclose(gaps[at + 4 :], 1.0)


def test_cam_fields_are_rounded_and_levels_pass_as_ellipses() -> None:
    fleets = Fleets([[[30.0, 0.0]]], 20.0, level_m=1.0, v2v={**CLEAR, "messages": "cam"}, drop_after_s=1.5)
    for k in range(10):
        fleets.cars["speed"] += 0.2 if k > 4 else 0.0
        fleets.step()
    held = fleets.batch.pictures.radio.held[0, 0]
    assert held["acceleration_mps2"] == pytest.approx(2.0)
    assert 1.0 <= held["pl_at_m"] <= 1.0 + 0.01 * SIGMAS / 2.447
    assert held["x_m"] / 0.0111 == pytest.approx(round(held["x_m"] / 0.0111))
    fleets.level_m = 40.94 * SIGMAS / 2.4477
    for _ in range(12):
        fleets.step()
    assert np.isinf(fleets.batch.pictures.radio.held[0, 0]["pl_at_m"])


def test_messages_may_not_be_dropped_before_the_next_cam() -> None:
    with pytest.raises(ConfigError, match=r"drop_after_s must be at least 1\.05"):
        PerceptionConfig.load({"v2v": {"messages": "cam"}})
