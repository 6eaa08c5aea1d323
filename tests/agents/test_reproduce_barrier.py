"""The promise of the barrier filter: judged by the truth, resumed, and kept."""

from __future__ import annotations

import json
from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.drivers.barrier import BarrierConfig
from lanebound.agents.studies import barrier_promise
from lanebound.agents.studies.barrier_promise import (
    ASSUMPTIONS,
    BarrierPromiseConfig,
    PromiseWatch,
    barrier_m,
    exceptions_of,
    levels_m,
    one_fault,
    run_promise,
)
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.fault_registry import FAULT_TABLE

C = BarrierConfig()
QUICK = BarrierPromiseConfig(episodes=5, length_s=6.0, batch=3)


def test_the_barrier_is_the_gap_left_when_both_have_stopped():
    v, lead = 10.0, 6.0
    ego_m, lead_m = v * C.response_s + v * v / (2.0 * C.brake_mps2), lead * lead / (2.0 * C.lead_brake_mps2)
    assert barrier_m(20.0, v, lead, C) == pytest.approx(20.0 + lead_m - ego_m - C.standstill_m)
    assert barrier_m(C.standstill_m, -0.2, 0.0, C) == 0.0


def test_five_episodes_keep_the_promise_and_a_broken_run_goes_on(tmp_path, monkeypatch):
    whole = run_promise(QUICK, tmp_path / "whole")
    for group in ("none", "one fault"):
        found = whole[group]
        counts = found["counts"]
        assert found["episodes"] == 5
        assert found["breaches"] == []
        assert counts.get("broken", 0) == 0
        assert counts["kept"] + counts.get("outside", 0) == counts["decisions"]
        assert set(found["exceptions"]) <= set(ASSUMPTIONS)
    assert whole["none"]["counts"]["kept"] > 0.9 * whole["none"]["counts"]["decisions"]
    assert whole["none"]["crashes"] == 0
    by_fault = whole["one fault"]["by_fault"]
    assert sum(of["episodes"] for of in by_fault.values()) == 5
    assert sum(of["crashes"] for of in by_fault.values()) == whole["one fault"]["crashes"]

    drive_part, driven = barrier_promise.drive_part, []

    def stops(config: Any, group: str, seeds: Any, advance: Any) -> Any:
        if len(driven) == 2:
            raise KeyboardInterrupt
        driven.append(group)
        return drive_part(config, group, seeds, advance)

    monkeypatch.setattr(barrier_promise, "drive_part", stops)
    with pytest.raises(KeyboardInterrupt):
        run_promise(QUICK, tmp_path / "broken")
    monkeypatch.setattr(barrier_promise, "drive_part", drive_part)
    assert run_promise(QUICK, tmp_path / "broken") == whole
    assert (tmp_path / "broken" / "promise.json").read_text() == (tmp_path / "whole" / "promise.json").read_text()
    assert run_promise(QUICK.replace(source="sensor"), tmp_path / "sensed")["none"]["breaches"] == []
    with pytest.raises(InputError, match="same barrier promise study"):
        run_promise(BarrierPromiseConfig(episodes=4), tmp_path / "whole")


@pytest.mark.slow
def test_a_hundred_episodes_keep_the_promise(tmp_path):
    result = CliRunner().invoke(
        app, ["reproduce", "barrier-promise", "--episodes", "100", "--jobs", "2", "--json", "--out", str(tmp_path)]
    )
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "promise.json").read_text())
    assert found["none"]["breaches"] == []
    assert found["one fault"]["breaches"] == []
    assert found["none"]["counts"]["exceptional"] < 0.01 * found["none"]["counts"]["decisions"]


def test_every_fault_can_be_drawn_and_none_depends_on_anything_but_the_seed():
    faults = [one_fault(seed, 25.0) for seed in range(200)]
    assert {fault.kind for fault in faults} == {kind.name for kind in FAULT_TABLE}
    assert faults[:5] == [one_fault(seed, 25.0) for seed in range(5)]


