"""Navigation of N environments: one navigator locates all navigating vehicles, each in its own city at its own hour.

A row of environment e holds M vehicles, the ego first, then the others by slot; M is 1 without broadcasts. The
navigation of an episode begins some seconds before it, on a straight approach.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch import rows_kernel as rk
from lanebound.envs.batch.belief_kernel import FIX
from lanebound.envs.batch.faults import EpisodeFaults
from lanebound.envs.batch.lanes_kernel import Lanes
from lanebound.envs.batch.motion_kernel import MOTION, Whereabouts, begin_motion, fill_motion
from lanebound.envs.batch.skies import Cities, Skies
from lanebound.envs.batch.sky_ahead_kernel import Forecast, SkyAhead, SkyRows
from lanebound.envs.batch.streams import CrewStreams
from lanebound.envs.navigation import NavigationConfig
from lanebound.envs.records import azimuth_of, enu_of
from lanebound.envs.sky import CitiesConfig
from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.motion.truth_kernel import TRUTH
from lanebound.integrity.navigators.navigator import Measurements, Navigator, NavigatorConfig, Start
from lanebound.integrity.navigators.solution import ContextReport, Solution
from lanebound.integrity.positioning.map_matching.road_map import RoadMap
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sky.view import SkyView

__all__ = ["HEARD_S", "Approach", "NavigationBatch", "Starts", "draw_starts", "fixes_of", "heard_at"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Flags = NDArray[np.bool_]

OF_CONTEXT = ContextReport._fields[:4]
OF_SOLUTION = tuple(name for name in FIX.names or () if name not in OF_CONTEXT)
HEARD_S = 0.6  # of the approach with the radio on: the longest delay of a message
FLEET_SEEDS = 2**62
HONEST = 0.0, 0.0, 0.0, 1.0  # no displacement, and the levels as they are
SENSE_US = 4.0  # of one thread for an environment, measured
FLEET_STARTS = 2  # draws of the others' first positions: as they enter the world, and again for their approach


class Starts(NamedTuple):
    """What the starts of n episodes draw beside the traffic.

    city, hour, fleet_seed (n,): seed of the city, hour of the constellations, seed of the others' instruments;
    map_shift (n, 2) standard normal, of each ego's map; noise (n, M, 3) standard normal, of first positions and
    headings.
    """

    city: Rows
    hour: Rows
    fleet_seed: Rows
    map_shift: Array
    noise: Array


def draw_starts(seeds: Sequence[int], cities: CitiesConfig, hours: int, crew: Flags, sensed: bool) -> Starts:
    """The draws of episodes, by their seeds alone.

    crew (n, M - 1): places of the others that a vehicle has taken; zeros are drawn for the rest. ``sensed``: the egos'
    own positions are, and so their maps have a shift.
    """
    drawn = np.zeros((3, len(seeds)), dtype=np.int64)
    shift, noise = np.zeros((len(seeds), 2)), np.zeros((len(seeds), 1 + crew.shape[1], 3))
    for n, seed in enumerate(seeds):
        scene, start = named_generator(seed, "scene"), named_generator(seed, "start")
        drawn[:, n] = [scene.integers(below) for below in (cities.number, hours, FLEET_SEEDS)]
        drawn[0, n] = cities.seed_of(int(drawn[0, n]))
        if sensed:
            shift[n], noise[n, 0] = start.standard_normal(2), start.standard_normal(3)
        if others := int(crew[n].sum()):
            of_fleet = fleet_generator(int(drawn[2, n]))
            noise[n, 1 : 1 + others] = of_fleet.standard_normal((FLEET_STARTS, others, 3))[-1]
    return Starts(drawn[0], drawn[1], drawn[2], shift, noise)


def heard_at(epoch_s: float, epochs_before: int) -> list[float]:
    """Times at which the radio is on before an episode, after so many epochs of navigation, and its start [s]."""
    times = [ago * epoch_s for ago in range(1 - epochs_before, 1)]
    return [time_s for time_s in times if time_s >= -HEARD_S]


def fleet_generator(seed: int) -> np.random.Generator:
    """What the first positions of the others are drawn from."""
    return named_generator(seed, "start")


def fixes_of(solution: Solution) -> Records:
    """FIX (B,) of a solution."""
    context, out = solution.context or ContextReport.none(solution.batch), np.empty(solution.batch, FIX)
    for name in OF_SOLUTION:
        out[name] = getattr(solution, name)
    for name in OF_CONTEXT:
        out[name] = getattr(context, name)
    return out


@dataclass(frozen=True)
class Approach:
    """How episodes have been driven up to: FIX (n M,) at the start, and those heard before (time, FIX)."""

    fixes: Records
    heard: list[tuple[float, Records]]


class NavigationBatch:
    """The navigators of N environments.

    Every environment has its own time, so its episodes equal those of a single environment.

    Parameters
    ----------
    config, settings : how the egos know their positions, and the navigator's own configuration
    skies, cities : that episodes may draw
    forecast : prediction of satellites from the map of the cities, at the distances of the observation
    lanes : of the road network
    count, vehicles : N environments of M vehicles
    step_s, steps : length of a simulation step, and steps in an epoch
    road_map : of the context monitor of the egos, if there is one

    Attributes
    ----------
    motions : (N, M) MOTION
    faults : of the episodes
    effects : of faults in the last epoch, None where none acted
    hour : (N,) of the constellations
    sky : the skies over the egos at the last epoch
    where : the cities that they are in
    measurements, solution : of the last epoch, None before
    fixes : FIX (N M,) of the last solution
    """

    def __init__(
        self,
        config: NavigationConfig,
        settings: NavigatorConfig,
        skies: Skies,
        cities: Cities,
        forecast: Forecast,
        lanes: Lanes,
        count: int,
        vehicles: int,
        step_s: float,
        steps: int,
        road_map: RoadMap | None = None,
    ) -> None:
        self.config, self.skies, self.cities, self.lanes = config, skies, cities, lanes
        self.forecast = forecast
        self.count, self.vehicles, self.step_s, self.steps = count, vehicles, step_s, steps
        self.epoch_s = step_s * steps
        self.epochs_before = config.epochs_before(self.epoch_s)
        self._one = Navigator(settings, skies.track, cities.mask, 0, 1)
        if road_map is not None:
            self._one.use_map(road_map, one_in=vehicles)
        self._make()

    def _make(self) -> None:
        """Everything that changes, before any start."""
        n, m = self.count, self.vehicles
        self._there = np.ones((n, m), dtype=np.bool_)
        self._streams = CrewStreams([0] * n, [0] * n, self._there[:, 1:], self.skies.used[[0] * n])
        self.__dict__.pop("navigator", None)
        self.motions: Records = np.zeros((n, m), MOTION)
        self.faults = EpisodeFaults(n)
        self.effects: FaultEffects | None = None
        self.hour, self._age = np.zeros((2, n), dtype=np.int64)  # age: epochs since the episode's start
        self.where: Whereabouts = self.cities.where(n)
        self.sky: SkyRows = self.skies.empty(n)
        self._index: Rows | None = None
        self.measurements: Measurements | None = None
        self.solution: Solution | None = None
        self.fixes: Records = np.zeros(n * m, FIX)
        self._kept = np.arange(n)

    @cached_property
    def navigator(self) -> Navigator:
        """Of all vehicles; a start of all environments puts another in its place."""
        return self._one.another(self._streams)

    def another(self, count: int) -> NavigationBatch:
        """Navigators of ``count`` environments under the same skies, before any start."""
        other = copy.copy(self)
        other.count = count
        other._make()
        return other

    @property
    def nbytes(self) -> int:
        """Memory of the arrays that have a row for each environment or vehicle."""
        held = self.navigator.state, self.measurements, self.solution, self.sky, self.motions, self.fixes
        return sum(_sizes(held).values())

    def at(self, rows: Rows) -> Rows:
        """The rows of the egos in ``fixes``."""
        return rows * self.vehicles

    def by_ego(self, of_vehicles: NDArray[Any]) -> NDArray[Any]:
        """What there is of all vehicles (N M, ...) as (N, M, ...), the ego first, then the others by slot."""
        return of_vehicles.reshape(self.count, self.vehicles, *of_vehicles.shape[1:])

    @property
    def ahead(self) -> SkyAhead:
        """What satellites ahead of the egos are predicted from."""
        return SkyAhead(self.where, self.forecast, self.sky)

    # Starts

    def begin(self, rows: Rows, seeds: Sequence[int], starts: Starts, cars: Records, there: Flags) -> Approach:
        """Start the navigation of ``rows`` before their episodes; ``seeds`` draw all that is drawn.

        there (n, M - 1): places of the others that take part, by slot.
        """
        self._there[rows, 1:] = there
        self.hour[rows] = starts.hour
        self.cities.settle(self.where, rows, starts.city, cars["lane"][rows, 0])
        streams = CrewStreams(seeds, starts.fleet_seed.tolist(), there, self.skies.used[starts.hour])
        starter = self._one.another(streams)  # no fault begins before its episode
        motions = np.zeros((rows.size, self.vehicles), MOTION)
        approach = self._approach(rows, starter, motions, starts, cars)
        if np.array_equal(rows, self._kept):
            self.navigator, self._streams = starter, streams
            self.motions[:] = motions
        else:
            self._take_over(rows, starter, motions, streams, np.arange(rows.size))
        self._age[rows], self._index = 0, None
        rk.sky_rows(0, rows.size, rows, self.skies.table, self.hour, self.clock_s, self.sky)
        return approach

    def adopt(self, rows: Rows, other: NavigationBatch, theirs: Rows) -> None:
        """Go on in the environments ``rows`` with the environments ``theirs`` of another batch."""
        self._take_over(rows, other.navigator, other.motions, other._streams, theirs)
        self._there[rows], self.hour[rows] = other._there[theirs], other.hour[theirs]
        self._age[rows], self._index = other._age[theirs], None
        self.where.city[rows] = other.where.city[theirs]
        self.faults.adopt(rows, other.faults, theirs)

    def _take_over(
        self, rows: Rows, navigator: Navigator, motions: Records, streams: CrewStreams, theirs: Rows
    ) -> None:
        self.navigator.adopt(self._rows_of(rows), navigator, self._rows_of(theirs))
        self.motions[rows] = motions[theirs]
        self._streams.adopt(rows, streams, theirs)

    def _rows_of(self, rows: Rows) -> Rows:
        """The rows of all navigating vehicles of environments."""
        every: Rows = (rows[:, None] * self.vehicles + np.arange(self.vehicles)).ravel()
        return every

    def _approach(
        self, rows: Rows, navigator: Navigator, motions: Records, starts: Starts, cars: Records
    ) -> Approach:  # fmt: skip
        """Drive all vehicles straight up to their starts, an epoch after another."""
        every, steps = np.arange(rows.size), self.epochs_before * self.steps
        truth, heard = self._at_rest(rows), list[tuple[float, Records]]()
        end, ahead = np.zeros((2, *motions.shape, 2))
        before_s = self.epochs_before * self.epoch_s
        begin_motion(rows, cars, self.lanes, self.where, self.step_s, before_s, motions, end, ahead, truth)
        begin, known = motions["position"].copy(), _present(rows, cars, self.vehicles)
        known[:, 0] &= self.config.start is Start.TOLD  # the others have driven before
        present = np.flatnonzero(known)
        heading, noise = motions["heading_rad"].ravel()[present], starts.noise.reshape(-1, 3)[present]
        place_all(navigator, self.config, begin.reshape(-1, 2)[present], heading, noise, present)
        sky, index = self.skies.empty(rows.size), np.where(self._there[rows], every[:, None], rows.size).ravel()
        hour, hours, on_air = self.hour[rows], self.skies.table, heard_at(self.epoch_s, self.epochs_before)
        for step in range(1, steps + 1):
            last = end if step == steps else None
            rk.approach_step(0, rows.size, every, motions, begin, ahead, step * self.step_s, last)
            if step % self.steps:
                continue
            ago = step // self.steps - self.epochs_before
            clock, time_s = self._clock_s(ago), ago * self.epoch_s
            run_rows(rk.sky_rows, rows.size, every, hours, hour, np.full(rows.size, clock), sky, row_us=2.0)
            fill_motion(motions, every, self.step_s, self._down, truth)
            self.measurements = navigator.measure(Truth.of(clock, self.epoch_s, truth), self.skies.view(sky, index))
            if last is not None or (self.vehicles > 1 and time_s in on_air):
                heard.append((time_s, fixes_of(navigator.solve(self.measurements))))
            else:
                navigator.follow(self.measurements)
        return Approach(heard[-1][1], heard)

    def enter(
        self, row: int, slots: Rows, position_m: Array, heading_rad: Array, speed_mps: Array, passed: int, noise: Array
    ) -> None:
        """Vehicles appear in slots (n,) of an environment, after going straight on at their speed.

        position_m (n, 2) is where each is now; ``passed``: steps of the epoch before this one; noise (n, 3) standard
        normal, of their first estimated positions.
        """
        chord = self.step_s * speed_mps[:, None] * np.stack([np.cos(heading_rad), np.sin(heading_rad)], -1)
        before, rows = position_m - chord, slots + 1
        m = self.motions
        m["position"][row, rows], m["heading_rad"][row, rows] = before, heading_rad
        m["chord"][row, rows] = m["chord_before"][row, rows] = chord
        m["start"][row, rows], m["start_velocity"][row, rows] = before - passed * chord, chord / self.step_s
        m["start_heading_rad"][row, rows] = heading_rad
        begun = m["start"][row, rows]  # the navigator goes on from there: it measures the whole epoch
        place_all(self.navigator, self.config, begun, heading_rad, noise, row * self.vehicles + rows)

    # Steps

    def sense(self, rows: Rows, cars: Records, egos: Records) -> None:
        """Measure the epoch that ends now: the motion of all vehicles since the last one, under the skies of now."""
        self._age += 1
        truth, clock_s = self._at_rest(slice(None)), self.clock_s

        def work(first: int, last: int) -> None:
            rk.end_epoch(
                first, last, rows, cars, egos, self.motions, self.lanes, self.where, self.step_s, self._down, truth
            )
            rk.sky_rows(first, last, rows, self.skies.table, self.hour, clock_s, self.sky)

        run_rows(work, rows.size, row_us=SENSE_US)
        self.effects = self.faults.effects(clock_s, self.epoch_s, self.vehicles, self._sky_over)
        now_s = self._clock_s(self.navigator.epoch + 1 - self._epochs_at_start)
        self.measurements = self.navigator.measure(Truth.of(now_s, self.epoch_s, truth), self.view(), self.effects)

    def _at_rest(self, rows: Rows | slice) -> Records:
        """TRUTH (n M,) of all slots, at rest where the cities begin; slots without a vehicle keep it."""
        truth = np.zeros(self.where.city[rows].size * self.vehicles, TRUTH)
        truth["arc"] = np.repeat(self.where.city[rows], self.vehicles)
        return truth

    def locate(self) -> None:
        """Locate all vehicles by the measurements alone."""
        assert self.measurements is not None
        self.solution = self.navigator.solve(self.measurements)
        self.fixes = self.by_ego(fixes_of(self.solution)).ravel()

    def view(self) -> Any:
        """The skies over all vehicles at the last epoch; no satellites for a missing vehicle."""
        if self._index is None:
            self._index = np.where(self._there, self._kept[:, None], self.count).ravel()
        return self.skies.view(self.sky, self._index)

    def _sky_over(self, e: int) -> SkyView:
        """The sky over the vehicles of one environment, with the numbers of its satellites."""
        rows, index, s = [e, self.count], np.where(self._there[e], 0, 1), self.sky
        own = SkyRows(s.los[rows], s.elevation[rows], s.azimuth[rows], s.above[rows])
        return self.skies.view(own, index, int(self.hour[e]))

    @property
    def lies(self) -> Array | None:
        """Errors of what the others broadcast (N, M - 1, 4), by slot: displacement East, North, up [m], and factor on
        their levels; None where all are honest."""
        if self.effects is None:
            return None
        others = self.by_ego(self.effects.vehicles)[:, 1:]
        errors = np.concatenate([others["v2v_offset_enu_m"], others["v2v_pl_scale"][..., None]], axis=2)
        return errors if (errors != HONEST).any() else None

    def crew(self, row: int) -> int:
        """How many vehicles of an environment navigate, or may once they have entered."""
        return int(self._there[row].sum())

    @property
    def time_s(self) -> Array:
        """(N,) of each episode."""
        return np.asarray(self._age * self.epoch_s, dtype=np.float64)

    @property
    def clock_s(self) -> Array:
        """(N,) what the clocks of single environments would show."""
        return np.asarray(self.config.clock_start_s + self._age * self.epoch_s, dtype=np.float64)

    def _clock_s(self, epochs: int) -> float:
        return self.config.clock_start_s + epochs * self.epoch_s

    @property
    def _epochs_at_start(self) -> int:
        """What a navigator's clock shows at the start of an episode."""
        return round(self.config.clock_start_s / self.epoch_s)

    @property
    def _down(self) -> float:
        return -GRAVITY_MPS2 * self.epoch_s


