"""The batched core: N environments of one configuration as arrays, equal to as many single ones."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from lanebound.envs.core import DrivingEnv
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector import lanes_kernel as lk
from lanebound.envs.vector.chart import chart_of
from lanebound.envs.vector.lanes import lanes_of
from lanebound.envs.vector.rules import direct_ranges, duration_s, meta_codes, rules_of, trail_length
from lanebound.envs.vector.senses import Senses, sensing
from lanebound.envs.vector.start import most_vehicles, profile_steps, starter_of
from lanebound.envs.vector.step_kernel import DECIDE, FINISH, START, World, run_some
from lanebound.envs.vector.support import require_supported
from lanebound.integrity.core.accel import is_compiled, run_rows
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.rtk_status import RtkStatus

__all__ = ["Engine"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
LOG = logging.getLogger(__name__)
VEHICLE_FRAME_US, FINISH_US = 0.06, 5.0  # of one thread, measured
WORLD_SEEDS, EPISODE_SEEDS = 2**31, 2**62  # as DrivingEnv.reset draws them


class Stage(NamedTuple):
    """Where N episodes take place, or wait to: everything that changes, and what is sensed of it."""

    world: World
    senses: Senses | None

    @property
    def nbytes(self) -> int:
        """Memory of all this."""
        return sum(array.nbytes for array in self.world) + (0 if self.senses is None else self.senses.nbytes)

    def adopt(self, rows: Rows, other: Stage) -> None:
        """Go on with the episodes ``rows`` of another stage."""
        ours: tuple[Any, ...] = self.world
        waiting: tuple[Any, ...] = other.world
        for mine, theirs in zip(ours, waiting, strict=True):
            mine[rows] = theirs[rows]
        if self.senses is not None and other.senses is not None:
            self.senses.adopt(rows, other.senses)


class Engine:
    """N environments that step together.

    Episodes that follow on others are made ready beforehand, those of all environments that have none waiting at once:
    navigation starts some seconds before an episode does, and many vehicles take hardly longer than one. So most resets
    copy arrays, and one in many takes long.

    Parameters
    ----------
    single : one environment of the configuration, asked for spaces, roads and figures; it is not driven
    count : number N of environments

    Attributes
    ----------
    world : everything that changes, see :class:`~lanebound.envs.vector.step_kernel.World`
    lanes, chart, rules : what all environments share
    codes : (A,) code of each meta-action of the action space, none under continuous actions

    Raises
    ------
    ConfigError
        A configuration that the engine cannot do as a single environment does.
    """

    def __init__(self, single: DrivingEnv, count: int) -> None:
        require_supported(single)
        if not is_compiled(run_some):
            LOG.warning("compiling the vector engine for this machine: some minutes, once")
        self.single, self.count = single, count
        network = single.world.road.network
        self.lanes, self.chart = lanes_of(network), chart_of(network, single.config.observation)
        self.rules = rules_of(single)
        self.frames = single.config.simulation_hz // single.config.policy_hz
        self._everyone = np.arange(count)
        self.codes = meta_codes(single.world)
        self._ranges = direct_ranges(single.world)
        self._start = starter_of(single.world, self.lanes)
        self._generators: list[np.random.Generator | None] = [None] * count
        self._drawn: dict[int, tuple[int, int]] = {}
        self.world = self._empty()
        self.senses: Senses | None = None
        if sensing(single):
            length = duration_s(single.config, single.world)
            self.senses = Senses(single, count, self.lanes, self.rules.figures, length)
        self._driven = Stage(self.world, self.senses)
        self._next: Stage | None = None
        self._begun = np.zeros(count, dtype=np.bool_)  # whether an environment has had an episode
        self._waits = np.zeros(count, dtype=np.bool_)  # whether its next one is ready

    def _empty(self) -> World:
        """Arrays for N environments, before any start."""
        n, config, world = self.count, self.single.config, self.single.world
        vehicles, entries = most_vehicles(world), len(self.single.observer.index)
        others = max(vehicles - 1, 1)
        return World(
            cars=np.zeros((n, k.CAR, vehicles)),
            whole=np.zeros((n, k.WHOLE, vehicles), dtype=np.int64),
            belief=np.zeros((n, k.BELIEF)),
            score=np.zeros((n, k.SCORE)),
            out=np.zeros((n, k.OUT)),
            traffic=np.zeros((n, others, k.SEEN)),
            seen=np.zeros(n, dtype=np.int64),
            profile=np.zeros((n, profile_steps(world))),
            trail=np.zeros((n, trail_length(config), 2)),
            observed=np.zeros(n, dtype=np.int64),
            sky=np.full((n, 3 * len(config.observation.satellites_m)), -1.0),
            frame=np.zeros((n, entries), dtype=np.float32),
        )

    @property
    def bytes_per_environment(self) -> int:
        """Memory of the arrays that grow with N, per environment: of its episode, and of the next once there is one."""
        stages = [self._driven] if self._next is None else [self._driven, self._next]
        return sum(stage.nbytes for stage in stages) // self.count

    # An episode

    def reset(self, rows: Rows, seeds: list[int | None]) -> None:
        """Begin an episode in the environments ``rows``, each with its seed or from where its generator is."""
        follows = self._begun[rows] & np.array([seed is None for seed in seeds], dtype=np.bool_)
        first = rows[~follows]
        if first.size:
            self._begun[first] = self._waits[first] = False
            self._begin(self._driven, first, [seed for seed, on in zip(seeds, follows, strict=True) if not on])
            self._begun[first] = True
        if first.size < rows.size:
            self._go_on(rows[follows])

    def _go_on(self, rows: Rows) -> None:
        """Take the next episodes of environments, which are made ready where there is none."""
        if self._next is None:
            self._next = Stage(self._empty(), None if self.senses is None else self.senses.another())
        if not self._waits[rows].all():
            lacking = np.flatnonzero(self._begun & ~self._waits)
            self._begin(self._next, lacking, [None] * lacking.size)
            self._waits[lacking] = True
        self._driven.adopt(rows, self._next)
        self._waits[rows] = False

    def _begin(self, stage: Stage, rows: Rows, seeds: list[int | None]) -> None:
        """Begin episodes on a stage."""
        drawn, w = [self._draw(e, seed) for e, seed in zip(rows.tolist(), seeds, strict=True)], stage.world
        for e, (_, world) in zip(rows.tolist(), drawn, strict=True):
            self._start(seeding.np_random(world)[0], w.cars[e], w.whole[e], w.profile[e])
        self._know_all(w, rows)
        if stage.senses is not None:
            stage.senses.begin(rows, [episode for episode, _ in drawn], w)
        self._run(w, rows, 0, FINISH | START)
        for e in rows.tolist():
            del self._drawn[e]

    def step(self, actions: NDArray[Any], rows: Rows | None = None) -> None:
        """Carry out commands (N,) or (N, A) until the next decision, in all environments or in ``rows`` of them."""
        where = self._everyone if rows is None else rows
        codes = self._everyone
        if self.codes.size:
            codes = self.codes[actions]
        else:
            self._take_up(actions)
        if self.senses is None:
            self._run(self.world, where, self.frames, DECIDE | FINISH, codes)
            return
        for frame in range(1, self.frames + 1):
            self._run(self.world, where, 1, DECIDE if frame == 1 else 0, codes)
            follow = self.senses.coast if frame % self.senses.steps else self.senses.navigate
            follow(where, self.world)
        self.senses.foresee(where, self.world)
        self._run(self.world, where, 0, FINISH)

    def _run(self, world: World, rows: Rows, frames: int, parts: int, actions: Rows | None = None) -> None:
        chosen = self._everyone if actions is None else actions
        row_us = VEHICLE_FRAME_US * frames * world.cars.shape[2] + (FINISH_US if parts & FINISH else 0.0)
        shared = self.lanes, self.chart, self.rules
        run_rows(run_some, rows.size, rows, frames, parts, chosen, world, *shared, row_us=row_us)

    def _take_up(self, actions: NDArray[Any]) -> None:
        """Continuous commands in physical units, in the precision of the action as highway-env maps it."""
        column = 0
        for target, between in zip((k.B_THROTTLE, k.B_TURN), self._ranges, strict=True):
            if between is not None:
                share = np.clip(actions[:, column], -1, 1)
                self.world.belief[:, target] = between[0] + (share - -1) * (between[1] - between[0]) / (1 - -1)
                column += 1

    def sensible(self) -> NDArray[np.bool_]:
        """Which of left, idle, right, faster and slower make sense for each ego by its belief, (N, 5)."""
        b, table, wanted = self.world.belief, self.lanes.table, self.rules.speeds
        own = table[b[:, k.B_LANE].astype(np.int64)]
        s, beside = b[:, k.B_ALONG], 2.0 * own[:, lk.WIDTH]
        there = (s >= 0.0) & (s < own[:, lk.LENGTH] + lk.VEHICLE_LENGTH_M)
        left = (own[:, lk.SIDE] > 0) & (np.abs(b[:, k.B_LATERAL] + own[:, lk.WIDTH]) <= beside)
        right = own[:, lk.SIDE] < own[:, lk.COUNT] - 1
        right &= np.abs(b[:, k.B_LATERAL] - own[:, lk.WIDTH]) <= beside
        speed = b[:, k.B_TARGET_SPEED]
        every = np.ones_like(there)
        return np.stack([left & there, every, right & there, speed < wanted[-1], speed > wanted[0]], -1)

    # Starts

    def _draw(self, e: int, seed: int | None) -> tuple[int, int]:
        """The seeds of an episode and of its world, as :meth:`DrivingEnv.reset` draws them.

        They are kept until it is ready, so that one whose making was interrupted is made again and not left out.
        """
        generator = self._generators[e]
        if seed is not None or generator is None:
            generator = self._generators[e] = seeding.np_random(seed)[0]
            self._drawn.pop(e, None)
        if e not in self._drawn:
            episode = int(generator.integers(EPISODE_SEEDS))
            world = seed if seed is not None else int(generator.integers(WORLD_SEEDS))
            self._drawn[e] = episode, world
        return self._drawn[e]

    def _know_all(self, w: World, rows: Rows) -> None:
        """Beliefs and scores at the start, from the true poses."""
        c = w.cars
        w.score[rows] = 0.0
        w.belief[rows] = 0.0
        poses = {k.B_X: k.X, k.B_Y: k.Y, k.B_HEADING: k.HEADING, k.B_SPEED: k.SPEED}
        for belief, car in poses.items():
            w.belief[rows, belief] = c[rows, car, 0]
        w.belief[rows, k.B_LANE] = w.belief[rows, k.B_TARGET_LANE] = w.whole[rows, k.LANE, 0]
        speeds = self.rules.speeds
        share = (c[rows, k.SPEED, 0] - speeds[0]) / (speeds[-1] - speeds[0])
        nearest = np.clip(np.round(share * (speeds.size - 1)), 0, speeds.size - 1).astype(np.int64)
        w.belief[rows, k.B_TARGET_SPEED] = speeds[nearest]
        w.belief[rows, k.B_AVAILABLE] = 1.0
        w.belief[rows, k.B_MODE], w.belief[rows, k.B_RTK] = int(Mode.RTK), RtkStatus.FIXED.code
        w.belief[rows, k.B_REASON] = AlertReason.NONE.code
