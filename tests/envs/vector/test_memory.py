"""The memory that the engine states for an environment is most of what Python holds for one more."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

from lanebound.envs.vector.env import engines


@pytest.mark.parametrize(("env", "config"), [("LaneKeeping", {}), ("Highway", {"perception": {"source": "sensor"}})])
def test_stated_memory_is_most_of_what_one_more_environment_holds(env: str, config: dict[str, Any]) -> None:
    kind, held, stated = engines()[f"lanebound/{env}-v0"], [], 0
    short = {**config, "duration_s": 5.0, "navigation": {"warm_up_s": 0.2}}
    for count in (1, 16, 48):  # the first fills caches
        tracemalloc.start()
        envs = kind(count, short, "Disabled")
        envs.reset(seed=1)
        envs.reset(options={"reset_mask": np.arange(count) < 2})  # makes the next episodes of all
        envs.step(envs.action_space.sample())
        held.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
        stated = envs.engine.bytes_per_environment
        envs.close()
    each = (held[2] - held[1]) / 32
    assert 0.7 * each < stated < 1.05 * each