def place_all(
    navigator: Navigator,
    config: NavigationConfig,
    xy: Array,
    heading_rad: Array,
    noise: Array,
    rows: Rows | slice = slice(None),
) -> None:
    """Start vehicles of a navigator near their true poses: xy (n, 2), heading (n,), standard normal noise (n, 3)."""
    spread = np.deg2rad(config.start_heading_deg)
    sigma_m = navigator.config.told_sigma_m if config.start_sigma_m is None else config.start_sigma_m
    navigator.place(
        enu_of(xy + sigma_m * noise[:, :2]),
        azimuth_of(heading_rad + spread * noise[:, 2]),
        sigma_m,
        float(spread),
        rows,
    )


def _present(rows: Rows, cars: Records, vehicles: int) -> Flags:
    """Which of the navigating vehicles of environments there are, (n, M)."""
    there, slots = np.zeros((rows.size, vehicles), dtype=np.bool_), cars["slot"][rows]
    n, v = np.nonzero((slots >= 0) & (slots < vehicles - 1))
    there[:, 0] = there[n, slots[n, v] + 1] = True
    return there


def _sizes(part: object) -> dict[int, int]:
    """Bytes of the arrays in records, states and measurements at any depth, each array once."""
    if isinstance(part, np.ndarray):
        whole = part if part.base is None else part.base
        return {id(whole): part.nbytes if part.base is None else getattr(whole, "nbytes", part.nbytes)}
    parts = part if isinstance(part, tuple | list) else vars(part).values() if is_dataclass(part) else ()
    return {name: size for inner in parts for name, size in _sizes(inner).items()}
