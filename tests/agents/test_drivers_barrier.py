"""The barrier filter: silent when all is well, never too fast, never out of the lane, honest in counting."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.agents.benchmark.scoring import outcome_of
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.barrier import BarrierConfig, BarrierFilter
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.shares import value_of
from lanebound.agents.episodes import EpisodeLog, drive, open_env
from lanebound.integrity.core.errors import InputError

GIVEN: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}
C = BarrierConfig()
LIMIT_MPS = 50.0 / 3.6


class Constant:
    """Commands the same share of acceleration and steering at all times."""

    def __init__(self, acceleration: Any, steering: Any = 0.0) -> None:
        self.action = np.stack([acceleration, steering], axis=-1).astype(np.float32)

    def predict(self, observation: Any, state: Any = None, *_: Any) -> tuple[np.ndarray, Any]:
        return self.action, state


@pytest.fixture(scope="module")
def env() -> Any:
    return open_env("CarFollowing", GIVEN | {"observation": {"form": "flat"}})


def seen(reader: Reader, gap_m: float | None, lead_mps: float = 10.0, v: float = 10.0, **values: float) -> np.ndarray:
    """A moment on a straight road of 3.25 m, perhaps with a car ahead; dots are written as ``__``."""
    shown = {"ego__speed": v, "road__speed_limit": LIMIT_MPS, "ego__lane_width": 3.25, "ego__heading_cos": 1.0}
    if gap_m is not None:
        row = {"present": 1.0, "own_lane": 1.0, "lane_gap": gap_m + 5.0, "length": 5.0, "velocity_ahead": lead_mps - v}
        shown |= {f"traffic__v0_{name}": value for name, value in row.items()}
    out = np.zeros(len(reader.columns), dtype=np.float32)
    for name, value in (shown | values).items():
        column = name.replace("__", ".")
        out[reader.columns.index(column)] = value / reader.scale(column)
    return out


def test_a_leader_of_the_last_decision_that_is_believed_level_is_braked_for(env):
    """Levels of 15 m together: half a metre of belief must not set the car free."""
    barrier, (low, high) = BarrierFilter(env, Constant(1.0)), env.world.action_type.acceleration_range
    near, hidden = (seen(barrier.reader, s, 5.0, 5.0, traffic__v0_pl_at=15.0) for s in (-4.5, -5.5))
    free = barrier.predict(hidden)[0]
    assert free[0] == 1.0  # nobody was ahead: the assumption that is counted
    assert not barrier.followed
    barrier.predict(near)
    held = barrier.predict(hidden)[0]
    assert held[0] == pytest.approx(2.0 * (-C.brake_mps2 - low) / (high - low) - 1.0, abs=1e-6)
    assert barrier.followed
    anew = barrier.predict(hidden, None, np.ones(1, dtype=np.bool_))[0]
    assert anew[0] == 1.0


def test_a_decision_counts_once_however_much_of_it_fails(env):
    barrier = BarrierFilter(env, Constant(0.0, 0.0))
    shown = seen(barrier.reader, 3.0, 0.0, 13.0, integrity__pl_ct=2.0, ego__lateral_offset=1.5, ego__steering=0.3)
    barrier.predict(shown)
    assert barrier.counts["following infeasible"] == barrier.counts["lane infeasible"] == 1
    assert barrier.counts["infeasible"] == barrier.counts["relaxed"] == barrier.counts["lane slack"] == 1


def test_it_filters_whom_its_figures_name(env):
    over = make_agent("cbf", env, {"over": "integrity_aware", "gamma": 0.5})
    assert isinstance(over, BarrierFilter)
    assert type(over.driver.plan).__name__ == "IntegrityAware"
    assert over.config.gamma == 0.5
    assert type(make_agent("cbf", env).driver.plan).__name__ == "Nominal"
    drawn = make_agent("cbf", env, {"over": "random"})
    shown = seen(drawn.reader, None, integrity__pl_ct=0.2)
    found = []
    for seed in (1, 2, 1):
        drawn.reseed(seed)
        found.append(drawn.driver.predict(shown)[0].tolist())
    assert found[0] == found[2] != found[1]
    with pytest.raises(InputError, match="over must be another agent than cbf"):
        make_agent("cbf", env, {"over": "cbf"})
    with pytest.raises(InputError, match="agent 'nominl' is unknown"):
        make_agent("cbf", env, {"over": "nominl"})


def test_with_nobody_ahead_and_small_levels_it_is_silent(env):
    barrier = BarrierFilter(env, Constant(0.3, 0.0))
    shown = seen(barrier.reader, None, integrity__pl_ct=0.2)
    assert np.allclose(barrier.predict(shown)[0], [0.3, 0.0], atol=1e-6)
    assert barrier.counts["decisions"] == 1
    assert sum(barrier.counts.values()) == 1


def test_the_bound_falls_as_the_gap_closes_and_with_the_levels(env):
    barrier = BarrierFilter(env, Constant(1.0))
    by_gap = [float(barrier.acceleration_bound(seen(barrier.reader, s))[0]) for s in (80.0, 40.0, 20.0, 12.0, 8.0)]
    levels = (0.0, 1.0, 3.0, 8.0)
    by_pl = [float(barrier.acceleration_bound(seen(barrier.reader, 20.0, traffic__v0_pl_at=p))[0]) for p in levels]
    assert by_gap == sorted(by_gap, reverse=True)
    assert by_pl == sorted(by_pl, reverse=True)
    assert by_pl[0] > by_pl[-1] + 1.0


def test_a_leader_that_may_be_in_the_lane_counts(env):
    barrier = BarrierFilter(env, Constant(1.0))
    aside = {"traffic__v0_own_lane": 0.0, "traffic__v0_lane_offset": -2.0}
    free, _ = barrier.acceleration_bound(seen(barrier.reader, 10.0, 0.0, **aside))
    bound, _ = barrier.acceleration_bound(seen(barrier.reader, 10.0, 0.0, traffic__v0_pl_ct=0.6, **aside))
    assert free == np.inf
    assert bound == -C.brake_mps2


@pytest.mark.parametrize("v", [4.0, 9.0, 14.0])
@pytest.mark.parametrize("lead_mps", [3.0, 10.0, 14.0])
@pytest.mark.parametrize("error", [-1.0, 0.0, 1.0])
def test_against_the_hardest_braking_the_barrier_never_goes_negative(env, v, lead_mps, error):
    """Ego at full throttle but for the filter, error within its level, a leader that brakes after 4 s."""
    barrier, pl, dt = BarrierFilter(env, Constant(1.0)), 1.0, env.dt_s
    gap = 1.0 + C.standstill_m + pl + v * C.response_s + 0.5 * v * v / C.brake_mps2
    gap += pl - min(0.5 * (lead_mps - C.speed_error_mps) ** 2 / C.lead_brake_mps2, 0.5 * v * v / C.brake_mps2)
    lead = lead_mps
    for step in range(120):
        bound, _ = barrier.acceleration_bound(seen(barrier.reader, gap + error, lead, v, traffic__v0_pl_at=pl))
        a = max(min(1.5, float(bound)), -C.brake_mps2)
        after = max(v + a * dt, 0.0)
        slower = max(lead - (C.lead_brake_mps2 if step > 20 else 0.0) * dt, 0.0)
        gap += 0.5 * (lead + slower) * dt - 0.5 * (v + after) * dt
        v, lead = after, slower
        h = gap + 0.5 * lead**2 / C.lead_brake_mps2 - C.standstill_m - v * C.response_s - 0.5 * v * v / C.brake_mps2
        assert h > -0.02  # float32 of what is observed
        assert gap > 0.0
    assert v == pytest.approx(0.0, abs=1e-3)


def test_steering_out_of_the_lane_is_cut_and_back_into_it_is_not(env):
    barrier = BarrierFilter(env, Constant(0.0, 0.5))
    shown = seen(barrier.reader, None, integrity__pl_ct=0.2, ego__lateral_offset=0.5)
    low, high, none = barrier.angle_bounds(shown)
    assert not none
    assert low < high < 0.0
    assert barrier.predict(shown)[0][1] == pytest.approx(
        float(high) / env.world.action_type.steering_range[1], abs=1e-6
    )
    assert barrier.counts["lane changed"] == 1
    barrier.driver = Constant(0.0, -0.2)
    back = seen(barrier.reader, None, v=4.0, integrity__pl_ct=0.2, ego__lateral_offset=0.1)
    assert barrier.predict(back)[0][1] == pytest.approx(-0.2, abs=0.15)
    mirrored = seen(barrier.reader, None, integrity__pl_ct=0.2, ego__lateral_offset=-0.5)
    assert [float(x) for x in barrier.angle_bounds(mirrored)[:2]] == pytest.approx(
        [-float(high), -float(low)], abs=1e-6
    )


def test_a_held_wheel_never_takes_the_car_out(env):
    """Small angles: offset and heading as the filter predicts them, the driver steering right as hard as it may."""
    barrier, dt, v, e, psi = BarrierFilter(env, Constant(0.0, 1.0)), env.dt_s, 10.0, 0.0, 0.0
    for _ in range(50):
        values = {"ego__lateral_offset": e, "ego__heading_sin": np.sin(psi), "ego__heading_cos": np.cos(psi)}
        d = barrier.reader.previews_m[0]
        values |= {f"road__preview_{d:g}m_heading": -psi, "integrity__pl_ct": 0.2}
        share = float(barrier.predict(seen(barrier.reader, None, v=v, **values))[0][1])
        beta = np.arctan(0.5 * np.tan(share * env.world.action_type.steering_range[1]))
        e, psi = e + v * dt * (psi + beta) + (v * dt) ** 2 * beta / 5.0, psi + 2.0 * v * dt * beta / 5.0
        assert e < 0.625 - 0.2 + 1e-3
    assert e > 0.3


def test_no_safe_command_means_the_stated_manoeuvre_and_is_counted(env):
    barrier = BarrierFilter(env, Constant(0.5, 0.1))
    low, high = env.world.action_type.acceleration_range
    near = barrier.predict(seen(barrier.reader, 3.0, 0.0, integrity__pl_ct=0.2))[0]
    assert near[0] == pytest.approx(2.0 * (-C.brake_mps2 - low) / (high - low) - 1.0, abs=1e-6)
    assert barrier.counts["following infeasible"] == 1
    assert barrier.counts["lane slack"] == 0


def test_levels_beyond_the_lane_leave_slack_which_keeps_to_its_middle_and_slows(env):
    barrier = BarrierFilter(env, Constant(0.5, 0.1))
    (low, high), steering = env.world.action_type.acceleration_range, env.world.action_type.steering_range
    lost = barrier.predict(seen(barrier.reader, None, v=13.0, integrity__pl_ct=2.0))[0]
    assert lost[0] == pytest.approx(2.0 * (-C.slow_mps2 - low) / (high - low) - 1.0, abs=1e-6)
    _, most, slack = barrier.angle_bounds(seen(barrier.reader, None, v=13.0, integrity__pl_ct=2.0))
    assert slack
    assert lost[1] == pytest.approx(float(most) / steering[1], abs=1e-6)
    assert barrier.counts["lane slack"] == 1
    assert barrier.counts["lane infeasible"] == 0


def test_a_wheel_that_cannot_turn_fast_enough_is_counted(env):
    barrier = BarrierFilter(env, Constant(0.0, 0.0))
    shown = seen(barrier.reader, None, v=13.0, integrity__pl_ct=0.2, ego__lateral_offset=1.5, ego__steering=0.3)
    barrier.predict(shown)
    assert barrier.counts["lane infeasible"] == 1


def test_old_news_of_a_leader_and_the_acceleration_since_count(env):
    barrier = BarrierFilter(env, Constant(1.0))
    by_age = [
        float(barrier.acceleration_bound(seen(barrier.reader, 25.0, traffic__v0_age=a))[0]) for a in (0, 0.1, 0.3, 1)
    ]
    assert by_age == sorted(by_age, reverse=True)
    assert by_age[0] > by_age[-1] + 1.0
    before = float(barrier.acceleration_bound(seen(barrier.reader, 25.0))[0])
    barrier.commanded_mps2 = 5.0
    assert float(barrier.acceleration_bound(seen(barrier.reader, 25.0))[0]) < before


def test_no_error_within_the_bounds_makes_the_barrier_negative(env):
    """400 cars at once, each with errors drawn anew or at the ends of their bounds, dynamics as highway-env's."""
    n, steps, ticks = 400, 150, 4
    rng, barrier, dt = np.random.default_rng(0), BarrierFilter(env, Constant(1.0)), env.dt_s
    c, tick = barrier.config, dt / ticks
    v = rng.uniform(0.0, 14.0, n)
    lead, pl = v.copy(), rng.uniform(0.1, 3.0, n)
    gap = c.standstill_m + c.response_s * v + 0.5 * v**2 / c.brake_mps2 - 0.5 * lead**2 / c.lead_brake_mps2 + 0.01
    extreme, sign = rng.random(n) < 0.5, rng.choice([-1.0, 1.0], n)
    least, age, commanded, brake = np.inf, 0.1, np.zeros(n), np.zeros(n)
    barrier.driver = Constant(np.ones(n), np.zeros(n))
    told, moved = lead.copy(), lead * age  # what was true ``age`` ago, and the way made since
    for step in range(steps):
        part = np.where(extreme, sign, rng.uniform(-1.0, 1.0, n))
        shown = seen(barrier.reader, 50.0)[None].repeat(n, 0)
        speed = (v - part * c.speed_error_mps) / (1.0 + part * barrier.speed_share) - c.lag_s * np.maximum(
            commanded, 0.0
        )
        speed = np.where(np.abs(v) < c.creep_mps, 0.0, speed)
        place = gap - moved + told * age  # brought forward at the speed told of
        values = {
            "ego.speed": speed,
            "traffic.v0_lane_gap": place + part * pl + 5.0,
            "traffic.v0_velocity_ahead": told + part * (c.speed_error_mps + barrier.speed_share * told) - speed,
            "traffic.v0_pl_at": pl + 0.5 * 8.0 * age**2,
            "traffic.v0_age": np.full(n, age),
        }
        for name, value in values.items():
            shown[:, barrier.reader.columns.index(name)] = value / barrier.reader.scale(name)
        low, high = env.world.action_type.acceleration_range
        commanded = low + 0.5 * (barrier.predict(shown)[0][:, 0].astype(float) + 1.0) * (high - low)
        if step % 5 == 0:
            brake = np.where(rng.random(n) < 0.3, -c.lead_brake_mps2, rng.uniform(-3.0, 2.0, n))
        for k in range(ticks):
            if k == ticks - round(age / tick):
                told, moved = lead.copy(), np.zeros(n)
            gap += (lead - v) * tick
            moved += lead * tick
            v = v + commanded * tick
            lead = np.clip(lead + brake * tick, 0.0, 14.0)
        h = gap + 0.5 * lead**2 / c.lead_brake_mps2 - c.standstill_m
        h -= c.response_s * np.maximum(v, 0.0) + 0.5 * np.maximum(v, 0.0) ** 2 / c.brake_mps2
        least = min(least, float(h.min()))
    assert least > -1e-3
    assert least < 1.0  # the bounds are used
    assert v.min() > -1.0
    assert gap.min() > 0.9 * c.standstill_m


