"""The barrier filter: silent when all is well, never too fast, never out of the lane, honest in counting."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.barrier import BarrierConfig, BarrierFilter
from lanebound.agents.drivers.base import Reader
from lanebound.agents.episodes import EpisodeLog, drive, open_env, summarise
from lanebound.integrity.errors import InputError

GIVEN: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}
C = BarrierConfig()
LIMIT_MPS = 50.0 / 3.6


class Constant:
    """Commands the same share of acceleration and steering at all times."""

    def __init__(self, acceleration: float, steering: float = 0.0) -> None:
        self.action = np.array([acceleration, steering], dtype=np.float32)

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
    lost = barrier.predict(seen(barrier.reader, None, v=13.0, integrity__pl_ct=2.0))[0]
    assert lost[0] == pytest.approx(2.0 * (-C.slow_mps2 - low) / (high - low) - 1.0, abs=1e-6)
    assert lost[1] == pytest.approx(0.1)
    assert barrier.counts["lane infeasible"] == 1


def test_what_it_cannot_filter_is_refused():
    with pytest.raises(InputError, match="action must be continuous"):
        make_agent("cbf", open_env("UrbanCanyon", GIVEN))
    with pytest.raises(InputError, match=r"must show 'integrity\.pl_ct'"):
        make_agent("cbf", open_env("LaneKeeping", GIVEN | {"observation": {"integrity": "blind"}}))


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
        ends.append((summarise(log.episode(0)).total_return, dict(barrier.counts)))
        assert not log.episode(0)[-1]["crashed"]
        assert barrier.counts["following changed"] > 20
    assert ends[0] == ends[1]
