"""Ids of highway-env that have none of ours: the engine drives them as ``wrap`` does."""

from __future__ import annotations

from typing import Any

import pytest

from lanebound.envs.registration import wrap
from lanebound.envs.vector.engine import Engine
from side_by_side import PERFECT, Tally, drive, require_equal

CASES: list[tuple[str, dict[str, Any], int]] = [
    ("highway-fast-v0", {"world": {"vehicles_density": 2.0}}, 20),
    ("highway-fast-v0", {"action": "continuous"}, 6),
    ("exit-v0", {"reward": {"base": 0.5}}, 36),
    ("exit-v1", {"action": "continuous"}, 12),
    ("two-way-v0", {"reward": {"base": 0.5}}, 30),
    ("u-turn-v0", {"reward": {"base": 0.5}}, 20),
    ("u-turn-v1", {"action": "continuous"}, 12),
    ("u-turn-v1", {}, 20),
]


@pytest.mark.parametrize(("base", "config", "steps"), CASES, ids=lambda value: value if isinstance(value, str) else "")
def test_it_drives_as_the_single_environment(base: str, config: dict[str, Any], steps: int) -> None:
    made = {**PERFECT, **config}
    single, engine = wrap(base, made), Engine(wrap(base, made), 2)
    tally = Tally()
    for seed in (3, 4, None):
        drive(single, engine, seed, tally, steps, row=1)
    require_equal(tally)
    assert tally.steps >= 12