@pytest.mark.parametrize("sky", ["open", "suburban", "urban", "dense"])
def test_speeds_are_bounded_by_the_scale_that_the_sky_declares(sky):
    """4.5 sigma of the odometer that drives there, at least; a share that is configured counts instead."""
    made = open_env("CarFollowing", GIVEN | {"sky": sky})
    bounded, fixed = (BarrierFilter(made, Constant(0.0), c) for c in (None, BarrierConfig(speed_share=0.1)))
    assert bounded.speed_share >= 4.5 * made.config.level.navigator().odometer.scale_sigma - 1e-12
    assert bounded.fastest(10.0, 0.0) == pytest.approx(10.0 * (1.0 + bounded.speed_share) + C.speed_error_mps)
    assert fixed.speed_share == 0.1
    overridden = {"positioning": {"dead_reckoning": {"odometer_scale": 0.05}}}
    own = open_env("CarFollowing", GIVEN | {"sky": sky, "navigator": overridden})
    assert BarrierFilter(own, Constant(0.0)).speed_share == 0.05


def test_what_it_cannot_filter_is_refused():
    with pytest.raises(InputError, match="action must be continuous"):
        make_agent("cbf", open_env("UrbanCanyon", GIVEN))
    with pytest.raises(InputError, match=r"must show 'integrity\.pl_at'"):
        make_agent("cbf", open_env("LaneKeeping", GIVEN | {"observation": {"integrity": "blind"}}))


