"""What N egos sense: one navigator locates all vehicles that navigate, each in its own city at its own hour.

At the end of an epoch :meth:`Senses.navigate` brings up to date where the egos believe to be (:mod:`.trackers`) and
whom they perceive (:mod:`.perceptions`), which takes the navigation of the others where they broadcast it.
"""

from __future__ import annotations

import copy
from dataclasses import is_dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.cockpit import HEARD_S
from lanebound.envs.core import DrivingEnv
from lanebound.envs.motion import Motion
from lanebound.envs.navigation import place
from lanebound.envs.scene import alert_limits_m, map_bound_m, navigator_config
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.lanes_kernel import Lanes
from lanebound.envs.vector.perceptions import Perceptions, claims_of
from lanebound.envs.vector.scenes import Scenes, draw_scenes
from lanebound.envs.vector.senses_kernel import foresee, glance_all, poses_of, whereabouts
from lanebound.envs.vector.skies import Skies
from lanebound.envs.vector.start import most_vehicles
from lanebound.envs.vector.step_kernel import World
from lanebound.envs.vector.streams import CrewStreams
from lanebound.envs.vector.trackers import Trackers
from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.navigators.navigator import Navigator
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.sky.view import SkyView

__all__ = ["Senses", "sensing"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def sensing(single: DrivingEnv) -> bool:
    """Whether anything is sensed in a configuration: the ego's own place, or other vehicles."""
    others = most_vehicles(single.world) > 1
    return single.config.navigation.source.senses or (others and single.config.perception.source not in GIVEN)


GIVEN = ("truth", "none")


class Senses:
    """What the egos know of themselves and of others.

    Every environment goes by a time of its own, so that all its episodes are as those of a single one.

    Parameters
    ----------
    single : an environment of the configuration
    count : number N
    lanes, figures : its lanes and figures
    duration_s : when episodes are truncated
    """

    def __init__(self, single: DrivingEnv, count: int, lanes: Lanes, figures: Array, duration_s: float) -> None:
        config, others = single.config, most_vehicles(single.world) - 1
        limits = alert_limits_m(single.world, config)
        settings = navigator_config(config, limits)
        self._config, self._layouts = config.navigation, config.layouts
        self._lanes, self._figures, self._everyone = lanes, figures, np.arange(count)
        self._map_bound_m, self._limits_m = map_bound_m(config, settings), limits
        self.skies = Skies.of(single, settings, duration_s)
        self.step_s = 1.0 / config.simulation_hz
        self.steps = config.navigation.steps_per_epoch(config.simulation_hz)
        self.epoch_s = self.step_s * self.steps
        self._warm_up = max(1, round(config.navigation.warm_up_s / self.epoch_s))
        self._distances = np.array(config.observation.satellites_m, dtype=np.float64)
        self._shows_truth = config.observation.integrity == "oracle"
        self._one = Navigator(settings, self.skies.track, self.skies.mask, 0, 1)
        self._others, self._perception = others, config.perception
        self._make()

    def _make(self) -> None:
        """Everything that changes, before any start."""
        count = self._everyone.size
        sees = self._others > 0 and self._perception.source not in GIVEN
        self.perceptions = Perceptions(self._perception, count, self._others, self.epoch_s) if sees else None
        self._vehicles = 1 + self._others if self.perceptions is not None and self.perceptions.hears else 1
        self._there = np.ones((count, self._vehicles), dtype=np.bool_)
        self._streams = CrewStreams([0] * count, [0] * count, self._there[:, 1:], self.skies.used[[0] * count])
        self._navigator = self._one.another(self._streams)
        self.trackers = Trackers(self._config, count, self._lanes, self._map_bound_m, self._limits_m)
        self._motion = Motion.still(count * self._vehicles, self.step_s)
        self._hour, self._age = np.zeros((2, count), dtype=np.int64)  # age: epochs since the episode's start
        self._city_m = np.zeros(count)
        self._sky: SkyView | None = None

    def another(self) -> Senses:
        """Senses for as many egos under the same skies, before any start."""
        other = copy.copy(self)
        other._make()
        return other

    @property
    def nbytes(self) -> int:
        """Memory of the arrays that have a row for each environment or vehicle."""
        parts = self._navigator.state, self._motion, self.trackers, self.perceptions
        return sum(_size_of(part) for part in parts if part is not None)

    # Starts

    def begin(self, rows: Rows, seeds: list[int], world: World) -> None:
        """Start the navigation of ``rows`` some seconds before their episodes, on a straight approach.

        ``seeds`` are the episodes': they draw all that a single environment draws from them.
        """
        others = world.whole[rows, k.PRESENT, 1:] > 0
        crew = others[:, : self._vehicles - 1]
        self._there[rows, 1:] = crew
        scenes = draw_scenes(seeds, self._layouts, self.skies.hours, crew, self._config.source.senses)
        self._hour[rows], self._city_m[rows] = scenes.hour, self.skies.city_m[scenes.layout]
        used = self.skies.used[scenes.hour]
        streams = CrewStreams(seeds, scenes.fleet_seed.tolist(), crew, used)
        starter = self._one.another(streams)
        solution, motion, told = self._approach(rows, starter, world, scenes)
        if np.array_equal(rows, self._everyone):
            self._navigator, self._motion, self._streams = starter, motion, streams
        else:
            self._take_over(rows, starter, motion, streams, np.arange(rows.size))
        self._age[rows], self._sky = 0, None
        if self._config.source.senses:
            shift = self._config.map_sigma_m * scenes.map_shift
            self.trackers.begin(rows, solution, self._vehicles, shift, world.belief)
        if self.perceptions is not None:
            self.perceptions.begin(rows, seeds, others)
            for time_s, claims in told:
                self.perceptions.step(rows, np.full(rows.size, time_s), claims, world)
        self.foresee(rows, world)

    def adopt(self, rows: Rows, other: Senses) -> None:
        """Go on as the egos ``rows`` of other senses do."""
        self._take_over(rows, other._navigator, other._motion, other._streams, rows)
        self.trackers.adopt(rows, other.trackers)
        if self.perceptions is not None and other.perceptions is not None:
            self.perceptions.adopt(rows, other.perceptions)
        self._there[rows], self._hour[rows], self._city_m[rows] = (
            other._there[rows], other._hour[rows], other._city_m[rows],
        )  # fmt: skip
        self._age[rows], self._sky = other._age[rows], None

    def _take_over(
        self, rows: Rows, navigator: Navigator, motion: Motion, streams: CrewStreams, theirs: Rows
    ) -> None:  # fmt: skip
        """Put the vehicles of the environments ``theirs`` in place of those of ``rows``."""
        mine, every = self._rows_of(rows), self._rows_of(theirs)
        self._navigator.adopt(mine, navigator, every)
        self._motion.adopt(mine, motion, every)
        self._streams.adopt(rows, streams, theirs)

    @property
    def _epochs_at_start(self) -> int:
        """What the clock shows at the start of a single environment's episode."""
        return round(self._config.clock_start_s / self.epoch_s)

    def _rows_of(self, rows: Rows) -> Rows:
        """The rows of all navigating vehicles of environments."""
        every: Rows = (rows[:, None] * self._vehicles + np.arange(self._vehicles)).ravel()
        return every

    def _approach(
        self, rows: Rows, navigator: Navigator, world: World, scenes: Scenes
    ) -> tuple[Solution, Motion, list[tuple[float, Array]]]:
        """Drive straight up to the start, an epoch after another; the last of what the others tell of themselves."""
        end, heading, speed = self._poses(rows, world)
        ahead = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
        begin = end - self._warm_up * self.epoch_s * ahead
        motion, every = Motion.still(heading.size, self.step_s), np.arange(heading.size)
        motion.enter_all(begin, heading, speed)
        place(navigator, self._config, begin, heading, scenes.noise)
        arc, side = self._whereabouts(rows, world)
        told: list[tuple[float, Array]] = []
        for step in range(1, self._warm_up * self.steps + 1):
            last = step == self._warm_up * self.steps
            motion.advance(every, end if last else begin + step * self.step_s * ahead, heading)
            if step % self.steps == 0:
                ago = step // self.steps - self._warm_up
                time_s = ago * self.epoch_s
                truth = motion.epoch((self._epochs_at_start + ago) * self.epoch_s, self.epoch_s, arc, side)
                clock = np.full(rows.size, self._config.clock_start_s + time_s)
                sky = self.skies.view(self._hour[rows], clock, self._there[rows])
                solution = navigator.locate(navigator.measure(truth, sky))
                if last or (self._vehicles > 1 and -HEARD_S <= time_s < -0.5 * self.epoch_s):
                    told.append((time_s, claims_of(solution, self._vehicles)))
        return solution, motion, told

    # Steps

    def coast(self, rows: Rows, world: World) -> None:
        """A simulation step has passed that ends no navigation epoch."""
        self._moved(world)
        if self._config.source.senses:
            self.trackers.coast(rows, self.step_s, world.belief)

    def navigate(self, rows: Rows, world: World) -> None:
        """A simulation step has passed that ends an epoch: measure, locate, perceive, and bring beliefs up to date."""
        self._moved(world)
        self._age += 1
        arc, side = self._whereabouts(self._everyone, world)
        truth = self._motion.epoch((self._navigator.epoch + 1) * self.epoch_s, self.epoch_s, arc, side)
        self._sky = self._view()
        solution = self._navigator.locate(self._navigator.measure(truth, self._sky))
        if self._config.source.senses:
            self.trackers.take(rows, solution, self._vehicles, self.step_s, self.epoch_s, world.belief)
            glance_all(rows, world.belief, world.score, world.cars, self._figures)
        if self.perceptions is not None:
            time_s = np.asarray(self._age[rows] * self.epoch_s, dtype=np.float64)
            self.perceptions.step(rows, time_s, claims_of(solution, self._vehicles)[rows], world)

    def foresee(self, rows: Rows, world: World) -> None:
        """Satellites that the map promises ahead of the beliefs, for what is observed next."""
        if not (self._distances.size and self._config.source.senses):
            return
        s, f = self.skies, self.skies.forecast
        sky = self._view() if self._sky is None else self._sky
        run_rows(
            foresee, rows.size, self._lanes, rows, self._shown(world), self._distances, s.begin_m, s.reach_m,
            self._city_m, f.free, f.spacing_m, f.azimuths, f.elevations, sky.azimuth_rad, sky.elevation_rad,
            sky.above, world.sky, row_us=4.0,
        )  # fmt: skip

    def _shown(self, world: World) -> Array:
        """Beliefs by which the sky ahead is foretold, (N, BELIEF): the true places where the truth is observed."""
        if not self._shows_truth:
            return world.belief
        shown = world.belief.copy()
        shown[:, k.B_X], shown[:, k.B_Y] = world.cars[:, k.X, 0], world.cars[:, k.Y, 0]
        shown[:, k.B_LANE] = world.whole[:, k.LANE, 0]
        return shown

    def _view(self) -> SkyView:
        """The skies over all egos now."""
        clock = np.asarray(self._config.clock_start_s + self._age * self.epoch_s, dtype=np.float64)
        return self.skies.view(self._hour, clock, self._there)

    def _poses(self, rows: Rows, world: World) -> tuple[Array, Array, Array]:
        """True positions (n M, 2), headings and speeds of all navigating vehicles."""
        count = rows.size * self._vehicles
        position, heading, speed = np.empty((count, 2)), np.empty(count), np.empty(count)
        poses_of(rows, self._vehicles, world.cars, position, heading, speed)
        return position, heading, speed

    def _moved(self, world: World) -> None:
        """Note where everybody is after a simulation step."""
        position, heading, _ = self._poses(self._everyone, world)
        self._motion.advance(self._rows_of(self._everyone), position, heading)

    def _whereabouts(self, rows: Rows, world: World) -> tuple[Array, Rows]:
        """Where all navigating vehicles truly are in their cities."""
        arc = np.empty((rows.size, self._vehicles))
        side, s = np.empty(arc.shape, dtype=np.int64), self.skies
        whereabouts(self._lanes, rows, world.cars, world.whole, s.begin_m, s.reach_m, self._city_m, arc, side)
        return arc.ravel(), side.ravel()


def _size_of(state: object) -> int:
    """Bytes of the arrays of a state, and of the states in it."""
    parts = vars(state).values()
    return sum(part.nbytes if isinstance(part, np.ndarray) else _size_of(part) if is_dataclass(part) else 0
               for part in parts)  # fmt: skip
