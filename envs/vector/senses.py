"""Navigation of N egos: one navigator measures and locates all of them, each in its own city at its own hour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.core import DrivingEnv
from lanebound.envs.motion import Motion
from lanebound.envs.navigation import place
from lanebound.envs.scene import alert_limits_m, map_bound_m, navigator_config
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.lanes_kernel import Lanes
from lanebound.envs.vector.senses_kernel import foresee, glance_all, place_all, whereabouts
from lanebound.envs.vector.skies import Skies
from lanebound.envs.vector.step_kernel import World
from lanebound.envs.vector.streams import StackedStreams
from lanebound.envs.vector.trackers import Trackers
from lanebound.integrity.errors import ConfigError
from lanebound.integrity.navigator import Navigator
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.solution import Solution
from lanebound.integrity.streams import Streams, named_generator

__all__ = ["Senses"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
FLEET_SEEDS = 2**62  # as set_scene draws them


class Senses:
    """What the egos know of themselves.

    All instruments run on one clock, in epochs, that goes on while single environments start anew; so a message of a
    reference station may find an episode at any tenth of a second. When all start at once it starts with them.

    Parameters
    ----------
    single : an environment of the configuration
    count : number N
    lanes, figures : its lanes and figures
    duration_s : when episodes are truncated
    alone : draw each environment's errors from generators of its own, as a single environment does; slower
    """

    def __init__(
        self, single: DrivingEnv, count: int, lanes: Lanes, figures: Array, duration_s: float, alone: bool
    ) -> None:
        config = single.config
        limits = alert_limits_m(single.world, config)
        settings = navigator_config(config, limits)
        if settings.imu.mems_exponential:
            raise ConfigError("navigator.imu.mems_exponential must be False in the vector engine, whose instruments "
                              "are never cold: make the same environments with vectorization_mode='sync'")  # fmt: skip
        self._config, self._layouts = config.navigation, config.layouts
        self._lanes, self._figures, self._alone = lanes, figures, alone
        self.skies = Skies.of(single, settings, duration_s)
        self.step_s = 1.0 / config.simulation_hz
        self.steps = config.navigation.steps_per_epoch(config.simulation_hz)
        self.epoch_s = self.step_s * self.steps
        self._warm_up = max(1, round(config.navigation.warm_up_s / self.epoch_s))
        self._navigator = Navigator(settings, self.skies.track, self.skies.mask, 0, count)
        self.trackers = Trackers(config.navigation, count, map_bound_m(config, settings), limits)
        self._motion = Motion.still(count, self.step_s)
        self._hour, self._started = np.zeros((2, count), dtype=np.int64)
        self._city_m = np.zeros(count)
        self._epoch = self._epochs_at_start
        self._sky: SkyView | None = None
        self._distances = np.array(config.observation.satellites_m, dtype=np.float64)

    # Starts

    def begin(self, rows: Rows, seeds: list[int], world: World) -> None:
        """Start the navigation of ``rows`` some seconds before their episodes, on a straight approach.

        ``seeds`` are the episodes': they draw city, hour, the map's shift and the first position as in a single
        environment.
        """
        everyone = np.array_equal(rows, np.arange(self._hour.size))
        origin = self._epochs_at_start if everyone else self._epoch
        noise = np.empty((rows.size, 5))
        for n, (e, seed) in enumerate(zip(rows.tolist(), seeds, strict=True)):
            scene = named_generator(seed, "scene")
            layout, self._hour[e], _ = (int(scene.integers(m)) for m in (self._layouts, self.skies.hours, FLEET_SEEDS))
            self._city_m[e] = self.skies.city_m[layout]
            start = named_generator(seed, "start")
            noise[n, :2], noise[n, 2:] = start.standard_normal(2), start.standard_normal(3)
        used = self.skies.used[self._hour[rows]]
        streams = StackedStreams(seeds, used) if self._alone else Streams(seeds[0], rows.size)
        starter = self._navigator.another(streams, origin - self._epochs_at_start)
        solution, motion = self._approach(rows, starter, world, noise[:, 2:], origin)
        if everyone:
            self._navigator, self._motion, self._epoch = starter, motion, origin
        else:
            self._navigator.adopt(rows, starter)
            self._motion.adopt(rows, motion)
            mine = self._navigator.state.streams
            if isinstance(mine, StackedStreams) and isinstance(streams, StackedStreams):
                mine.adopt(rows, streams)
        self._started[rows], self._sky = origin, None
        self.trackers.begin(rows, solution, self._config.map_sigma_m * noise[:, :2])
        world.belief[rows, k.B_ALERT_AGE] = 0.0
        self._write(rows, solution, world)
        self.trackers.place(rows, world.belief)
        place_all(self._lanes, rows, world.belief)
        self.trackers.trust(rows, world.belief)
        self.foresee(rows, world)

    @property
    def _epochs_at_start(self) -> int:
        """What the clock shows at the start of a single environment's episode."""
        return round(self._config.clock_start_s / self.epoch_s)

    def _approach(
        self, rows: Rows, navigator: Navigator, world: World, noise: Array, origin: int
    ) -> tuple[Solution, Motion]:
        """Drive straight up to the start, an epoch after another."""
        cars = world.cars[rows]
        end, heading, speed = cars[:, [k.X, k.Y], 0], cars[:, k.HEADING, 0], cars[:, k.SPEED, 0]
        ahead = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
        begin = end - self._warm_up * self.epoch_s * ahead
        motion, every = Motion.still(rows.size, self.step_s), np.arange(rows.size)
        for n in range(rows.size):
            motion.enter(n, begin[n], float(heading[n]), float(speed[n]))
        place(navigator, self._config, begin, heading, noise)
        arc, side = self._whereabouts(rows, world)
        for step in range(1, self._warm_up * self.steps + 1):
            last = step == self._warm_up * self.steps
            motion.advance(every, end if last else begin + step * self.step_s * ahead, heading)
            if step % self.steps == 0:
                ago = step // self.steps - self._warm_up
                truth = motion.epoch((origin + ago) * self.epoch_s, self.epoch_s, arc, side)
                clock = self._config.clock_start_s + ago * self.epoch_s
                sky = self.skies.view(self._hour[rows], np.full(rows.size, clock))
                solution = navigator.locate(navigator.measure(truth, sky))
        return solution, motion

    # Steps

    def coast(self, rows: Rows, world: World) -> None:
        """A simulation step has passed that ends no navigation epoch."""
        self._moved(world)
        self.trackers.coast(rows, self.step_s)
        self._settle(rows, world)

    def navigate(self, rows: Rows, world: World) -> None:
        """A simulation step has passed that ends an epoch: measure, locate, and bring beliefs up to date."""
        self._moved(world)
        self._epoch += 1
        arc, side = self._whereabouts(np.arange(self._hour.size), world)
        truth = self._motion.epoch(self._epoch * self.epoch_s, self.epoch_s, arc, side)
        self._sky = self._view()
        solution = self._navigator.locate(self._navigator.measure(truth, self._sky)).rows(rows)
        self.trackers.take(rows, solution, self.step_s, self.epoch_s)
        self._write(rows, solution, world)
        self._settle(rows, world)
        glance_all(rows, world.belief, world.score, world.cars, self._figures)

    def foresee(self, rows: Rows, world: World) -> None:
        """Satellites that the map promises ahead of the beliefs, for what is observed next."""
        if not self._distances.size:
            return
        s, f = self.skies, self.skies.forecast
        sky = self._view() if self._sky is None else self._sky
        foresee(
            self._lanes, rows, world.belief, self._distances, s.begin_m, s.reach_m, self._city_m, f.free, f.spacing_m,
            f.azimuths, f.elevations, sky.azimuth_rad, sky.elevation_rad, sky.above, world.sky,
        )  # fmt: skip

    def _view(self) -> SkyView:
        """The skies over all egos now."""
        since_s = (self._epoch - self._started) * self.steps * self.step_s
        clock = np.asarray(self._config.clock_start_s + since_s, dtype=np.float64)
        return self.skies.view(self._hour, clock)

    def _moved(self, world: World) -> None:
        """Note where everybody is after a simulation step."""
        cars = world.cars[:, :, 0]
        self._motion.advance(np.arange(self._hour.size), cars[:, [k.X, k.Y]], cars[:, k.HEADING].copy())

    def _whereabouts(self, rows: Rows, world: World) -> tuple[Array, Rows]:
        """Where the true egos are in their cities."""
        arc, side = np.empty(rows.size), np.empty(rows.size, dtype=np.int64)
        s = self.skies
        whereabouts(self._lanes, rows, world.cars, world.whole, s.begin_m, s.reach_m, self._city_m, arc, side)
        return arc, side

    def _settle(self, rows: Rows, world: World) -> None:
        """Place beliefs on the map, trust them as far as they go, and count how long alerts have been on."""
        belief = world.belief
        self.trackers.place(rows, belief)
        place_all(self._lanes, rows, belief)
        self.trackers.trust(rows, belief)
        on = belief[rows, k.B_ALERT] > 0.0
        belief[rows, k.B_ALERT_AGE] = np.where(on, belief[rows, k.B_ALERT_AGE] + self.step_s, 0.0)

    def _write(self, rows: Rows, solution: Solution, world: World) -> None:
        """What the newest solutions say of themselves, in the columns of the belief."""
        values = {
            k.B_MODE: solution.mode, k.B_RTK: solution.rtk, k.B_HDOP: solution.hdop,
            k.B_SATELLITES: solution.satellites, k.B_DOPPLER: solution.satellites_doppler,
            k.B_EXCLUDED: solution.excluded, k.B_SINCE_RTK: solution.since_rtk_s,
            k.B_SINCE_CALIBRATION: solution.since_calibration_s, k.B_CORRECTIONS_AGE: solution.corrections_age_s,
        }  # fmt: skip
        for column, value in values.items():
            world.belief[rows, column] = value
