"""The programme along the track: its last state can stop, and has a successor while the leader keeps its speed."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.agents.drivers.mpc import CUT_MPS, Along, FreeRoad, MpcConfig
from lanebound.agents.drivers.plans import FREE_M

C = MpcConfig()
DT_S = 0.2
B, LEAD_B = C.barrier.brake_mps2, C.barrier.lead_brake_mps2
ALONG = Along(C, DT_S)
WANTED = np.full(C.steps, 14.0)


def behind(gap_m: float, lead_mps: float) -> FreeRoad:
    """Free road behind a leader of constant speed that brakes after the horizon."""
    free = gap_m + lead_mps * ALONG.time_s
    return FreeRoad(free, float(free[-1]) + 0.5 * lead_mps**2 / LEAD_B)


@pytest.mark.parametrize(("lead_mps", "gap_m"), [(0.0, 60.0), (5.0, 60.0), (10.0, 40.0), (14.0, 30.0)])
def test_a_plan_has_a_successor_until_the_ego_stands_or_follows(lead_mps, gap_m):
    """The leader keeps its speed, levels stay: no decision is without a plan, and stopping is always possible."""
    v, before = 14.0, 0.0
    for _ in range(100):
        a = ALONG.plan(v, before, WANTED, behind(gap_m, lead_mps), np.inf)
        assert a is not None
        after = max(v + a * DT_S, 0.0)
        gap_m, v, before = gap_m + (lead_mps - 0.5 * (v + after)) * DT_S, after, a
        assert gap_m + 0.5 * lead_mps**2 / LEAD_B - 0.5 * v**2 / B > -1e-6
    assert v == pytest.approx(lead_mps, abs=0.5)
    assert gap_m > C.standstill_m - 1e-6


def test_a_plan_that_could_not_stop_at_its_end_is_none():
    """A leader of 1 m/s, the road free to its end for a car that brakes late: only the stop beyond it is missing."""
    free = np.full(C.steps, FREE_M)
    reach = 14.0 * 4.0 - 0.5 * B * 4.0**2 + 1.0  # braking fully, in 4 s, and a metre; it stands after 2.8 s
    assert reach > 0.5 * 14.0**2 / B - 4.0
    stands = 0.5 * 14.0**2 / B + 0.5 * B * DT_S * DT_S + C.barrier.standstill_m + (0.5 * CUT_MPS) ** 2 / (2.0 * B)
    assert ALONG.plan(14.0, 0.0, WANTED, FreeRoad(free, stands + 0.5), np.inf) is not None
    assert ALONG.plan(14.0, 0.0, WANTED, FreeRoad(free, stands - 0.5), np.inf) is None
    assert ALONG.plan(14.0, 0.0, WANTED, FreeRoad(free, FREE_M), np.inf) > 0.0 - 1e-9


def test_the_tangents_hold_for_every_speed():
    """The state that the rows let through can stop within what they let through, by the exact square."""
    spare = (0.5 * CUT_MPS) ** 2 / (2.0 * B)
    speeds = np.linspace(0.0, 40.0, 401)
    at = np.arange(0.0, 40.0 + CUT_MPS, CUT_MPS)
    cut = (np.outer(speeds, at / B) - 0.5 * at**2 / B).max(axis=1)
    assert np.all(cut + spare >= 0.5 * speeds**2 / B - 1e-9)
    assert np.all(cut <= 0.5 * speeds**2 / B + 1e-9)
    rows = ALONG.A[-at.size :, :-1]
    a = np.random.default_rng(0).uniform(-2.0, 1.0, C.steps)
    v, p = 14.0, 0.0
    for one in a:
        p, v = p + (v + 0.5 * one * DT_S) * DT_S, v + one * DT_S
    found = rows @ a + 14.0 * ALONG.time_s[-1] + (C.barrier.response_s + at / B) * 14.0 - 0.5 * at**2 / B
    exact = p + C.barrier.response_s * v + 0.5 * v * v / B
    assert exact - spare <= found.max() <= exact + 1e-9


def test_a_bound_that_asks_for_more_than_standing_asks_for_that():
    assert ALONG.plan(0.0, 0.0, WANTED, FreeRoad(np.full(C.steps, FREE_M), FREE_M), -1.25) == pytest.approx(
        0.0, abs=1e-9
    )
    a = ALONG.plan(0.1, 0.0, WANTED, FreeRoad(np.full(C.steps, FREE_M), FREE_M), -1.25)
    assert a == pytest.approx(-0.1 / DT_S, abs=1e-9)
