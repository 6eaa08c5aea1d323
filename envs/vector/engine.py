"""The vector engine: N environments of one configuration in compiled traffic, equal to N single environments."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from highway_env.envs.common.action import ContinuousAction, DiscreteMetaAction
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.batch.ego_kernel import FASTER, IDLE, LEFT, RIGHT, SLOWER
from lanebound.envs.batch.episodes import Episodes, copy_rows
from lanebound.envs.batch.lanes_kernel import NONE, PAST_END_M
from lanebound.envs.batch.next_lane_kernel import keep_rows
from lanebound.envs.core import EPISODE_SEEDS, WORLD_SEEDS, DrivingEnv
from lanebound.envs.scene import begin_all, duration_s, give_faults, make_batch
from lanebound.envs.vector.drive_kernel import TrafficFigures
from lanebound.envs.vector.drivers_kernel import DRIVER
from lanebound.envs.vector.start_kernel import clear_rows, seat_rows
from lanebound.envs.vector.support import (
    drivers_of,
    newcomers_of,
    require_supported,
    roads_of,
    support_of,
    traffic_of,
)
from lanebound.envs.vector.turnover import Turnover
from lanebound.envs.vector.world_kernel import WORLD, judge_rows
from lanebound.envs.worlds.closures import announce, stand_in_lane
from lanebound.envs.worlds.followers import seat_followers
from lanebound.envs.worlds.tolling import ClaimAction, levy, sensible_claims
from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import ZIGGURAT
from lanebound.integrity.sensors.faults import Fault

__all__ = ["Engine", "meta_codes"]

Rows = NDArray[np.int64]
VEHICLE_FRAME_US = 0.06  # of one thread, measured
PREPARED = 8  # episodes at least that are prepared together; up to so many take hardly longer than one
NO_CODES = np.zeros(0, dtype=np.int64)
META_CODES = {"LANE_LEFT": LEFT, "IDLE": IDLE, "LANE_RIGHT": RIGHT, "FASTER": FASTER, "SLOWER": SLOWER,
              "CHARGE": IDLE, "SPARE": IDLE}  # fmt: skip


class Stage:
    """All state of N episodes that run, or of A N that wait: the k-th of environment e is in row ``k N + e``.

    Attributes
    ----------
    episodes : beliefs and scores of the egos
    drivers : (N, V) DRIVER, state of the vehicles beyond their poses
    traffic : parameters of their motion
    """

    def __init__(self, engine: Engine, episodes: Episodes) -> None:
        world, support = engine.single.world, engine.support
        profile = np.zeros((len(episodes.cars), support.profiles(world), support.profile_steps(world)))
        self.episodes, self.drivers = episodes, np.zeros(episodes.cars.shape, DRIVER)
        self.traffic = TrafficFigures(
            engine.world,
            engine.speeds,
            profile,
            engine.wander,
            engine.idm,
            episodes.table.lanes,
            engine.roads._replace(objects=np.repeat(engine.roads.objects, len(profile), axis=0)),
            engine.before,
        )
        self.turnover = Turnover(engine, episodes)

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Those of the traffic that have a row for each environment."""
        return self.drivers, self.traffic.profile, self.traffic.roads.objects

    @property
    def nbytes(self) -> int:
        """Memory of all this."""
        return self.episodes.nbytes + sum(array.nbytes for array in self.arrays)

    def adopt(self, rows: Rows, other: Stage, k: int) -> None:
        """Continue in environments ``rows`` with their k-th episodes of a stage of waiting ones."""
        theirs = rows + k * len(self.drivers)
        copy_rows(self.arrays, rows, other.arrays, theirs)
        self.turnover.adopt(rows, other.turnover, theirs)
        self.episodes.adopt(rows, other.episodes, theirs)