def test_full_throttle_is_brought_round_every_bend(monkeypatch):
    """And is not where the filter knows of no bends."""
    env = open_env("LaneKeeping", GIVEN)
    off = []
    for knows in (True, False):
        if not knows:
            monkeypatch.setattr(BarrierFilter, "bend_bound", lambda *_: np.asarray(np.inf))
        log, barrier = EpisodeLog(), BarrierFilter(env, Constant(1.0))
        drive(env, barrier, [3, 4, 5], [log])
        off.append([log.episode(seed)[-1]["off_road"] for seed in (0, 1, 2)])
        assert barrier.counts["bend changed"] > 20 or not knows
    assert not any(off[0])
    assert any(off[1])


def test_a_bend_is_met_later_than_believed():
    env = open_env("LaneKeeping", GIVEN | {"observation": {"form": "flat"}})
    barrier = BarrierFilter(env, Constant(0.0))
    bend = {"road__preview_40m_curvature": 0.02, "road__preview_40m_exists": 1.0}

    def bound(v: float, pl_at_m: float) -> float:
        observation = seen(barrier.reader, None, v=v, integrity__pl_at=pl_at_m, **bend)
        return float(barrier.bend_bound(observation, barrier.bends(observation)))

    fast = np.sqrt(C.bend_share * 4.0 / 0.02 + 2.0 * C.bend_brake_mps2 * 40.0)
    assert bound(fast - 2.0, 0.0) > 0.0 > bound(fast, 0.0)
    assert bound(fast - 1.0, 5.0) < bound(fast - 1.0, 0.0)
    assert bound(40.0, 0.0) == -C.brake_mps2


