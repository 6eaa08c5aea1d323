"""Navigation in a batch: with the same draws it is the single environment's, and by its own draws it is as good."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.engine import Engine
from lanebound.integrity.errors import ConfigError
from side_by_side import Tally, command, require_equal, same

TRUTH: dict[str, Any] = {"perception": {"source": "truth"}}
FEW: dict[str, Any] = {**TRUTH, "world": {"vehicles_count": 4}, "sky": "urban", "extent_m": 300.0, "layouts": 2}
CASES: list[tuple[str, dict[str, Any], int]] = [
    ("LaneKeeping", {"sky": "dense", "layouts": 2}, 25),
    ("LaneKeeping", {"sky": "open", "action": "meta", "observation": {"history": 2, "satellites_m": []}}, 8),
    ("CarFollowing", {**TRUTH, "sky": "open"}, 15),
    ("Highway", FEW, 10),
    ("Highway", {**FEW, "sky": "open", "observation": {"integrity": "oracle"}}, 5),
]


def _side_by_side(name: str, config: dict[str, Any], count: int, steps: int, seed: int, tally: Tally) -> Engine:
    """Single environments and an engine with their draws, all started at once, until the first of them ends."""
    made = make_config(f"lanebound/{name}-v0", config)
    singles, rng = [DrivingEnv(made) for _ in range(count)], np.random.default_rng(seed)
    engine = Engine(DrivingEnv(made), count, alone=True)
    seeds: list[int | None] = [seed + row for row in range(count)]
    started = [single.reset(seed=s) for single, s in zip(singles, seeds, strict=True)]
    engine.reset(np.arange(count), seeds)
    for row, (single, (seen, info)) in enumerate(zip(singles, started, strict=True)):
        same(tally, f"{row} start", engine, row, single, _newest(single, seen), (0.0, False, False, info))
    views = [seen for seen, _ in started]
    for step in range(steps):
        actions = [command(single, _newest(single, seen), rng) for single, seen in zip(singles, views, strict=True)]
        engine.step(np.array(actions))
        over = False
        for row, single in enumerate(singles):
            views[row], reward, terminated, truncated, info = single.step(actions[row])
            told = (reward, terminated, truncated, info)
            same(tally, f"{row} step {step}", engine, row, single, _newest(single, views[row]), told)
            over = over or terminated or truncated
        tally.steps += count
        if over:
            break
    return engine


def _newest(single: DrivingEnv, seen: Any) -> Any:
    """The last observation of a stack, by group."""
    return {group: part[-(s.stop - s.start) :] for (group, s), part in zip(
        single.observer.slices.items(), seen.values(), strict=True)}  # fmt: skip


@pytest.mark.parametrize(("name", "config", "steps"), CASES)
def test_with_the_same_draws_it_is_the_single_environment(name: str, config: dict[str, Any], steps: int) -> None:
    tally = Tally()
    _side_by_side(name, config, 2, steps, 5, tally)
    require_equal(tally)
    assert tally.steps >= 8


@pytest.mark.slow
@pytest.mark.parametrize(("name", "config", "steps"), CASES)
def test_with_the_same_draws_for_long(name: str, config: dict[str, Any], steps: int) -> None:
    tally = Tally()
    for seed in range(0, 60, 3):
        _side_by_side(name, config, 3, 30 * steps, 100 + seed, tally)
    require_equal(tally)


def test_environments_start_anew_beside_others() -> None:
    made = make_config("lanebound/LaneKeeping-v0", {"sky": "open", "duration_s": 1.0})
    engine = Engine(DrivingEnv(made), 4)
    engine.reset(np.arange(4), [3, 4, 5, 6])
    engine.reset(np.array([1]), [7])
    ends = np.zeros(4, dtype=np.int64)
    for _ in range(12):
        engine.step(np.zeros((4, 2), dtype=np.float32))
        out = engine.world.out
        over = (out[:, k.O_TERMINATED] > 0.0) | (out[:, k.O_TRUNCATED] > 0.0)
        ends += over
        assert (np.abs(out[:, [k.O_ERR_AT, k.O_ERR_CT]]) < 1.0).all()  # another's solution would be far off
        if over.any():
            engine.reset(np.flatnonzero(over), [None] * int(over.sum()))
    assert (ends >= 2).all()


def test_the_same_seed_gives_the_same_drive_again() -> None:
    engine = Engine(DrivingEnv(make_config("lanebound/Highway-v0", FEW)), 3)
    drives = []
    for _ in range(2):
        engine.reset(np.arange(3), [11, 12, 13])
        for n in range(4):
            engine.step(np.full(3, n % 5))
        drives.append(engine.world.frame.copy())
    np.testing.assert_array_equal(drives[0], drives[1])


def test_levels_and_errors_are_those_of_navigation() -> None:
    made = make_config("lanebound/LaneKeeping-v0", {"sky": "open", "duration_s": 30.0})
    engine = Engine(DrivingEnv(made), 24)
    engine.reset(np.arange(24), list(range(24)))
    for _ in range(25):
        engine.step(np.zeros((24, 2), dtype=np.float32))
    belief, out = engine.world.belief, engine.world.out
    error = np.abs(out[:, [k.O_ERR_AT, k.O_ERR_CT]])
    assert (error < belief[:, [k.B_PL_AT, k.B_PL_CT]]).mean() > 0.95
    assert 0.005 < np.median(error) < 0.2
    assert (engine.world.sky.max(1) > 10).all()
    assert len(np.unique(engine.world.sky[:, 1])) > 3, "the hours must differ"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"perception": {"source": "v2v"}}, "perception.source"),
        ({"faults": "nominal"}, "faults"),
        ({"navigator": {"imu": {"mems_exponential": True}}}, "mems_exponential"),
    ],
)
def test_what_navigation_cannot_do_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Engine(DrivingEnv(make_config("lanebound/Highway-v0", {**FEW, **change})), 2)
