"""An engine whose vehicles take the poses of single environments, step by step: all else must have equal bits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from replay_kernel import FIELDS, run_replay

from lanebound.envs.batch.infos import form_of, infos_of, results, single_info
from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.seats import _onward
from lanebound.envs.vector.engine import Engine
from side_by_side import POSE, command, flat, newest, poses

__all__ = ["Replay"]

BASE = 1e-12  # of the reward of a world of highway-env


class Replay:
    """Single environments, and an engine whose traffic replays their poses.

    Attributes
    ----------
    differences : what has not been equal, by name; empty where all bits are
    steps, ends : policy steps and episodes that have been compared
    shift_m : added to x of the replayed poses, to show that a difference is found
    """

    def __init__(self, name: str, config: dict[str, Any], count: int, seed: int) -> None:
        made = make_config(f"lanebound/{name}-v0", config)
        self.singles, self.engine = [DrivingEnv(made) for _ in range(count)], Engine(DrivingEnv(made), count)
        self.differences: dict[str, str] = {}
        self.steps = self.ends = 0
        self.shift_m = 0.0
        self._rng = np.random.default_rng(seed)
        self._seen: list[Any] = [None] * count
        self._poses: list[list[NDArray[np.float64]]] = [[] for _ in range(count)]
        self._take_traffic()
        for row in range(count):
            self.reset(row, seed + row)

    def _take_traffic(self) -> None:
        """Put the replaying kernel, and room for the poses of a policy step, in place of the engine's traffic."""
        stage, engine = self.engine._stage, self.engine
        places = len(FIELDS) * engine.episodes.cars.shape[1]
        self._profile = np.zeros((engine.count, engine.frames * places))
        engine._kernel = run_replay
        self._traffic = stage.traffic._replace(profile=self._profile)

    def reset(self, row: int, seed: int | None) -> None:
        """Begin an episode in both."""
        self.engine.reset(np.array([row]), [seed])
        self._seen[row], info = self.singles[row].reset(seed=seed)
        self._note(row)
        self._compare(row, f"{row} start", (0.0, False, False, info))

    def _note(self, row: int) -> None:
        """Make a single environment note the poses of all vehicles after each simulation step."""
        loop, poses, places = self.singles[row].belief_loop, self._poses[row], self.engine.episodes.cars.shape[1]
        assert loop is not None
        sense = loop.sense

        def noting() -> None:
            sense()
            out = np.zeros((len(FIELDS), places))
            for i, v in enumerate(loop.world.road.vehicles):
                row = loop.episodes.table.row
                pose = v.position[0] + self.shift_m, v.position[1], v.heading, v.speed
                out[:, i] = *pose, row[v.lane_index], v.crashed, _onward(v, row)
            poses.append(out)

        loop.sense = noting  # type: ignore[method-assign]

    def step(self, count: int) -> None:
        """Drive on by so many policy steps under random commands; ended episodes are followed by others."""
        for n in range(count):
            actions = [
                command(single, newest(single, seen), self._rng)
                for single, seen in zip(self.singles, self._seen, strict=True)
            ]
            taken = []
            for row, single in enumerate(self.singles):
                self._poses[row].clear()
                self._seen[row], *rest = single.step(actions[row])
                assert len(self._poses[row]) == self.engine.frames
                self._profile[row] = np.roll(self._poses[row], self._turn(row), axis=0).ravel()
                taken.append(rest)
            stage, held = self.engine._stage, self.engine._stage.traffic
            stage.traffic = self._traffic  # the starts of episodes fill the profile of the engine's own traffic
            self.engine.step(np.array(actions))
            stage.traffic = held
            for row, (reward, terminated, truncated, info) in enumerate(taken):
                self._compare(row, f"{row} step {n}", (reward, terminated, truncated, info))
                self.steps += 1
                if terminated or truncated:
                    self.ends += 1
                    self.reset(row, None)

    def _turn(self, row: int) -> int:
        """Place of the first step of this policy step in the profile."""
        return int(self.engine.episodes.ego["score"]["steps"][row] % self.engine.frames)

    def _compare(self, row: int, where: str, step: Any) -> None:
        """Note every number that is not equal."""
        reward, terminated, truncated, info = step
        engine, single = self.engine, self.singles[row]
        out, frame = engine.outcome[row], engine.episodes.frame[row]
        seen, true, cars = flat(single, newest(single, self._seen[row])), poses(single), engine.episodes.cars[row]
        driven = np.array([cars[name][: true.shape[1]] for name in POSE])
        self._equal("poses", where, driven.tolist(), true.tolist())
        for entry, a, b in zip(single.observer.index, frame.tolist(), seen.tolist(), strict=True):
            self._equal(f"observation {entry.column}", where, a, b)
        self._equal("reward", where, float(out["reward"]), reward)
        self._equal("terminated", where, bool(out["terminated"] > 0.0), terminated)
        self._equal("truncated", where, bool(out["truncated"] > 0.0), truncated)
        infos = infos_of(results(engine.outcome), form_of(np.ones(engine.count, dtype=np.bool_)), {})
        self._same_info("info", where, single_info(infos, row), info)

    def _same_info(self, name: str, where: str, got: dict[str, Any], info: dict[str, Any]) -> None:
        self._equal(f"{name} keys", where, sorted(got), sorted(info))
        for key, value in info.items():
            if isinstance(value, dict):
                self._same_info(f"{name} {key}", where, got[key], value)
            elif isinstance(value, np.ndarray):
                self._equal(f"{name} {key}", where, got[key].tolist(), value.tolist())
            else:
                self._equal(f"{name} {key}", where, got[key], value)

    def _equal(self, name: str, where: str, a: Any, b: Any) -> None:
        same = type(a) is type(b) and (a == b or (isinstance(a, float) and np.isnan(a) and np.isnan(b)))
        if name.endswith("rewards base"):  # of offsets by NumPy's dot products, which round as the machine does
            same = same or abs(a - b) < BASE
        if not same and name not in self.differences:
            off = f", off by {abs(a - b):.3g}" if isinstance(a, float) and isinstance(b, float) else ""
            self.differences[name] = f"{where}: {a!r} in the engine, {b!r} in the single environment{off}"