def test_a_bend_between_two_previews_is_met():
    env = open_env("LaneKeeping", GIVEN | {"observation": {"form": "flat"}})
    barrier = BarrierFilter(env, Constant(0.0))
    turned = {f"road__preview_{d}m_heading": 0.6 for d in (40, 80)}  # 0.6 rad between 20 and 40 m: R = 33 m
    late = np.sqrt(C.bend_share * 4.0 / 0.03 + 2.0 * C.bend_brake_mps2 * 20.0)
    there, gone = seen(barrier.reader, None, v=late, **turned), seen(barrier.reader, None, v=late)
    assert float(barrier.bend_bound(there, barrier.bends(there))) < 0.0
    assert float(barrier.bend_bound(gone, barrier.bends(gone))) > 1.0


def test_a_bend_counts_until_the_level_is_behind_it():
    env = open_env("LaneKeeping", GIVEN | {"observation": {"form": "flat"}})
    barrier = BarrierFilter(env, Constant(1.0))
    bounds = barrier._inner.acceleration_range

    def acceleration(turn_rad: float) -> float:
        values = {f"road__preview_{d}m_heading": turn_rad for d in (5, 10, 20, 40, 80)}
        action, _ = barrier.predict(seen(barrier.reader, None, v=9.0, integrity__pl_at=4.0, **values))
        return float(value_of(action[..., 0], bounds))

    assert acceleration(0.25) < 0.0  # R = 20 m here and now
    way = 0.0
    while acceleration(0.0) < 0.0:
        way += 9.0 * env.dt_s
        assert way < 20.0
    assert 3.0 < way < 6.0
    acceleration(0.25)
    barrier.begin(np.ones((), dtype=np.bool_))
    assert acceleration(0.0) == pytest.approx(bounds[1])


def test_over_full_throttle_nothing_is_hit():
    env = open_env("CarFollowing", GIVEN | {"world": {"duration": 40.0}})
    lane = make_agent("nominal", env)

    class Reckless:
        def predict(self, observation: Any, *rest: Any) -> tuple[np.ndarray, Any]:
            action, state = lane.predict(observation)
            return np.array([1.0, action[1]], dtype=np.float32), state

    ends = []
    for _ in range(2):
        log, barrier = EpisodeLog(), BarrierFilter(env, Reckless())
        drive(env, barrier, [3], [log])
        ends.append((outcome_of(log.episode(0), 0.0).total_return, dict(barrier.counts)))
        assert not log.episode(0)[-1]["crashed"]
        assert barrier.counts["following changed"] > 20
    assert ends[0] == ends[1]