class Engine:
    """N environments that step together.

    The next episodes of all environments without a waiting one are prepared together, and several for each where there
    are few: navigation starts some seconds before an episode, and many vehicles take hardly longer than one. So most
    resets only copy arrays, and a few are slow.

    Parameters
    ----------
    single : one environment of the configuration, the source of spaces, roads and parameters; it is not stepped
    count : number N of environments

    Attributes
    ----------
    episodes : beliefs and scores of the egos
    drivers : state of the vehicles beyond their poses
    codes : (A,) code of each meta-action of the action space, none under continuous actions
    speeds : target speeds of meta-actions
    wander : shapes over time of the other drivers' lines in their lanes (S, K), by simulation step
    idm : (1,) DRIVERS, parameters of the other drivers
    plans, roads : routes that the vehicles may have, and what else the roads have beyond their lanes
    before : simulation steps of the traffic before an episode
    newcomers : slots for vehicles that enter during an episode

    Raises
    ------
    ConfigError
        A configuration that the engine does not support.
    """

    def __init__(self, single: DrivingEnv, count: int) -> None:
        require_supported(single)
        self.single, self.count, self.support = single, count, support_of(single.config)
        config, inner = single.config, single.world.action_type
        self.frames = config.simulation_hz // config.policy_hz
        self.codes = meta_codes(single)
        self.speeds = np.array(inner.target_speeds if self.codes.size else [0.0, 1.0], dtype=np.float64)
        self._ranges = _direct_ranges(inner)
        self.world = self._world()
        steps = math.ceil(self.duration_s * config.simulation_hz) + 1 + self.frames  # the last decision goes beyond it
        self.wander = config.wander.shapes(0, steps, 1.0 / config.simulation_hz)
        self._everyone = np.arange(count)
        self._generators: list[np.random.Generator | None] = [None] * count
        self._drawn: dict[tuple[bool, int], tuple[int, int]] = {}  # by whether it is to wait, and its row
        self.newcomers = newcomers_of(config, self.support)
        vehicles = self.support.vehicles(single.world) + config.traffic.behind
        capacity = min(config.slots, vehicles - 1 + self.newcomers)
        if self.newcomers:  # one may enter after each decision
            vehicles += math.ceil(self.duration_s * config.policy_hz) + 1
        self._ahead = max(1, PREPARED // count)
        episodes = make_batch(single.world, config, count, self._ahead * count, vehicles, capacity)
        self.idm, self.before = drivers_of(self.support, single.world), self.support.before(single.world)
        self.plans = self.support.plans(single.world, episodes.table)
        self.roads = roads_of(single.world, episodes.table, self.plans)
        self._routed = self.plans.own > 1 and episodes.ego_is_sensed
        episodes.path_of = self.plans.paths(episodes.routes)
        self._take_functions(episodes)
        self._stage = Stage(self, episodes)
        self._next: Stage | None = None
        self._begun = np.zeros(count, dtype=np.bool_)  # whether an environment has had an episode
        self._waits = np.zeros(count, dtype=np.int64)  # how many next ones are ready

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the functions of the world."""
        of_world = "support", "entrance", "_kernel", "_start"
        return {name: value for name, value in self.__dict__.items() if name not in of_world}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.support = support_of(self.single.config)
        self._take_functions(self.episodes)

    def _take_functions(self, episodes: Episodes) -> None:
        """Those of the world."""
        world, table = self.single.world, episodes.table
        self._kernel, self._start = traffic_of(self.support), self.support.starter(world, table)
        self.entrance = None if self.support.entrance is None else self.support.entrance(world, table)

    def _world(self) -> Any:
        """The record of the world."""
        inner = self.single.world.action_type
        slowest, fastest = getattr(inner, "speed_range", None) or (Vehicle.MIN_SPEED, Vehicle.MAX_SPEED)
        figures: dict[str, Any] = dict.fromkeys(WORLD.names or (), 0.0)
        figures |= {"speed_least_mps": slowest, "speed_most_mps": fastest, "end_m": -1.0}
        figures |= {"ends_x_m": math.inf, "goal_road": NONE}
        figures |= {"episode_s": self.duration_s}
        return one_record(WORLD, **(figures | dict(self.support.ends(self.single.world))))

    @property
    def episodes(self) -> Episodes:
        """Beliefs and scores of the egos."""
        return self._stage.episodes

    @property
    def duration_s(self) -> float:
        """When an episode is truncated."""
        return duration_s(self.single.config, self.single.world)

    @property
    def outcome(self) -> Records:
        """(N,) OUTCOME of the last step."""
        return self.episodes.ego["outcome"]

    @property
    def frame(self) -> NDArray[np.float32]:
        """(N, E) newest observations."""
        return self.episodes.frame

    @property
    def ready(self) -> NDArray[np.bool_]:
        """(N,) which environments have a next episode that waits."""
        return self._waits > 0

    @property
    def own_info(self) -> Mapping[str, NDArray[np.float64]]:
        """(N,) each, the newest numbers of ``info`` that not all environments have, by name."""
        return self.episodes.own_info

    @property
    def drivers(self) -> Records:
        """(N, V) DRIVER, state of the vehicles beyond their poses."""
        return self._stage.drivers

    @property
    def bytes_per_environment(self) -> int:
        """Memory of the arrays that grow with N, per environment: of its episode, and of the next once there is one.

        Not in it are the scratch of a navigation epoch, a fifth of LaneKeeping's, and the cities, at most one for each
        of these episodes; ``lanebound bench --scale`` has all.
        """
        stages = [self._stage] if self._next is None else [self._stage, self._next]
        return sum(stage.nbytes for stage in stages) // self.count

    # An episode

    def reset(
        self, rows: Rows, seeds: list[int | None], faults: Sequence[Sequence[Fault] | None] = ()
    ) -> None:  # fmt: skip
        """Begin an episode in the environments ``rows``, each with its seed or from where its generator is.

        ``faults``: of each of them, in the place of the random ones unless None.

        Raises
        ------
        InputError
            A fault cannot act in its episode; the episodes have begun.
        """
        follows = self._begun[rows] & np.array([seed is None for seed in seeds], dtype=np.bool_)
        first = rows[~follows]
        if first.size:
            self._begun[first], self._waits[first] = False, 0
            self._begin(self._stage, first, [seed for seed, on in zip(seeds, follows, strict=True) if not on])
            self._begun[first] = True
        if first.size < rows.size:
            self._go_on(rows[follows])
        for row, given in zip(rows.tolist(), faults, strict=False):
            if given is not None:
                give_faults(self.episodes, row, given, self.duration_s)

    def _go_on(self, rows: Rows) -> None:
        """Take the next episodes of environments, which are made ready where there is none."""
        if not self._waits[rows].all():
            self.prepare()
        assert self._next is not None
        turns = self._ahead - self._waits[rows]
        for k in set(turns.tolist()):
            self._stage.adopt(rows[turns == k], self._next, k)
        self._waits[rows] -= 1

    def prepare(self) -> None:
        """Make the next episodes of all environments that have begun and have no waiting one; none is changed by it."""
        lacking = np.flatnonzero(self._begun & (self._waits == 0))
        if not lacking.size:
            return
        if self._next is None:
            self._next = Stage(self, self.episodes.another(self._ahead * self.count))
        places = (self.count * np.arange(self._ahead)[:, None] + lacking).ravel()
        self._begin(self._next, places, [None] * places.size)
        self._waits[lacking] = self._ahead

    def _begin(self, stage: Stage, rows: Rows, seeds: list[int | None]) -> None:
        """Begin episodes on a stage."""
        waits = stage is self._next
        drawn = [self._draw(waits, row, seed) for row, seed in zip(rows.tolist(), seeds, strict=True)]
        episodes, seeds_of_episodes = stage.episodes, [episode for episode, _ in drawn]
        generators = [seeding.np_random(world)[0] for _, world in drawn]
        self._line_up(stage, rows, seeds_of_episodes, generators)
        starts = begin_all(episodes, rows, seeds_of_episodes, self.newcomers, self.duration_s)
        stage.turnover.begin(rows, generators, seeds_of_episodes, starts)
        speeds, speed = self.speeds, episodes.cars["speed"][rows, 0]
        share = (speed - speeds[0]) / (speeds[-1] - speeds[0])
        nearest = np.minimum(np.maximum(np.rint(share * (speeds.size - 1)), 0), speeds.size - 1).astype(np.int64)
        for name in ("belief", "eye"):
            episodes.ego[name]["target_speed_mps"][rows] = speeds[nearest]
        keep_rows(rows, episodes.ego, episodes.table.lanes, self.plans.steps, episodes.rules)
        e = episodes
        judge_rows(0, rows.size, rows, e.cars, stage.drivers, e.ego, e.table.lanes, e.rules, self.world, True)
        episodes.score_and_observe(rows, start=True)
        for row in rows.tolist():
            del self._drawn[waits, row]

    def _line_up(
        self, stage: Stage, rows: Rows, seeds: list[int], generators: list[np.random.Generator]
    ) -> None:  # fmt: skip
        """Put the vehicles of environments where the generator of their world draws them, and others on their lines."""
        cars, ego, drivers, traffic = stage.episodes.cars, stage.episodes.ego, stage.drivers, stage.traffic
        config, table, network = self.single.config, stage.episodes.table, self.single.world.road.network
        wander = config.wander
        clear_rows(rows, cars, drivers, Vehicle.LENGTH, Vehicle.WIDTH)
        for e, seed, generator in zip(rows.tolist(), seeds, generators, strict=True):
            count = self._start(generator, cars[e], drivers[e], traffic.profile[e])
            ego["vehicles"][e] = seat_followers(config.traffic, seed, cars[e], drivers[e], count, table, network)
            if (closure := getattr(self.single.world, "closure", None)) is not None:  # of the episode drawn just now
                stand_in_lane(traffic.roads.objects[e], table, network, closure)
                announce(ego["closure"][e], table, network, closure, config.perception.v2v, seed)
            levy(ego["toll"], e, table, getattr(self.single.world, "tolled", ()))
        states = wander.states(seeds) if wander.wanders else None
        seat_rows(rows, cars, drivers, ego, traffic.wander, states, ZIGGURAT, table.lanes, traffic.roads.routes)

    def step(self, actions: NDArray[Any], rows: Rows | None = None) -> None:
        """Carry out commands (N,) or (N, A) until the next decision, in all environments or in ``rows`` of them."""
        e, where, codes = self.episodes, self._everyone if rows is None else rows, NO_CODES
        if self.codes.size:
            codes = self.codes[actions]
        else:
            self._take_up(actions)
        if isinstance(self.single.world.action_type, ClaimAction):
            e.ego["command"]["claim"] = actions
        if self.support.effort is not None:
            e.ego["command"]["effort"] = self.support.effort(self.single.world, actions)
        frames = self.frames if e.epoch_steps is None else e.epoch_steps
        for frame in range(0, self.frames, frames):
            self._drive(where, frames, frame + frames == self.frames, codes)
            codes = NO_CODES
            if self.entrance is not None and frame + frames == self.frames:
                self._stage.turnover.step(self._stage.drivers, where)
            if e.epoch_steps is not None:
                self._end_epoch(where)
        e.score_and_observe(where, start=False)

    def _end_epoch(self, rows: Rows) -> None:
        """Sense, locate and perceive where a navigation epoch ends."""
        e = self.episodes
        e.sense(rows)
        e.locate(rows)
        if self._routed:
            keep_rows(rows, e.ego, e.table.lanes, self.plans.steps, e.rules)
        e.perceive(rows, e.times_s[rows])

    def _drive(self, rows: Rows, frames: int, ends: bool, codes: Rows) -> None:
        """Simulation steps of all vehicles, in which egos carry out meta-actions ``codes``, if there are any.

        Where the policy step ``ends`` with them, end rules and reward of the wrapped world judge it.
        """
        e, stage = self.episodes, self._stage
        run_rows(
            self._kernel, rows.size, rows, frames, ends, codes, e.cars, stage.drivers, e.ego, e.motions,
            e.rules, stage.traffic, row_us=VEHICLE_FRAME_US * frames * e.cars.shape[1],
        )  # fmt: skip

    def _take_up(self, actions: NDArray[Any]) -> None:
        """Continuous commands in physical units, in the precision of the action as highway-env maps it."""
        column, command = 0, self.episodes.ego["command"]
        for target, between in zip(("acceleration_mps2", "steering_rad"), self._ranges, strict=True):
            if between is not None:
                share = np.clip(actions[:, column], -1, 1)
                command[target] = between[0] + (share - -1) * (between[1] - between[0]) / (1 - -1)
                column += 1

    def sensible(self) -> NDArray[np.bool_]:
        """Which meta-actions make sense for each ego by its belief, (N, A)."""
        if isinstance(self.single.world.action_type, ClaimAction):
            return sensible_claims(self.episodes.ego)
        b, wanted = self.episodes.ego["belief"], self.speeds
        own = self.episodes.table.lanes.table[b["lane"]]
        s, width, aside = b["longitudinal_m"], own["width_m"], b["lateral_m"]
        there = (s >= 0.0) & (s < own["length_m"] + PAST_END_M)
        left = (own["side"] > 0) & (np.abs(aside + width) <= 2.0 * width)
        right = (own["side"] < own["count"] - 1) & (np.abs(aside - width) <= 2.0 * width)
        free = self.episodes.table.lanes.table["forbidden"] == 0
        left, right = left & free[b["lane"] - 1], right & free[np.minimum(b["lane"] + 1, free.size - 1)]
        speed, every = b["target_speed_mps"], np.ones_like(there)
        return np.stack([left & there, every, right & there, speed < wanted[-1], speed > wanted[0]], -1)[:, self.codes]

    # Starts

    def _draw(self, waits: bool, row: int, seed: int | None) -> tuple[int, int]:
        """The seeds of the episode in a row of a stage and of its world, drawn as by :meth:`DrivingEnv.reset`.

        They are stored until the episode is ready, so that an interrupted preparation is repeated with the same seeds.
        """
        e = row % self.count
        generator = self._generators[e]
        if seed is not None or generator is None:
            generator = self._generators[e] = seeding.np_random(seed)[0]
            self._drawn = {key: seeds for key, seeds in self._drawn.items() if key[1] % self.count != e}
        if (waits, row) not in self._drawn:
            episode = int(generator.integers(EPISODE_SEEDS))
            world = seed if seed is not None else int(generator.integers(WORLD_SEEDS))
            self._drawn[waits, row] = episode, world
        return self._drawn[waits, row]


def meta_codes(single: DrivingEnv) -> Rows:
    """(A,) code of each meta-action of the action space, none under continuous actions."""
    inner = single.world.action_type
    actions = inner.actions if isinstance(inner, DiscreteMetaAction) else {}
    return np.array([META_CODES[actions[n]] for n in range(len(actions))], dtype=np.int64)


def _direct_ranges(inner: Any) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Ranges of acceleration and steering of continuous actions, None for one that is not commanded."""
    if not isinstance(inner, ContinuousAction):
        return None, None
    return (
        inner.acceleration_range if inner.longitudinal else None,
        inner.steering_range if inner.lateral else None,
    )