def test_exceptions_are_named_and_excuse_one_decision_alone():
    """A stand-in for a world whose leader is nowhere near where it says."""
    lead = SimpleNamespace(position=[20.0, 0.0], heading=0.0, speed=5.0)
    traffic = SimpleNamespace(
        count=1, position_m=_points(26.0), pl_at_m=[1.0], pl_ct_m=[1.0], speed_mps=[9.0], age_s=[0.1], relative=[False],
    )  # fmt: skip
    ego = SimpleNamespace(speed=5.0)
    belief = SimpleNamespace(speed_mps=5.0, position_m=np.zeros(2), heading_rad=0.0)
    loop = SimpleNamespace(ego=ego, traffic=traffic, belief=lambda: belief)
    world = SimpleNamespace(lead=lead, vehicle=ego, gap_m=lambda: 15.0)
    config = SimpleNamespace(observation=SimpleNamespace(pl_max_m=10.0))
    env: Any = SimpleNamespace(belief_loop=loop, world=world, config=config, dt_s=0.2)
    info = {"err_at_m": 0.1, "err_ct_m": 0.1, "pl_at_m": 0.5, "pl_ct_m": 0.5}
    barrier: Any = SimpleNamespace(
        config=C,
        counts=Counter(),
        commanded_mps2=0.0,
        followed=np.array(True),
        fastest=lambda v, a: v + 0.3,
        slowest=lambda v, age: v - 1.0,
        strayed=lambda v, age: 0.1,
    )
    assert exceptions_of(env, barrier, info) == {"leader's level", "leader's speed"}
    assert exceptions_of(env, barrier, info | {"err_ct_m": -0.6}) == {"leader's level", "leader's speed", "own level"}
    assert "no level" in exceptions_of(env, barrier, info | {"pl_at_m": 30.0})
    watch = PromiseWatch(barrier)
    for step, gap in enumerate((15.0, 15.0, -9.0)):
        world.gap_m = lambda gap=gap: gap
        watch.note(SimpleNamespace(env=env, info=info, step=step, seed=0))
        traffic.position_m, traffic.speed_mps = _points(20.5), [5.5]
    assert watch.counts["outside"] == 1
    assert watch.counts["broken"] == 1
    assert watch.breaches[0]["step"] == 2


def test_faster_growth_is_counted_and_excuses_nothing():
    """A stand-in whose leader's level leaps before the third decision, which then finds no safe acceleration."""
    lead = SimpleNamespace(position=[20.0, 0.0], heading=0.0, speed=5.0)
    traffic = SimpleNamespace(
        count=1, position_m=_points(20.0), pl_at_m=[1.0], pl_ct_m=[1.0], speed_mps=[5.0], age_s=[0.1], relative=[False],
    )  # fmt: skip
    ego = SimpleNamespace(speed=5.0)
    belief = SimpleNamespace(speed_mps=5.0, position_m=np.zeros(2), heading_rad=0.0)
    loop = SimpleNamespace(ego=ego, traffic=traffic, belief=lambda: belief)
    world = SimpleNamespace(lead=lead, vehicle=ego, gap_m=lambda: 15.0)
    config = SimpleNamespace(observation=SimpleNamespace(pl_max_m=10.0))
    env: Any = SimpleNamespace(belief_loop=loop, world=world, config=config, dt_s=0.2)
    info = {"err_at_m": 0.0, "err_ct_m": 0.0, "pl_at_m": 0.5, "pl_ct_m": 0.5}
    barrier: Any = SimpleNamespace(
        config=C, counts=Counter(), commanded_mps2=0.0, followed=np.array(True),
        fastest=lambda v, a: v, slowest=lambda v, age: v, strayed=lambda v, age: 0.0,
    )  # fmt: skip
    watch, bound = PromiseWatch(barrier), C.growth_mps * env.dt_s
    levels, stuck = np.cumsum([1.0, 0.9 * bound, 1.1 * bound, 0.0, 0.0]), (0, 0, 0, 1, 1)
    for step, (level, none) in enumerate(zip(levels, stuck, strict=True)):
        traffic.pl_at_m, barrier.counts["following infeasible"] = [level], barrier.counts["following infeasible"] + none
        watch.note(SimpleNamespace(env=env, info=info, step=step, seed=0))
    assert watch.exceptions["levels' growth"] == 1
    assert watch.counts["stuck"] == 2
    assert watch.counts["newly stuck"] == 1
    assert watch.counts["foreseeable"] == 0
    assert watch.counts["kept"] == watch.counts["decisions"] == 4


