"""Cost of the layer in the driving loop: whole wrapped steps against bare highway-env, and the layer's share of them.

Both sides drive the same id with the same rates, traffic and seeds; the bare side observes highway-env's Kinematics.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import gymnasium
from highway_env.envs.common.abstract import AbstractEnv

from lanebound.agents.bench.rows import Row
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.batch.navigation import NavigationBatch
from lanebound.envs.world import guard

__all__ = ["bare_of", "measure"]

GATES = {"Highway": (1.0, 1.0, 0.1), "Merge": (1.0, 5.0, 1.5)}
IDS = ("Highway", "Merge", "Roundabout", "Intersection", "Racetrack")
STEPS, SEED = 4, 1


def _wrapped(name: str, source: str) -> DrivingEnv:
    return DrivingEnv(make_config(f"lanebound/{name}-v0", {"perception": {"source": source}}))


def bare_of(env: DrivingEnv) -> AbstractEnv:
    """highway-env's own environment of the same configuration, with a Kinematics observation."""
    kind = type(env.world)
    return guard(kind, {**env.world.config, "observation": {"type": "Kinematics"}})


def _run(env: gymnasium.Env[Any, Any], command: Any) -> tuple[float, int]:
    """Seconds and policy steps of the first steps of an episode; the reset is not counted."""
    env.reset(seed=SEED)
    begun, count, over = time.perf_counter(), 0, False
    while count < STEPS and not over:
        _, _, terminated, truncated, _ = env.step(command)
        count, over = count + 1, terminated or truncated
    return time.perf_counter() - begun, count


class _Clock:
    """Adds up the time that navigation takes in single environments: skies, measurements and solutions."""

    def __init__(self) -> None:
        self.seconds, self._kept = 0.0, {name: getattr(NavigationBatch, name) for name in ("sense", "locate")}

    def __enter__(self) -> _Clock:
        for name, kept in self._kept.items():
            setattr(NavigationBatch, name, self._timed(kept))
        return self

    def _timed(self, kept: Any) -> Any:
        def timed(*given: Any) -> None:
            begun = time.perf_counter()
            try:
                kept(*given)
            finally:
                self.seconds += time.perf_counter() - begun

        return timed

    def __exit__(self, *_: object) -> None:
        for name, kept in self._kept.items():
            setattr(NavigationBatch, name, kept)


def _shares(name: str, source: str, rounds: int) -> tuple[float, float]:
    """Layer time over the bare step's time [%], and bare over wrapped time, medians over the rounds."""
    env = _wrapped(name, source)
    bare = bare_of(env)
    command = 1 if hasattr(env.action_space, "n") else env.action_space.sample() * 0.0
    _run(env, command), _run(bare, command)
    shares, ratios = [], []
    for _ in range(rounds):
        seconds, count = _run(bare, command)
        with _Clock() as clock:
            env.reset(seed=SEED)
            clock.seconds = 0.0
            begun = time.perf_counter()
            for _ in range(count):
                env.step(command)
            whole = time.perf_counter() - begun
        shares.append(100.0 * clock.seconds / seconds)
        ratios.append(seconds / whole)
    return statistics.median(shares), statistics.median(ratios)


def measure(rounds: int = 5) -> list[Row]:
    """Shares of the layer for the ego alone and with every neighbour's navigator, and the ratio of whole steps."""
    rows = []
    for name in IDS:
        ratio_gate, share_gate, share_stretch = GATES.get(name, (1.0, None, None))
        share, _ = _shares(name, "sensor", rounds)
        rows.append(Row(f"layer_share_{name}", share, "%", share_gate, share_stretch, higher_is_better=False))
        share, ratio = _shares(name, "v2v", rounds)
        gate, stretch = (10.0, 2.0) if name == "Highway" else (None, None)
        rows.append(Row(f"layer_share_v2v_{name}", share, "%", gate, stretch, higher_is_better=False))
        rows.append(Row(f"wrapped_vs_bare_{name}", ratio, "x", ratio_gate, 1.3 if name == "Merge" else None))
    return rows
