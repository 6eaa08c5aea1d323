"""The predictive driver: a regulator where nothing binds, tighter as levels grow, and it counts what it cannot do."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.horizon import condense
from lanebound.agents.drivers.mpc import LevelMpc, MpcConfig, make_mpc, solve
from lanebound.agents.episodes import EpisodeLog, drive, open_env
from lanebound.integrity.core.errors import InputError

GIVEN: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}
LIMIT_MPS = 50.0 / 3.6


@pytest.fixture(scope="module")
def env() -> Any:
    return open_env("CarFollowing", GIVEN | {"observation": {"form": "flat"}})


@pytest.fixture
def plan(env) -> LevelMpc:
    found = make_mpc(env).plan
    assert isinstance(found, LevelMpc)
    return found


def seen(reader: Reader, gap_m: float | None = None, lead_mps: float = 10.0, v: float = 10.0, **values: float) -> Any:
    """A moment on a straight road of 3.25 m under an open sky; dots are written as ``__``."""
    shown = {
        "ego__speed": v,
        "road__speed_limit": LIMIT_MPS,
        "ego__lane_width": 3.25,
        "ego__heading_cos": 1.0,
        "integrity__al_at": 1.5,
        "integrity__al_ct": 0.625,
        "integrity__pl_at": 0.2,
        "integrity__pl_ct": 0.2,
    }
    shown |= {f"road__sky_{d:g}m_own": 30.0 for d in reader.config.satellites_m}
    if gap_m is not None:
        row = {"present": 1.0, "own_lane": 1.0, "lane_gap": gap_m + 5.0, "length": 5.0, "velocity_ahead": lead_mps - v}
        shown |= {f"traffic__v0_{name}": value for name, value in row.items()}
    out = np.zeros(len(reader.columns), dtype=np.float32)
    for name, value in (shown | values).items():
        column = name.replace("__", ".")
        out[reader.columns.index(column)] = value / reader.scale(column)
    return out


def test_unconstrained_the_horizon_is_the_regulator_whatever_its_length():
    A, B = np.array([[1.0, 0.4], [0.0, 1.0]]), np.array([[0.1], [0.4]])
    Q, R = np.diag([2.0, 5.0]), 3.0
    P = solve_discrete_are(A, B, Q, np.array([[R]]))
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    x = np.array([0.7, -0.2])
    for steps in (1, 3, 12):
        found = condense(A, B, Q, R, steps)
        wide = np.full(steps, 1e6)
        z = solve(found.H, found.F @ x, np.zeros((0, steps)), wide, -wide)
        assert z is not None
        assert z[0] == pytest.approx(float(-(K @ x)[0]), abs=1e-8)
        assert found.free @ x + found.forced @ z == pytest.approx(_rolled(A, B, x, z), abs=1e-9)


def _rolled(A: Any, B: Any, x: Any, z: Any) -> Any:
    states = []
    for u in z:
        x = A @ x + B[:, 0] * u
        states.append(x)
    return np.concatenate(states)


def test_well_inside_its_lane_it_steers_as_the_regulator(plan):
    for e, psi in ((0.05, 0.0), (-0.03, 0.01)):
        shown = seen(plan.reader, ego__lateral_offset=e, ego__heading_sin=np.sin(psi))
        assert float(plan.steering(shown)) == pytest.approx(float(plan.lqr(shown)), abs=1e-4)


def test_larger_levels_leave_less_of_the_lane(plan):
    """From the same offset, a tighter lane is returned to the harder, up to the floor; slack is counted."""
    angles = []
    for pl in (0.1, 0.4, 0.45, 2.0, 5.0):
        angles.append(float(plan.steering(seen(plan.reader, v=5.0, ego__lateral_offset=0.35, integrity__pl_ct=pl))))
    assert all(b <= a + 1e-6 for a, b in pairwise(angles))
    assert angles[0] - angles[-1] > 0.02
    assert angles[3] == pytest.approx(angles[4], abs=1e-6)
    assert plan.counts["lane slack"] >= 1


def test_larger_levels_leave_less_of_the_gap(plan):
    def commanded(pl: float) -> float:
        values = {"traffic__v0_pl_at": pl, "traffic__v0_pl_ct": 0.3}
        plan.barrier.begin(np.array(True))
        return float(plan.acceleration(seen(plan.reader, 16.0, 10.0, 10.0, **values)))

    found = [commanded(pl) for pl in (0.0, 1.0, 2.0, 4.0)]
    assert found == sorted(found, reverse=True)
    assert found[0] - found[-1] > 0.3


def test_what_cannot_be_kept_is_full_braking_and_counted(plan):
    a = float(plan.acceleration(seen(plan.reader, 3.0, 0.0, 10.0)))
    assert a == -plan.config.barrier.brake_mps2
    assert plan.counts["following infeasible"] == 1
    assert plan.counts["decisions"] == 1
    assert len(plan.solve_s) == 1
    assert plan.solve_s[0] > 0.0


def test_full_braking_that_does_not_keep_the_barrier_is_counted(plan):
    """A gap of 12 m at 12 m/s behind 10 m/s: the programme has a solution, the barrier has none."""
    shown = seen(plan.reader, 12.0, 10.0, 12.0, traffic__v0_pl_at=2.0)
    bound, stuck = plan.barrier.acceleration_bound(shown)
    assert stuck
    assert float(plan.acceleration(shown)) == pytest.approx(float(bound)) == -plan.config.barrier.brake_mps2
    assert plan.counts["following infeasible"] == plan.counts["infeasible"] == 1


@pytest.mark.parametrize("gap_m", [1.0, 3.0, 10.0])
def test_standing_where_levels_fill_the_gap_is_no_failure(plan, gap_m):
    a = float(plan.acceleration(seen(plan.reader, gap_m, 0.0, 0.0, traffic__v0_pl_at=15.0)))
    assert -5.0 * plan.config.barrier.creep_mps - 1e-6 <= a <= 1e-9
    assert plan.counts["decisions"] == 1
    assert plan.counts["infeasible"] == 0


def test_a_decision_counts_once_however_much_of_it_fails(plan):
    shown = seen(plan.reader, 3.0, 0.0, 14.0, ego__steering=0.5, integrity__pl_ct=2.0)
    plan.acceleration(shown)
    plan.steering(shown)
    assert plan.counts["following infeasible"] == plan.counts["lane infeasible"] == 1
    assert plan.counts["infeasible"] == plan.counts["relaxed"] == 1
    plan.steering(seen(plan.reader, v=5.0, integrity__pl_ct=2.0))
    assert plan.counts["relaxed"] == plan.counts["lane slack"] == 2


def test_the_leaders_level_and_speed_error_grow_too(plan):
    """The same sum of levels now; a leader without RTK leaves less room ahead, and the more the further ahead."""
    ahead = np.array([True, *[False] * (plan.reader.config.vehicles - 1)])

    def road(own: float, told: float) -> Any:
        shown = seen(plan.reader, 60.0, integrity__pl_at=own, traffic__v0_pl_at=own + told)
        return plan._road(shown, 10.0, ahead)

    sure, unsure = road(2.0, 0.2), road(0.2, 2.0)
    lost = sure.free_m - unsure.free_m
    assert lost[-1] > 1.0
    assert np.all(np.diff(lost) > 0.0)
    assert unsure.stop_m - unsure.free_m[-1] == pytest.approx(sure.stop_m - sure.free_m[-1])
    slow = np.diff(sure.free_m) / plan.dt_s
    assert np.all(slow < 10.0 - plan.barrier.speed_share * 10.0)


def test_an_episode_begins_without_a_memory(env):
    agent = make_agent("mpc", env)
    reader = agent.plan.reader
    agent.predict(seen(reader, 5.0, 5.0, 5.0, traffic__v0_pl_at=15.0))
    hidden = seen(reader, -5.5, 5.0, 5.0, traffic__v0_pl_at=15.0)
    assert agent.plan.barrier.ahead(hidden).any()
    agent.predict(hidden, episode_start=np.ones(1, dtype=np.bool_))
    assert not agent.plan.barrier.ahead(hidden).any()
    assert agent.counts["decisions"] == 2


def test_a_wheel_that_cannot_turn_back_within_the_grip_is_left_to_the_regulator(plan):
    shown = seen(plan.reader, v=14.0, ego__steering=0.5)
    assert float(plan.steering(shown)) == pytest.approx(float(plan.lqr(shown)))
    assert plan.counts["lane infeasible"] == 1


def test_free_road_is_driven_at_the_limit_and_an_outage_ahead_of_its_limit_is_not(plan):
    fast = float(plan.acceleration(seen(plan.reader, v=8.0)))
    dark = {f"road__sky_{d:g}m_own": 5.0 for d in plan.reader.config.satellites_m}
    slow = float(plan.acceleration(seen(plan.reader, v=8.0, integrity__pl_ct=0.6, integrity__trend_ct=0.3, **dark)))
    assert fast > 0.2
    assert slow < fast - 0.2


def test_a_batch_is_as_one_after_the_other(plan):
    rows = [seen(plan.reader, s, 8.0, 10.0, traffic__v0_pl_at=1.0) for s in (12.0, 20.0, 60.0)]
    together, alone = plan.acceleration(np.stack(rows)), []
    for row in rows:
        plan.barrier.begin(np.array(True))
        alone.append(float(plan.acceleration(row)))
    assert together == pytest.approx(alone)


def test_it_refuses_meta_actions_and_blindness():
    with pytest.raises(InputError, match="action must be continuous"):
        make_agent("mpc", open_env("UrbanCanyon", GIVEN))
    with pytest.raises(InputError, match=r"must show 'integrity\.pl_at'"):
        make_agent("mpc", open_env("LaneKeeping", GIVEN | {"observation": {"integrity": "blind"}}))
    with pytest.raises(InputError):
        MpcConfig(steps=1)


def test_it_brings_a_car_home():
    env = open_env("CarFollowing", GIVEN | {"world": {"duration": 20.0}})
    agent, log = make_agent("mpc", env), EpisodeLog()
    drive(env, agent, [1000], [log])
    rows = log.episode(0)
    assert not rows[-1]["crashed"]
    assert rows[-1]["truncated"]
    assert max(abs(row["est_lateral_m"]) for row in rows) < 0.6