@pytest.mark.parametrize("followed", [False, True])
def test_a_leader_believed_behind_is_an_assumption_unless_the_filter_brakes_for_it(followed):
    """A leader 2 m ahead that is believed 1 m behind, all errors within their levels."""
    lead, ego = SimpleNamespace(position=[2.0, 0.0], heading=0.0, speed=5.0), SimpleNamespace(speed=5.0)
    traffic = SimpleNamespace(
        count=1, position_m=_points(-1.0), pl_at_m=[8.0], pl_ct_m=[1.0], speed_mps=[5.0], age_s=[0.1], relative=[False],
    )  # fmt: skip
    belief = SimpleNamespace(speed_mps=5.0, position_m=np.zeros(2), heading_rad=0.0)
    loop = SimpleNamespace(ego=ego, traffic=traffic, belief=lambda: belief)
    world = SimpleNamespace(lead=lead, vehicle=ego, gap_m=lambda: 15.0)
    config = SimpleNamespace(observation=SimpleNamespace(pl_max_m=10.0))
    env: Any = SimpleNamespace(belief_loop=loop, world=world, config=config, dt_s=0.2)
    info = {"err_at_m": 0.0, "err_ct_m": 0.0, "pl_at_m": 8.0, "pl_ct_m": 0.5}
    barrier: Any = SimpleNamespace(
        config=C, counts=Counter(), commanded_mps2=0.0, followed=np.array(followed),
        fastest=lambda v, a: v, slowest=lambda v, age: v, strayed=lambda v, age: 0.0,
    )  # fmt: skip
    assert exceptions_of(env, barrier, info) == {"behind"}
    watch = PromiseWatch(barrier)
    for step in range(2):
        watch.note(SimpleNamespace(env=env, info=info, step=step, seed=0))
    assert watch.exceptions["behind"] == (0 if followed else 1)
    assert watch.counts["kept" if followed else "outside"] == 1
    belief.heading_rad = np.pi  # now it is believed ahead
    assert "behind" not in exceptions_of(env, barrier, info)


def test_a_leader_whom_a_sensor_sees_is_judged_as_seen_from_the_ego():
    """The ego believes to be metres off, within its levels; its sensor puts the leader half a metre off from there."""
    gap = np.array([20.0, 1.0])
    lead = SimpleNamespace(position=np.array([120.0, 51.0]), heading=0.0, speed=5.0)
    ego = SimpleNamespace(position=lead.position - gap, heading=0.0, speed=5.0)
    belief = SimpleNamespace(speed_mps=5.0, position_m=ego.position + np.array([4.0, -3.0]), heading_rad=0.0)
    traffic = SimpleNamespace(
        count=1, position_m=(belief.position_m + gap + np.array([0.5, 0.0]))[None], pl_at_m=[1.0], pl_ct_m=[0.4],
        speed_mps=[5.0], age_s=[0.0], relative=[True],
    )  # fmt: skip
    loop = SimpleNamespace(ego=ego, traffic=traffic, belief=lambda: belief)
    config = SimpleNamespace(observation=SimpleNamespace(pl_max_m=10.0))
    env: Any = SimpleNamespace(belief_loop=loop, world=SimpleNamespace(lead=lead), config=config)
    info = {"err_at_m": 4.0, "err_ct_m": -3.0, "pl_at_m": 4.5, "pl_ct_m": 3.5}
    barrier: Any = SimpleNamespace(
        commanded_mps2=0.0, fastest=lambda v, a: v, slowest=lambda v, age: v, strayed=lambda v, age: 0.0
    )
    assert exceptions_of(env, barrier, info) == set()
    assert levels_m(env, info) == 1.0
    assert exceptions_of(env, barrier, info | {"err_ct_m": -3.6}) == {"own level"}
    turned = 0.03  # of the heading, which the sensor's picture turns with: 0.6 m aside at 20 m
    traffic.position_m = (belief.position_m + gap + turned * np.array([-gap[1], gap[0]]))[None]
    assert exceptions_of(env, barrier, info) == {"leader's level"}
    traffic.position_m, traffic.relative = (lead.position + np.array([1.1, 0.0]))[None], [False]
    assert exceptions_of(env, barrier, info) == {"leader's level"}
    assert levels_m(env, info) == 5.5


@pytest.mark.slow
def test_who_also_looks_is_not_led_astray_by_a_leader_that_lies(tmp_path):
    config = BarrierPromiseConfig(episodes=60, source="both")
    found = run_promise(config, tmp_path)["one fault"]
    assert found["by_fault"]["v2v_lie"]["episodes"] >= 3
    assert found["crashes"] == 0
    assert found["breaches"] == []


def _points(x: float) -> Any:
    return np.array([[x, 0.0]])


def test_lying_leaders_alone_are_driven_behind_and_excluded_by_ranges(tmp_path):
    config = QUICK.replace(episodes=30, batch=30, length_s=10.0, kind="v2v_lie", source="cooperative")
    lying = [seed for seed in range(12000, 12030) if config.one_fault(seed).kind == "v2v_lie"]
    result = run_promise(config, tmp_path / "out")
    assert result["one fault"]["episodes"] == len(lying) > 0
    assert [*result["one fault"]["by_fault"]] == ["v2v_lie"]
    liars = result["one fault"]["liars"]
    assert 0 < liars["excluded"] <= liars["lying"] <= len(lying)
    assert result["none"]["excluded_seeds"] == []
